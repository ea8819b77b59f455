//! Approvals: who counts, and when.

use holdpoint_governance::approval::{
    ApprovalDecision, ApprovalOutcome, Author, Authorship, QuorumRequest, Requester, Role, SignatureCheck,
    Subject, Vote, evaluate, quorum,
};
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Risk;

use crate::fixture::{at, digest, profile};

fn subject() -> Subject {
    Subject {
        candidate: digest("candidate"),
        row_version: 3,
        evidence: digest("evidence"),
        policy: digest("policy"),
        profile: digest("profile"),
    }
}

fn vote(person: &str) -> Vote {
    Vote {
        person: person.into(),
        key: format!("key of {person}"),
        role: Role::Engineer,
        answer: ApprovalDecision::Approve,
        reason: "looked at it".into(),
        subject: subject(),
        until: at(500),
        break_glass: false,
        signature: SignatureCheck::Valid,
        nonce_used: false,
    }
}

fn request(risk: Risk) -> QuorumRequest {
    QuorumRequest {
        subject: subject(),
        risk,
        quorum: 2,
        requester: Requester::Person { name: "rita".into(), key: "key of rita".into() },
        author: Author { name: "arno".into(), authorship: Authorship::Signed, key: "key of arno".into() },
        asked_by: Some(Requester::Person { name: "otto".into(), key: "key of otto".into() }),
        until: at(600),
    }
}

#[test]
fn invalid_approvals_do_not_count() {
    type VoteChange = fn(&mut Vote);
    let table: [(&str, VoteChange, ReasonCode); 15] = [
        ("forged", |v| v.signature = SignatureCheck::Invalid, ApprovalSignature),
        ("used", |v| v.nonce_used = true, ApprovalReplayed),
        ("other row", |v| v.subject.row_version = 2, ApprovalStale),
        ("other evidence", |v| v.subject.evidence = digest("x"), ApprovalStale),
        ("other policy", |v| v.subject.policy = digest("x"), ApprovalStale),
        ("other profile", |v| v.subject.profile = digest("x"), ApprovalStale),
        ("expired", |v| v.until = at(100), ApprovalExpired),
        ("requester", |v| v.person = "rita".into(), ApprovalSelf),
        ("author", |v| v.person = "arno".into(), ApprovalSelf),
        ("requester under another name", |v| v.key = "key of rita".into(), ApprovalSelf),
        ("author under another name", |v| v.key = "key of arno".into(), ApprovalSelf),
        ("who put the question", |v| v.person = "otto".into(), ApprovalSelf),
        ("who put the question, under another name", |v| v.key = "key of otto".into(), ApprovalSelf),
        ("same person", |v| v.person = "ann".into(), ApprovalDuplicate),
        ("role", |v| v.role = Role::Operator, ApprovalRole),
    ];
    let settings = profile(ProfileName::Human).approval;
    for (name, change, code) in table {
        let mut second = vote("bob");
        change(&mut second);
        let result = evaluate(&request(Risk::Medium), &[vote("ann"), second], at(100), &settings);
        assert_eq!(result.outcome, ApprovalOutcome::Pending { missing: 1 }, "{name}");
        assert!(result.reasons.iter().any(|reason| reason.code == code), "{name}: {:?}", result.reasons);
    }
}

#[test]
fn approval_outcomes_follow_quorum_rejection_and_time() {
    let human = profile(ProfileName::Human).approval;
    let sim = profile(ProfileName::Sim).approval;
    let no = |person: &str| Vote { answer: ApprovalDecision::Reject, ..vote(person) };
    let safety = |person: &str| Vote { role: Role::Safety, ..vote(person) };
    let glass = |person: &str| Vote { break_glass: true, ..vote(person) };
    let silent_glass = |person: &str| Vote { reason: " ".into(), ..glass(person) };
    for (name, risk, votes, now_s, settings, code) in [
        ("both", Risk::Medium, vec![vote("ann"), vote("bob")], 1, &human, ApprovalGranted),
        ("high needs safety", Risk::High, vec![vote("ann"), vote("bob")], 1, &human, ApprovalPending),
        ("high with safety", Risk::High, vec![vote("ann"), safety("bob")], 1, &human, ApprovalGranted),
        (
            "refusal outranks",
            Risk::Medium,
            vec![vote("ann"), vote("bob"), no("eve")],
            1,
            &human,
            ApprovalRefused,
        ),
        ("the author may refuse", Risk::Medium, vec![no("arno")], 1, &human, ApprovalRefused),
        ("nobody", Risk::Medium, vec![], 599, &human, ApprovalPending),
        ("too late", Risk::Medium, vec![], 600, &human, ApprovalTimeout),
        ("emergency", Risk::Medium, vec![glass("ann")], 1, &sim, ApprovalBreakGlass),
        ("emergency without a reason", Risk::Medium, vec![silent_glass("ann")], 1, &sim, ApprovalPending),
        ("no emergencies here", Risk::Medium, vec![glass("ann")], 1, &human, ApprovalPending),
    ] {
        let result = evaluate(&request(risk), &votes, at(now_s), settings);
        assert_eq!(result.reasons[0].code, code, "{name}: {result:?}");
        let granted = matches!(result.outcome, ApprovalOutcome::Granted { .. });
        assert_eq!(granted, matches!(code, ApprovalGranted | ApprovalBreakGlass), "{name}");
    }
    // The reason of a refusal is on record with it.
    let refused = evaluate(&request(Risk::Medium), &[no("eve")], at(1), &human);
    let words = Finding::Refused { person: "eve".into(), reason: "looked at it".into() };
    assert_eq!(refused.reasons[0].finding, Some(words));
    let no_quorum = QuorumRequest { quorum: 0, ..request(Risk::High) };
    assert_eq!(evaluate(&no_quorum, &[], at(1), &sim).outcome, ApprovalOutcome::NotNeeded);
}

#[test]
fn quorum_follows_risk_and_review() {
    let human = profile(ProfileName::Human).approval;
    let real = profile(ProfileName::Real).approval;
    for (settings, risk, review, people) in [
        (&human, Risk::Low, false, 1),
        (&human, Risk::Medium, false, 2),
        (&human, Risk::High, false, 2),
        (&human, Risk::Low, true, 2),
        (&real, Risk::Medium, false, 0),
        (&real, Risk::High, false, 1),
        // On a real cell, a version that needs a review is refused without a request.
        (&real, Risk::Low, true, 0),
    ] {
        assert_eq!(quorum(settings, risk, review), people, "{risk:?} {review}");
    }
}

/// One key under two names satisfied a quorum of two.
#[test]
fn two_names_with_one_key_are_one_person() {
    let alias = Vote { person: "anna".into(), ..vote("ann") };
    let result_of =
        |votes: &[Vote]| evaluate(&request(Risk::Low), votes, at(10), &profile(ProfileName::Human).approval);
    let result = result_of(&[vote("ann"), alias.clone()]);
    assert_eq!(result.outcome, ApprovalOutcome::Pending { missing: 1 });
    assert!(result.reasons.iter().any(|reason| reason.code == ApprovalDuplicate), "{:?}", result.reasons);
    let result = result_of(&[vote("ann"), alias, vote("ben")]);
    let ApprovalOutcome::Granted { people, .. } = result.outcome else { panic!("{:?}", result.outcome) };
    assert_eq!(people.into_iter().collect::<Vec<_>>(), ["ann", "ben"]);
    // Answers without a known key are distinguished by name.
    let unknown = |person: &str| Vote { key: String::new(), ..vote(person) };
    let result = result_of(&[unknown("ann"), unknown("ben")]);
    assert!(matches!(result.outcome, ApprovalOutcome::Granted { .. }), "{:?}", result.outcome);
}
