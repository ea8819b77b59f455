//! Approvals: their binding, the quorum, and their validity.
//!
//! A total function over plain data: signatures are verified elsewhere and come in as a result, time comes in
//! as wall time. Source: design rule 3.10; paper section 5.2, stage 5.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason};
use super::finding::{Finding, VoteFlaw};
use super::ids::Digest;
use super::profile::ApprovalSettings;
use super::submission::Risk;
use super::wall_time::WallTime;
use holdpoint_text::is_visible;

/// The content that an approval covers. A change of any of these voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subject {
    /// Digest of the candidate's manifest and bundle.
    pub candidate: Digest,
    /// The candidate's row version at the request: any later change of its row voids the approval.
    pub row_version: u64,
    /// Digest of the evidence that was on screen when the person decided.
    pub evidence: Digest,
    /// Digest of the compiled policy set in force.
    pub policy: Digest,
    /// Digest of the profile, every number included.
    pub profile: Digest,
}

crate::closed_set! {
    /// The decisions a person may make, by risk tier (see [`Role::reaches`]).
    Role, "role", {
        /// Runs the cell: low risk.
        Operator = "operator",
        /// Answers for the skill: low and medium risk, and high together with a safety officer.
        Engineer = "engineer",
        /// Answers for people's safety: every tier.
        Safety = "safety",
        /// Decides who may decide: adds and revokes people's keys, and approves no version.
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

    /// Whether this role may resume something, or give the arm work.
    #[must_use]
    pub const fn may_resume(self) -> bool {
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

crate::closed_set! {
    /// A person's decision about a candidate.
    ApprovalDecision, "approval decision", {
        /// For activation; counts toward the quorum if the person is independent and the role reaches the risk tier.
        Approve = "approve",
        /// Against it; one that counts refuses the candidate, from any person.
        Reject = "reject",
    }
}

/// One person's signed answer, with the checks of its signature and nonce.
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
    pub answer: ApprovalDecision,
    /// Why, in the person's own words; needed for an emergency approval.
    pub reason: String,
    /// The content that the signature covers.
    pub subject: Subject,
    /// From when on it no longer counts.
    pub until: WallTime,
    /// Whether it is a break-glass (emergency) approval: counts alone, forces rollback coupling, opens a review.
    pub break_glass: bool,
    /// Whether the signature is the person's, as the keeper of the keys verified it.
    pub signature: SignatureCheck,
    /// Whether the nonce was consumed by an earlier decision.
    pub nonce_used: bool,
}

/// The requester of a registration: recorded with it, and never an approver of the version.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "by", deny_unknown_fields)]
pub enum Requester {
    /// An enrolled person whose key signed the registration. In a script, the person its step names.
    Person {
        /// Name of the identity.
        name: String,
        /// The public key, hexadecimal digits; empty where a script names a person without a key.
        key: String,
    },
    /// A script whose step names no person.
    Script,
    /// The program itself: a version that a cell is commissioned with.
    Program,
    /// The registration is unsigned, or an earlier version of the program did not record its signer.
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
            Self::Unknown => "no one on record",
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

crate::closed_set! {
    /// How far the author of a version is verified.
    Authorship, "authorship", {
        /// The author's enrolled key signed the version, or the author registered it.
        Signed = "signed",
        /// An enrolled person has the name that the submission gives; their key did not sign it.
        Named = "named",
        /// The name is free text without an enrolled key.
        Unverified = "unverified",
    }
}

/// The author of a version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Author {
    /// The name in the submission.
    pub name: String,
    /// How far that is known.
    pub authorship: Authorship,
    /// The author's public key, hexadecimal digits; empty if unknown.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub key: String,
}

impl Author {
    /// Whether this is the person. A name without an enrolled key matches no enrolled person.
    #[must_use]
    pub fn is(&self, person: &str, key: &str) -> bool {
        self.name == person || (!self.key.is_empty() && self.key == key)
    }

    /// The name with its verification, e.g. `ada (unverified)`.
    #[must_use]
    pub fn label(&self) -> String {
        format!("{} ({})", self.name, self.authorship)
    }
}

/// A question put to people: about which candidate and evidence, how many have to agree, and who cannot be one of
/// them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuorumRequest {
    /// The candidate and the circumstances of the request.
    pub subject: Subject,
    /// Risk class of the candidate, which decides the roles that count.
    pub risk: Risk,
    /// Distinct people needed (see [`quorum`]).
    pub quorum: u8,
    /// The requester of the registration; cannot approve.
    pub requester: Requester,
    /// The author of the candidate; cannot approve.
    pub author: Author,
    /// The person who made this request: asked to lift a restriction, or used the break-glass under review. Cannot
    /// approve; absent for an activation.
    pub asked_by: Option<Requester>,
    /// Deadline of answers: the profile's `approval.timeout_s` after the request.
    pub until: WallTime,
}

/// The result of a request at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "approval")]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum ApprovalOutcome {
    /// The quorum is 0: the profile requires no approval.
    NotNeeded,
    /// Enough distinct people approved, or one by break-glass, which forces rollback coupling and a review. Has the
    /// names whose approvals counted, sorted, and the earliest end among their votes.
    Granted { people: BTreeSet<String>, until: WallTime, break_glass: bool },
    /// On hold: at least one more person has to approve.
    Pending { missing: u8 },
    /// On hold: the request expired before the quorum was reached.
    TimedOut,
    /// One person's refusal counted; the candidate is rejected.
    Refused { person: String },
}

/// The outcome of asking people, with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApprovalResult {
    /// The result of counting the votes.
    pub outcome: ApprovalOutcome,
    /// Why, with one reason for every answer that did not count.
    pub reasons: Vec<Reason>,
}

impl ApprovalResult {
    /// Whether one person granted it by break-glass.
    #[must_use]
    pub const fn is_emergency(&self) -> bool {
        matches!(self.outcome, ApprovalOutcome::Granted { break_glass: true, .. })
    }
}

/// Reviewers of a break-glass activation: two, neither its signer nor the author.
pub const REVIEWERS: u8 = 2;

/// The quorum by risk class, and at least the review's quorum if a dimension requires a review.
#[must_use]
pub fn quorum(settings: &ApprovalSettings, risk: Risk, review: bool) -> u8 {
    let tier = settings.quorum(risk);
    if review { tier.max(settings.quorum_review) } else { tier }
}

/// Counts the answers (total: every input gives an outcome, and only a full quorum grants).
///
/// An answer counts if its signature is valid, its nonce unused, its subject exactly this one and its time not over.
/// An approver must also differ from requester, author and the person who made the request, and have a role that
/// reaches the class; high risk needs a safety officer among them. Two names with one key are one person, who counts
/// once. One refusal that counts refuses.
#[must_use]
pub fn evaluate(
    request: &QuorumRequest,
    votes: &[Vote],
    now: WallTime,
    settings: &ApprovalSettings,
) -> ApprovalResult {
    evaluate_under(AllApprovalRules, request, votes, now, settings)
}

/// The approvals that count toward a request's quorum, one for each person, in the order of the votes.
#[must_use]
pub fn counted<'a>(request: &QuorumRequest, votes: &'a [Vote], now: WallTime) -> Vec<&'a Vote> {
    let mut counted: Vec<&Vote> = Vec::new();
    for vote in votes {
        let counts = vote.answer == ApprovalDecision::Approve
            && void(AllApprovalRules, vote, request, now).is_none()
            && not_independent(AllApprovalRules, vote, request).is_none();
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

/// The rules in force: all, except in the walk's mutants.
pub(crate) trait ApprovalRules: Copy {
    fn demands(self, rule: ApprovalRule) -> bool;
}

#[derive(Clone, Copy)]
pub(crate) struct AllApprovalRules;

impl ApprovalRules for AllApprovalRules {
    fn demands(self, _: ApprovalRule) -> bool {
        true
    }
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Approval, finding)
}

fn answer_void(vote: &Vote, flaw: VoteFlaw) -> Reason {
    let finding = Finding::AnswerVoid { person: vote.person.clone(), flaw };
    Reason::coded(flaw.code(), Dimension::Approval, finding)
}

fn evaluate_under(
    rules: impl ApprovalRules,
    request: &QuorumRequest,
    votes: &[Vote],
    now: WallTime,
    settings: &ApprovalSettings,
) -> ApprovalResult {
    let mut reasons = Vec::new();
    if request.quorum == 0 {
        return ApprovalResult {
            outcome: ApprovalOutcome::NotNeeded,
            reasons: vec![reason(Finding::ApprovalNotNeeded)],
        };
    }
    let mut people: BTreeSet<&str> = BTreeSet::new();
    let mut keys: BTreeSet<&str> = BTreeSet::new();
    let mut safety = false;
    let mut glass: Option<&Vote> = None;
    let mut until: Option<WallTime> = None;
    for vote in votes {
        if let Some(flaw) = void(rules, vote, request, now) {
            reasons.push(answer_void(vote, flaw));
            continue;
        }
        if vote.answer == ApprovalDecision::Reject && rules.demands(ApprovalRule::Refusal) {
            let person = vote.person.clone();
            let refused = Finding::Refused { person: person.clone(), reason: vote.reason.clone() };
            reasons.insert(0, reason(refused));
            return ApprovalResult { outcome: ApprovalOutcome::Refused { person }, reasons };
        }
        if let Some(flaw) = not_independent(rules, vote, request) {
            reasons.push(answer_void(vote, flaw));
            continue;
        }
        // An answer without a key is identified by its name alone.
        let same_key = !vote.key.is_empty() && keys.contains(vote.key.as_str());
        let is_duplicate =
            (same_key && rules.demands(ApprovalRule::OneKey)) || people.contains(vote.person.as_str());
        if is_duplicate {
            let person = vote.person.clone();
            reasons.push(reason(if people.contains(person.as_str()) {
                Finding::AnsweredTwice { person }
            } else {
                Finding::KeyShared { person }
            }));
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
    let required = if rules.demands(ApprovalRule::Quorum) { usize::from(request.quorum) } else { 1 };
    let officer = request.risk != Risk::High || safety || !rules.demands(ApprovalRule::SafetyOfficer);
    let enough = people.len() >= required && officer;
    if enough || glass.is_some() {
        let break_glass = !enough;
        let finding = if break_glass { Finding::BreakGlassUsed } else { Finding::QuorumReached };
        let granted = reason(finding).with(people.len() as f64, f64::from(request.quorum));
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
        reasons.insert(0, reason(Finding::DeadlinePassed { until: request.until }));
        return ApprovalResult { outcome: ApprovalOutcome::TimedOut, reasons };
    }
    let count = u8::try_from(people.len()).unwrap_or(u8::MAX);
    let missing = request.quorum.saturating_sub(count).max(1);
    let finding = if people.len() >= required && !officer {
        Finding::SafetyOfficerMissing
    } else {
        Finding::ApprovalsMissing
    };
    let pending = reason(finding).with(f64::from(count), f64::from(request.quorum));
    reasons.insert(0, pending);
    ApprovalResult { outcome: ApprovalOutcome::Pending { missing }, reasons }
}

/// Why an answer counts neither as approval nor as refusal.
fn void(rules: impl ApprovalRules, vote: &Vote, request: &QuorumRequest, now: WallTime) -> Option<VoteFlaw> {
    use ApprovalRule::{Expiry, Nonce, Signature, Subject};
    if rules.demands(Signature) && vote.signature != SignatureCheck::Valid {
        Some(VoteFlaw::Signature)
    } else if rules.demands(Nonce) && vote.nonce_used {
        Some(VoteFlaw::Replayed)
    } else if rules.demands(Subject) && vote.subject != request.subject {
        Some(VoteFlaw::Stale)
    } else if rules.demands(Expiry) && now >= vote.until {
        Some(VoteFlaw::Expired)
    } else {
        None
    }
}

/// Why an approval does not count although the answer does.
fn not_independent(rules: impl ApprovalRules, vote: &Vote, request: &QuorumRequest) -> Option<VoteFlaw> {
    use ApprovalRule::{AskedBy, Author, Requester, Role};
    let (person, key) = (vote.person.as_str(), vote.key.as_str());
    if rules.demands(Requester) && request.requester.is(person, key) {
        Some(VoteFlaw::Requester)
    } else if rules.demands(Author) && request.author.is(person, key) {
        Some(VoteFlaw::Author)
    } else if rules.demands(AskedBy) && request.asked_by.as_ref().is_some_and(|asker| asker.is(person, key)) {
        Some(VoteFlaw::AskedBy)
    } else if rules.demands(Role) && !vote.role.reaches(request.risk) {
        Some(VoteFlaw::Role)
    } else {
        None
    }
}

#[cfg(test)]
mod walk;
