//! Approvals: what they bind to, how many are needed, and when they count.
//!
//! A total function over plain data: signatures are verified elsewhere and come in as a result, time comes in
//! as wall time. Source: design rule 3.10; paper section 5.2, stage 5.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason, ReasonCode};
use super::ids::Digest;
use super::profile::ApprovalSettings;
use super::submission::Risk;
use super::wall_time::WallTime;
use holdpoint_text::is_visible;

/// What an approval is over. A change of any of these voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subject {
    /// Digest of the candidate's manifest and bundle.
    pub candidate: Digest,
    /// The candidate's row version when people were asked: any later change of its row voids the approval.
    pub row_version: u64,
    /// Digest of the evidence that was on screen when the person decided.
    pub evidence: Digest,
    /// Digest of the compiled policy set in force.
    pub policy: Digest,
    /// Digest of the profile, every number included.
    pub profile: Digest,
}

crate::words! {
    /// What a person may decide about, by risk tier (see [`Role::reaches`]).
    Role, "role", {
        /// Runs the cell: low risk.
        Operator = "operator",
        /// Answers for the skill: low and medium risk, and high together with a safety officer.
        Engineer = "engineer",
        /// Answers for people's safety: every tier.
        Safety = "safety",
        /// Answers for who may decide: enrols people's keys and revokes them, and approves no version.
        Admin = "admin",
    }
}

impl Role {
    /// Whether this role's approval counts at a tier.
    #[must_use]
    pub const fn reaches(self, risk: Risk) -> bool {
        match (self, risk) {
            (Self::Operator, Risk::Low)
            | (Self::Engineer | Self::Safety, Risk::Low | Risk::Medium | Risk::High) => true,
            (Self::Operator, Risk::Medium | Risk::High)
            | (Self::Admin, Risk::Low | Risk::Medium | Risk::High) => false,
        }
    }

    /// Whether this role may let something go on, or give the arm work.
    #[must_use]
    pub const fn lets_go_on(self) -> bool {
        match self {
            Self::Operator | Self::Engineer | Self::Safety => true,
            Self::Admin => false,
        }
    }
}

/// Result of checking a vote's signature against its person's key; checked outside these rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SignatureCheck {
    /// It is the named person's, over exactly this content.
    Valid,
    /// It is not, or it could not be checked.
    Invalid,
}

crate::words! {
    /// What a person decided about a candidate.
    Answer, "approval decision", {
        /// For activation; counts towards the quorum if the person is independent and the role reaches the risk tier.
        Approve = "approve",
        /// Against it; one that counts refuses the candidate, whoever it comes from.
        Reject = "reject",
    }
}

/// One person's signed answer, with what was already found out about its signature and nonce.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vote {
    /// Name of the identity whose key signed it.
    pub person: String,
    /// The key that signed it, in hexadecimal digits: one key is one person, under whatever names.
    #[serde(default)]
    pub key: String,
    /// Role the identity had when it answered; it limits the risk tiers an approval counts for.
    pub role: Role,
    /// For or against activation.
    pub answer: Answer,
    /// Why, in the person's own words; needed for an emergency approval.
    pub reason: String,
    /// What the signature covers.
    pub subject: Subject,
    /// From when on it no longer counts.
    pub until: WallTime,
    /// Whether it is a break-glass (emergency) approval: counts alone, forces rollback coupling, opens a review.
    pub break_glass: bool,
    /// Whether the signature is the person's, as whoever holds the keys found it.
    pub signature: SignatureCheck,
    /// Whether the nonce was consumed by an earlier decision.
    pub nonce_used: bool,
}

/// Who asked for a version to be taken in: on record with its registration, and never among those who approve it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "by", deny_unknown_fields)]
pub enum Requester {
    /// An enrolled person, whose key signed the registration. In a script, the person its step names.
    Person {
        /// Name of the identity.
        name: String,
        /// The public key, hexadecimal digits; empty where a script names somebody without a key.
        key: String,
    },
    /// A script whose step names nobody.
    Script,
    /// The program itself: a version that a cell is commissioned with.
    Program,
    /// The registration was not signed, or an earlier version of the program did not keep who signed it.
    #[default]
    Unknown,
}

impl Requester {
    /// How the requester is named on screen and in messages.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Person { name, .. } => name,
            Self::Script => "script",
            Self::Program => "holdpoint",
            Self::Unknown => "not known",
        }
    }

    /// Whether this is the person: by name, or by key, for one key is one person.
    #[must_use]
    pub fn is(&self, person: &str, key: &str) -> bool {
        match self {
            Self::Person { name, key: own } => name == person || (!own.is_empty() && own == key),
            Self::Script | Self::Program | Self::Unknown => false,
        }
    }
}

crate::words! {
    /// How far it is known who wrote a version.
    Authorship, "authorship", {
        /// The author's enrolled key signed the version, or the author registered it.
        Signed = "signed",
        /// An enrolled person has the name that the submission gives; their key did not sign it.
        Named = "named",
        /// The name is free text: no enrolled key stands behind it.
        Unverified = "unverified",
    }
}

/// Who wrote a version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Author {
    /// The name in the submission.
    pub name: String,
    /// How far that is known.
    pub authorship: Authorship,
    /// The author's public key, hexadecimal digits; empty where none is known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub key: String,
}

impl Author {
    /// Whether this is the person. A name that no enrolled key stands behind is no enrolled person's.
    #[must_use]
    pub fn is(&self, person: &str, key: &str) -> bool {
        self.name == person || (!self.key.is_empty() && self.key == key)
    }

    /// The name with what is known of it, e.g. `ada (unverified)`.
    #[must_use]
    pub fn in_words(&self) -> String {
        format!("{} ({})", self.name, self.authorship)
    }
}

/// A question put to people: about which candidate and evidence, how many have to agree, and who cannot be one of
/// them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// The candidate and the circumstances people are asked about.
    pub subject: Subject,
    /// Risk class of the candidate, which decides the roles that count.
    pub risk: Risk,
    /// Distinct people needed (see [`quorum`]).
    pub quorum: u8,
    /// Who registered the candidate; cannot approve.
    pub requester: Requester,
    /// Who wrote the candidate; cannot approve.
    pub author: Author,
    /// The person who put this very question: asked for a release, or used the emergency door whose review it is.
    /// Cannot approve; absent for an activation.
    pub asked_by: Option<Requester>,
    /// From when on nobody's answer comes in time: the profile's `approval.timeout_s` after it was asked.
    pub until: WallTime,
}

/// What asking people came to, at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "approval")]
pub enum ApprovalOutcome {
    /// The quorum is 0: the profile asks nobody for this.
    NotNeeded,
    /// Enough distinct people approved, or one by break-glass.
    Granted {
        /// Names of the identities whose approvals counted, sorted.
        people: BTreeSet<String>,
        /// From when on the grant no longer holds: the earliest end among the votes.
        until: WallTime,
        /// Whether it was granted by break-glass, which forces rollback coupling and a review.
        break_glass: bool,
    },
    /// Held: people are still to answer.
    Pending {
        /// How many more people have to approve, 1 or more.
        missing: u8,
    },
    /// Held: the question's time ran out before the quorum was reached.
    TimedOut,
    /// One person's refusal counted; the candidate is rejected.
    Refused {
        /// Name of the identity that refused.
        person: String,
    },
}

/// The outcome of asking people, with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApprovalResult {
    /// What counting the votes came to.
    pub outcome: ApprovalOutcome,
    /// Why, with one reason for every answer that did not count.
    pub reasons: Vec<Reason>,
}

impl ApprovalResult {
    /// Whether one person granted it by the emergency door.
    #[must_use]
    pub const fn is_emergency(&self) -> bool {
        matches!(self.outcome, ApprovalOutcome::Granted { break_glass: true, .. })
    }
}

/// People who have to review an emergency activation: two, neither who broke the glass nor the author.
pub const REVIEWERS: u8 = 2;

/// Distinct people needed: by risk class, and at least the review's quorum if a dimension asked for a review.
#[must_use]
pub fn quorum(settings: &ApprovalSettings, risk: Risk, review: bool) -> u8 {
    let tier = settings.quorum(risk);
    if review { tier.max(settings.quorum_review) } else { tier }
}

/// Counts the answers (total: every input gives an outcome, and none but a full quorum grants).
///
/// An answer counts if its signature is valid, its nonce unused, it is over exactly this subject and not
/// expired. An approval must also come from somebody else than requester, author and who put the question, whose role
/// reaches the class; high risk needs a safety officer among them. Two names with one key are one person, who counts once.
/// A refusal that counts refuses, by whichever person.
#[must_use]
pub fn evaluate(
    request: &Request,
    votes: &[Vote],
    now: WallTime,
    settings: &ApprovalSettings,
) -> ApprovalResult {
    evaluate_under(AllRules, request, votes, now, settings)
}

/// The approvals that count towards a question's quorum, one for each person, in the order of the votes.
#[must_use]
pub fn counted<'a>(request: &Request, votes: &'a [Vote], now: WallTime) -> Vec<&'a Vote> {
    let mut counted: Vec<&Vote> = Vec::new();
    for vote in votes {
        let counts = vote.answer == Answer::Approve
            && void(AllRules, vote, request, now).is_none()
            && not_independent(AllRules, vote, request).is_none();
        let same =
            |other: &&Vote| other.person == vote.person || (!vote.key.is_empty() && other.key == vote.key);
        if counts && !counted.iter().any(same) {
            counted.push(vote);
        }
    }
    counted
}

/// One rule of counting each; the model walk leaves out one after the other and has to notice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ApprovalRule {
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
}

/// Which rules are demanded: all, but in the walk's mutants.
pub(crate) trait ApprovalRules: Copy {
    fn demands(self, rule: ApprovalRule) -> bool;
}

#[derive(Clone, Copy)]
pub(crate) struct AllRules;

impl ApprovalRules for AllRules {
    fn demands(self, _: ApprovalRule) -> bool {
        true
    }
}

fn evaluate_under(
    rules: impl ApprovalRules,
    request: &Request,
    votes: &[Vote],
    now: WallTime,
    settings: &ApprovalSettings,
) -> ApprovalResult {
    let mut reasons = Vec::new();
    let reason = |code, text: String| Reason::new(code, Dimension::Approval, text);
    if request.quorum == 0 {
        let text = "the profile asks nobody for this".to_owned();
        return ApprovalResult {
            outcome: ApprovalOutcome::NotNeeded,
            reasons: vec![reason(ReasonCode::ApprovalNotNeeded, text)],
        };
    }
    let mut people: BTreeSet<&str> = BTreeSet::new();
    let mut keys: BTreeSet<&str> = BTreeSet::new();
    let mut safety = false;
    let mut glass: Option<&Vote> = None;
    let mut until: Option<WallTime> = None;
    for vote in votes {
        if let Some((code, text)) = void(rules, vote, request, now) {
            reasons.push(reason(code, format!("the answer of {:?} does not count: {text}", vote.person)));
            continue;
        }
        if vote.answer == Answer::Reject && rules.demands(ApprovalRule::Refusal) {
            reasons.insert(0, reason(ReasonCode::ApprovalRefused, format!("{:?} refused", vote.person)));
            return ApprovalResult {
                outcome: ApprovalOutcome::Refused { person: vote.person.clone() },
                reasons,
            };
        }
        if let Some((code, text)) = not_independent(rules, vote, request) {
            reasons.push(reason(code, format!("the approval of {:?} does not count: {text}", vote.person)));
            continue;
        }
        // An answer without a key is nobody's but its name's.
        let same_key = !vote.key.is_empty() && keys.contains(vote.key.as_str());
        let is_duplicate =
            (same_key && rules.demands(ApprovalRule::OneKey)) || people.contains(vote.person.as_str());
        if is_duplicate {
            let text = if people.contains(vote.person.as_str()) {
                format!("{:?} answered twice and counts once", vote.person)
            } else {
                format!("{:?} has the key of somebody who answered, and counts once with them", vote.person)
            };
            reasons.push(reason(ReasonCode::ApprovalDuplicate, text));
            continue;
        }
        people.insert(&vote.person);
        keys.insert(&vote.key);
        let emergencies = settings.break_glass || !rules.demands(ApprovalRule::EmergencyAllowed);
        if vote.break_glass && emergencies && is_visible(&vote.reason) {
            glass = Some(vote);
        }
        safety |= vote.role == Role::Safety;
        until = Some(until.map_or(vote.until, |until| until.min(vote.until)));
    }
    let wanted = if rules.demands(ApprovalRule::Quorum) { usize::from(request.quorum) } else { 1 };
    let officer = request.risk != Risk::High || safety || !rules.demands(ApprovalRule::SafetyOfficer);
    let enough = people.len() >= wanted && officer;
    if enough || glass.is_some() {
        let break_glass = !enough;
        let code = if break_glass { ReasonCode::ApprovalBreakGlass } else { ReasonCode::ApprovalGranted };
        let text =
            if break_glass { "the emergency door was used" } else { "enough distinct people approved" };
        #[allow(clippy::cast_precision_loss, reason = "people are few")]
        let granted = reason(code, text.into()).with(people.len() as f64, f64::from(request.quorum));
        reasons.insert(0, granted);
        let until = match glass {
            Some(vote) if break_glass => vote.until.min(now.plus_secs(settings.break_glass_valid_s)),
            // Without a vote nothing is granted: a quorum is at least 1.
            Some(_) | None => until.unwrap_or(now),
        };
        let people = people.into_iter().map(ToOwned::to_owned).collect();
        return ApprovalResult { outcome: ApprovalOutcome::Granted { people, until, break_glass }, reasons };
    }
    if now >= request.until && rules.demands(ApprovalRule::Deadline) {
        let text = format!("too few people answered by {}; the version is held", request.until);
        reasons.insert(0, reason(ReasonCode::ApprovalTimeout, text));
        return ApprovalResult { outcome: ApprovalOutcome::TimedOut, reasons };
    }
    let count = u8::try_from(people.len()).unwrap_or(u8::MAX);
    let missing = request.quorum.saturating_sub(count).max(1);
    let text = if people.len() >= wanted && !officer {
        "the approval of a safety officer is missing".to_owned()
    } else {
        "approvals are missing".to_owned()
    };
    let pending = reason(ReasonCode::ApprovalPending, text).with(f64::from(count), f64::from(request.quorum));
    reasons.insert(0, pending);
    ApprovalResult { outcome: ApprovalOutcome::Pending { missing }, reasons }
}

/// Why an answer counts neither as approval nor as refusal.
fn void(
    rules: impl ApprovalRules,
    vote: &Vote,
    request: &Request,
    now: WallTime,
) -> Option<(ReasonCode, &'static str)> {
    use ApprovalRule::{Expiry, Nonce, Signature, Subject};
    if rules.demands(Signature) && vote.signature != SignatureCheck::Valid {
        Some((ReasonCode::ApprovalSignature, "the signature is not theirs"))
    } else if rules.demands(Nonce) && vote.nonce_used {
        Some((ReasonCode::ApprovalReplayed, "it was used before"))
    } else if rules.demands(Subject) && vote.subject != request.subject {
        Some((
            ReasonCode::ApprovalStale,
            "it is over another version, row version, evidence, policy or profile",
        ))
    } else if rules.demands(Expiry) && now >= vote.until {
        Some((ReasonCode::ApprovalExpired, "it has expired"))
    } else {
        None
    }
}

/// Why an approval does not count although the answer does.
fn not_independent(
    rules: impl ApprovalRules,
    vote: &Vote,
    request: &Request,
) -> Option<(ReasonCode, &'static str)> {
    use ApprovalRule::{AskedBy, Author, Requester, Role};
    let (person, key) = (vote.person.as_str(), vote.key.as_str());
    if rules.demands(Requester) && request.requester.is(person, key) {
        Some((ReasonCode::ApprovalSelf, "they registered the version, and so cannot approve it"))
    } else if rules.demands(Author) && request.author.is(person, key) {
        Some((ReasonCode::ApprovalSelf, "they wrote the version, and so cannot approve it"))
    } else if rules.demands(AskedBy) && request.asked_by.as_ref().is_some_and(|asker| asker.is(person, key)) {
        Some((ReasonCode::ApprovalSelf, "they asked for this themselves, and so cannot approve it"))
    } else if rules.demands(Role) && !vote.role.reaches(request.risk) {
        Some((ReasonCode::ApprovalRole, "the role does not reach this risk tier"))
    } else {
        None
    }
}

#[cfg(test)]
mod walk;
