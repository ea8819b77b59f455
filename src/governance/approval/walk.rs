//! Walks every request with up to four answers exhaustively: requester, author, asking person, approvers under one
//! name and two, forged, used, stale and expired answers, refusals, break-glass, and wall time before and after each
//! deadline. The walk states its own invariants, and for every rule it has to catch a mutant without it.

use std::collections::BTreeSet;

use super::*;
use crate::profile::{Profile, ProfileName};

/// The true facts of an answer, recorded by the walk and not by the product.
#[derive(Clone)]
struct TrueVote {
    vote: Vote,
    /// The human being who gave it, under any name.
    human: &'static str,
    /// Whether it is genuine, unused and for this request.
    genuine: bool,
}

/// The humans who take part in the request, and so cannot approve.
const PARTIES: [&str; 3] = ["rita", "arno", "otto"];

/// Ends of an answer that is good for a short time, of the question, and of every other answer.
const ENDS: [i64; 3] = [10_000, 20_000, 30_000];

fn at(ms: i64) -> WallTime {
    WallTime::from_ms(ms)
}

fn subject(of: &str) -> Subject {
    let digest = Digest::of_parts("walk", &[of.as_bytes()]);
    Subject { candidate: digest, row_version: 1, evidence: digest, policy: digest, profile: digest }
}

fn vote(name: &str, human: &'static str, role: Role) -> TrueVote {
    let vote = Vote {
        person: name.to_owned(),
        key: format!("key of {human}"),
        role,
        answer: ApprovalDecision::Approve,
        reason: "read".to_owned(),
        subject: subject("this"),
        until: at(ENDS[2]),
        break_glass: false,
        signature: SignatureCheck::Valid,
        nonce_used: false,
    };
    TrueVote { vote, human, genuine: true }
}

/// Every answer that is tried.
fn answers() -> Vec<TrueVote> {
    let with = |mut given: TrueVote, genuine: bool, change: fn(&mut Vote)| {
        change(&mut given.vote);
        given.genuine = genuine;
        given
    };
    let ann = || vote("ann", "ann", Role::Engineer);
    vec![
        ann(),
        vote("anna", "ann", Role::Engineer),
        vote("bob", "bob", Role::Engineer),
        vote("sam", "sam", Role::Safety),
        vote("olga", "olga", Role::Operator),
        vote("adam", "adam", Role::Admin),
        // The parties, under their own names and under others.
        vote("rita", "rita", Role::Safety),
        vote("margarita", "rita", Role::Safety),
        vote("arno", "arno", Role::Safety),
        vote("arnold", "arno", Role::Safety),
        vote("otto", "otto", Role::Safety),
        vote("ottokar", "otto", Role::Safety),
        with(ann(), false, |v| v.signature = SignatureCheck::Invalid),
        with(ann(), false, |v| v.nonce_used = true),
        with(ann(), false, |v| v.subject = subject("another")),
        with(ann(), true, |v| v.until = at(ENDS[0])),
        with(vote("bob", "bob", Role::Engineer), true, |v| v.answer = ApprovalDecision::Reject),
        with(vote("rita", "rita", Role::Safety), true, |v| v.answer = ApprovalDecision::Reject),
        with(ann(), true, |v| v.break_glass = true),
        with(vote("rita", "rita", Role::Safety), true, |v| v.break_glass = true),
        with(ann(), true, |v| {
            v.break_glass = true;
            v.reason = " ".to_owned();
        }),
    ]
}

fn request(risk: Risk, quorum: u8) -> QuorumRequest {
    QuorumRequest {
        subject: subject("this"),
        risk,
        quorum,
        requester: Requester::Person { name: "rita".to_owned(), key: "key of rita".to_owned() },
        author: Author {
            name: "arno".to_owned(),
            authorship: Authorship::Signed,
            key: "key of arno".to_owned(),
        },
        asked_by: Some(Requester::Person { name: "otto".to_owned(), key: "key of otto".to_owned() }),
        until: at(ENDS[1]),
    }
}

/// The humans a result may rest on, as the walk sees them, under any name.
fn counted<'a>(votes: &'a [&TrueVote], request: &QuorumRequest, now: WallTime) -> Vec<&'a TrueVote> {
    let counts = |one: &&&TrueVote| {
        let role = match request.risk {
            Risk::Low => one.vote.role != Role::Admin,
            Risk::Medium | Risk::High => matches!(one.vote.role, Role::Engineer | Role::Safety),
        };
        one.genuine
            && now < one.vote.until
            && one.vote.answer == ApprovalDecision::Approve
            && !PARTIES.contains(&one.human)
            && role
    };
    votes.iter().filter(counts).copied().collect()
}

/// The violated invariant of a result, if any.
fn problem(
    given: &[&TrueVote],
    request: &QuorumRequest,
    now: WallTime,
    settings: &ApprovalSettings,
    outcome: &ApprovalOutcome,
) -> Option<&'static str> {
    let counted = counted(given, request, now);
    let humans: BTreeSet<&str> = counted.iter().map(|one| one.human).collect();
    let officer = request.risk != Risk::High || counted.iter().any(|one| one.vote.role == Role::Safety);
    let enough = humans.len() >= usize::from(request.quorum) && officer;
    let opens = |one: &&TrueVote| one.vote.break_glass && !one.vote.reason.trim().is_empty();
    let emergency = settings.break_glass && counted.iter().any(opens);
    let refusal =
        |one: &&&TrueVote| one.genuine && one.vote.answer == ApprovalDecision::Reject && now < one.vote.until;
    let refused = given.iter().any(|one| refusal(&one));
    match outcome {
        ApprovalOutcome::NotNeeded => Some("no one is asked where people are needed"),
        ApprovalOutcome::Granted { .. } if refused => Some("granted over a refusal"),
        ApprovalOutcome::Granted { break_glass: false, .. } if !enough => {
            Some("granted without enough independent people of the roles that it takes")
        }
        ApprovalOutcome::Granted { break_glass: true, .. } if !emergency => {
            Some("granted by break-glass where it is off")
        }
        ApprovalOutcome::Granted { until, .. } if *until <= now => Some("granted, and over already"),
        ApprovalOutcome::Granted { .. } => None,
        ApprovalOutcome::Refused { .. } if !refused => Some("refused without a refusal"),
        ApprovalOutcome::Refused { .. } => None,
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut if refused => {
            Some("a refusal that does not count")
        }
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut if enough => {
            Some("held although enough people approved")
        }
        ApprovalOutcome::Pending { .. } if now >= request.until => Some("waits past its deadline"),
        ApprovalOutcome::TimedOut if now < request.until => Some("timed out before its deadline"),
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut => None,
    }
}

/// Walks every choice of up to `most` answers; returns the number of worlds and the first violation.
fn walk(rules: impl ApprovalRules, most: usize) -> (usize, Option<&'static str>) {
    let all = answers();
    let settings =
        [ProfileName::Human, ProfileName::Sim].map(|name| Profile::builtin(name).unwrap().approval);
    let times: Vec<WallTime> = ENDS.iter().flat_map(|end| [at(end - 1), at(*end)]).collect();
    let mut chosen: Vec<Vec<usize>> = vec![Vec::new()];
    let mut worlds = 0;
    for size in 0..=most {
        for choice in &chosen {
            let true_votes: Vec<&TrueVote> = choice.iter().map(|index| &all[*index]).collect();
            let votes: Vec<Vote> = true_votes.iter().map(|one| one.vote.clone()).collect();
            for (risk, quorum) in
                Risk::ALL.into_iter().flat_map(|risk| [1, 2, 3].map(|quorum| (risk, quorum)))
            {
                let request = request(risk, quorum);
                for (now, settings) in
                    times.iter().flat_map(|now| settings.iter().map(move |one| (*now, one)))
                {
                    worlds += 1;
                    let outcome = evaluate_under(rules, &request, &votes, now, settings).outcome;
                    if let Some(wrong) = problem(&true_votes, &request, now, settings, &outcome) {
                        return (worlds, Some(wrong));
                    }
                }
            }
        }
        if size < most {
            let longer = |choice: &Vec<usize>| {
                let from = choice.last().copied().unwrap_or(0);
                (from..all.len()).map(|next| [choice.as_slice(), &[next]].concat()).collect::<Vec<_>>()
            };
            chosen = chosen.iter().flat_map(longer).collect();
        }
    }
    (worlds, None)
}

#[test]
#[allow(
    clippy::disallowed_methods,
    reason = "the long walk is asked for from outside; the rules read no environment"
)]
fn no_person_approves_alone_or_twice() {
    let full = std::env::var("HOLDPOINT_WALK").is_ok_and(|value| value == "full");
    let (most, expected) = if full { (4, 1_366_200) } else { (3, 218_592) };
    assert_eq!(walk(AllApprovalRules, most), (expected, None));
}

/// Every rule but one.
#[derive(Clone, Copy)]
struct ApprovalRulesExcept(ApprovalRule);

impl ApprovalRules for ApprovalRulesExcept {
    fn demands(self, rule: ApprovalRule) -> bool {
        self.0 != rule
    }
}

#[test]
fn every_omitted_approval_rule_is_detected() {
    use ApprovalRule::{
        AskedBy, Author, Deadline, EmergencyAllowed, Expiry, Nonce, OneKey, Quorum, Refusal, Requester, Role,
        SafetyOfficer, Signature, Subject,
    };
    for rule in [
        Signature,
        Nonce,
        Subject,
        Expiry,
        Requester,
        Author,
        AskedBy,
        Role,
        OneKey,
        SafetyOfficer,
        Quorum,
        Refusal,
        Deadline,
        EmergencyAllowed,
    ] {
        let (_, found) = walk(ApprovalRulesExcept(rule), 3);
        assert!(found.is_some(), "the walk does not notice that {rule:?} is missing");
    }
}
