//! An approval request: the facts behind it, the lines that state them, and what an approver signs.
//!
//! The engine makes the facts and renders them, once for each signer and again after another person's answer. A front end
//! shows all these lines, nothing between them, and has their digest signed. Values that change every second are shown
//! apart, under "live, not signed".

mod question_refusal;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::command::Command;
use super::detail::VersionDiff;
use super::event::DimensionResult;
use super::request_kind::RequestKind;
use super::snapshot::ApprovalRequestView;
use holdpoint_approvals::{
    Approval, ApprovalError, DisplayBinding, Identity, Nonce, SignedFacts, facts_digest, lines_digest,
};
use holdpoint_governance::approval::{ApprovalDecision, Author, Requester, Role};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::evidence::{DrillKind, StaleCause};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::{ProfileName, SiteName};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::start_domain::{OutsideResponse, StartDomain};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::wall_time::WallTime;

pub use self::question_refusal::{AnswerVoidCause, QuestionRefusal};

/// The subject and the basis of an approval request: codes and values. Its canonical JSON is signed and stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ApprovalFacts {
    /// The approver who reads it, and whether their answer counts; absent if it is for no particular reader.
    pub asked: Option<RequestedSigner>,
    /// Id of the request.
    pub question: String,
    /// The kind of request.
    pub purpose: RequestKind,
    /// Its version.
    pub version: CapabilityId,
    /// The active version it would replace, or the rollback target; absent if there is none.
    pub replaces: Option<CapabilityId>,
    /// Name of the robot's description.
    pub robot: String,
    /// Digest of the candidate's manifest and bundle.
    pub candidate: Digest,
    /// The candidate's row version.
    pub row_version: u64,
    /// Digest of the evidence that the decision is over.
    pub evidence: Digest,
    /// Digest of profile and policies.
    pub policy: Digest,
    /// Profile of the activation.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    pub site: Option<SiteName>,
    /// The quorum.
    pub needed: u32,
    /// When the unanswered request expires; absent for break-glass, which does not wait.
    pub until: Option<WallTime>,
    /// Risk class, which decides whose approvals count.
    pub risk: Risk,
    /// The assessed risk class with its causes; absent before the assessment, which counts as high.
    pub assessed: Option<RiskClass>,
    /// The requester of the registration.
    pub requester: Requester,
    /// The author of the candidate, and how far that is verified.
    pub author: Author,
    /// The person who made this request; absent for an activation.
    pub asked_by: Option<String>,
    /// The subject of a release or a review, one sentence; empty for an activation.
    pub about: String,
    /// The author's own summary of the version; empty without one, and in facts of older builds.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub summary: String,
    /// The component that it runs; absent for code compiled into the engine, and in facts of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub component: Option<ComponentFacts>,
    /// The lifecycle state it is in.
    pub state: State,
    /// Its deployment outcome so far.
    pub deployment: Option<Deployability>,
    /// Why its evidence is stale; empty while it counts.
    pub stale: Vec<StaleCause>,
    /// The latest assessment of the four dimensions.
    pub dimensions: Vec<DimensionResult>,
    /// Paired episodes of the sandbox.
    pub pairs: Option<PairsFacts>,
    /// The try that its sandbox counted as; absent in requests of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counted: Option<CountedTry>,
    /// Sequences in shadow.
    pub shadow: Option<ShadowFacts>,
    /// What its evidence covers of the start of a task; absent before the sandbox, and in facts of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covers: Option<CoverageFacts>,
    /// Why approval is needed: the reasons that do not speak for the version.
    pub reasons: Vec<Reason>,
    /// What decided the failed ones of behavior and recovery, with the numbers; empty in facts of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<String>,
    /// What decided the other ones of behavior and recovery, with the numbers, as in the engine's explanation.
    pub why: Vec<String>,
    /// Permissions that the active version does not have, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version.
    pub changes: VersionDiff,
    /// The conditions of its activation.
    pub conditions: Vec<Condition>,
    /// What was not tested.
    pub untested: Vec<UntestedAspect>,
    /// The response if it gets worse after its activation; absent for a release or a review.
    pub on_drift: Option<DriftResponse>,
    /// The approvals that counted before, in order; empty in facts of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub signed_before: Vec<EarlierSignature>,
    /// What the reader's approval would do; absent if it would not count or none is missing, and in facts of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effect: Option<SignatureEffect>,
}

/// The component that a version runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ComponentFacts {
    /// Its path in the package.
    pub file: String,
    /// The code of the version it replaces, where its name is another one.
    pub replaces: Option<String>,
}

/// An approval of the same request that counted before.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EarlierSignature {
    /// Name of the identity.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// When it was recorded.
    pub at: WallTime,
    /// The reason, in the person's own words.
    pub reason: String,
}

/// What an approval of the reader would do to the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SignatureEffect {
    /// It completes the request, which then takes effect.
    Completes,
    /// The request waits for more people.
    MoreNeeded,
}

/// The approver.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RequestedSigner {
    /// Name of the identity.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// Why their approval would not count; absent if it would.
    pub void: Option<ReasonCode>,
}

/// Paired episodes of the sandbox: how many, and both versions' success with 95 % Wilson intervals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PairsFacts {
    /// How many.
    pub n: u64,
    /// The candidate's success rate.
    pub candidate: f64,
    /// Its interval.
    pub candidate_interval: [f64; 2],
    /// The active version's success rate.
    pub active: f64,
    /// Its interval.
    pub active_interval: [f64; 2],
}

/// Sequences in shadow: how many, and the three mean divergences, 0 to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShadowFacts {
    /// How many.
    pub n: u64,
    /// Of the commands.
    pub output: f64,
    /// Of the governance signals.
    pub governance: f64,
    /// Of the trajectory from the active version's band.
    pub envelope: f64,
}

/// What the evidence of a version covers of the start of a task, and the response outside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoverageFacts {
    /// The covered starts.
    pub domain: StartDomain,
    /// The profile's response to a task that starts outside.
    pub outside: OutsideResponse,
}

/// Something that was not tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "untested", content = "of")]
pub enum UntestedAspect {
    /// In the live cell, where an arm works.
    PhysicalArm,
    /// Not assessed by any stage.
    Everything,
    /// A dimension without a value.
    Unmeasured(Dimension),
    /// A dimension, whose value is an estimate.
    Estimated(Dimension),
    /// Episode by episode with the active version.
    Pairs,
    /// A kind of drill.
    Drill(DrillKind),
    /// In a twin of the live world.
    Twin,
}

/// The response if a version gets worse after its activation, and the condition of its confirmation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DriftResponse {
    /// The rollback target; absent if the family stops.
    pub back: Option<CapabilityId>,
    /// Whether the first warning of a chart rolls it back without asking an operator.
    pub coupled: bool,
    /// The share of speed and force that a drifting rate leaves it, 0 to 1.
    pub restricted_to: f64,
    /// Deadline of an answer to the escalation, s.
    pub answer_within_s: f64,
    /// Live tasks after which it is confirmed.
    pub confirmed_after: u32,
    /// Whether fresh evidence must settle a concern before the version is confirmed.
    pub in_doubt: bool,
    /// The levels of the charts, where they are stricter than the profile's.
    pub limits: Option<String>,
}

/// An approval request as rendered for one person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ApprovalDocument {
    /// All lines to show; the signature covers their digest.
    pub lines: Vec<String>,
    /// The facts behind the lines: canonical JSON of [`ApprovalFacts`]; the signature covers the digest.
    pub facts: String,
    /// Version of the renderer that made the lines of the facts.
    pub renderer: u32,
    /// Nonce of this request; the answer names it.
    pub request: Nonce,
    /// Id of the store; a decision signed for it counts in no other.
    pub store_id: String,
    /// Public key of the store, 64 hexadecimal digits; the signature covers it.
    pub store_key: String,
    /// When a decision signed now expires.
    pub valid_until: WallTime,
}

impl ApprovalDocument {
    /// The digest of its lines and facts.
    #[must_use]
    pub fn lines_digest(&self) -> Digest {
        lines_digest(&self.lines)
    }

    /// The facts that a decision repeats, if this is the requested document.
    ///
    /// # Errors
    /// [`ApprovalError::NoForm`] if it is another request, or another person's.
    pub fn bound(
        &self,
        version: &CapabilityId,
        purpose: RequestKind,
        who: &str,
    ) -> Result<SignedFacts, ApprovalError> {
        let bound = SignedFacts::read(&self.facts)?;
        let same = [
            (bound.version == *version, "version"),
            (bound.purpose == purpose.name(), "purpose"),
            (bound.asked.name == who, "person"),
        ];
        match same.into_iter().find(|(same, _)| !same) {
            None => Ok(bound),
            Some((_, what)) => Err(ApprovalError::NoForm(format!("it is the question of another {what}"))),
        }
    }

    /// The command by which `who` decides on it, over its lines and facts.
    ///
    /// # Errors
    /// [`ApprovalError`] if the facts cannot be read, or the system returns no random number for the nonce.
    pub fn answer(
        &self,
        who: &Identity,
        decision: ApprovalDecision,
        reason: &str,
    ) -> Result<Command, ApprovalError> {
        let bound = SignedFacts::read(&self.facts)?;
        let signed = who.sign(Approval {
            who: who.info().name.clone(),
            role: who.info().role,
            decision,
            reason: reason.to_owned(),
            break_glass: bound.is_emergency(),
            version: bound.version,
            candidate_digest: bound.candidate,
            row_version: bound.row_version,
            evidence_digest: bound.evidence,
            policy_digest: bound.policy,
            profile: bound.profile,
            store_id: self.store_id.clone(),
            nonce: Nonce::random()?,
            not_after_ms: self.valid_until.ms().unsigned_abs(),
            shown: Some(DisplayBinding {
                renderer: self.renderer,
                lines: self.lines_digest(),
                facts: facts_digest(&self.facts),
                store_key: self.store_key.clone(),
                request: self.request.clone(),
            }),
        })?;
        Ok(Command::Decide { signed: Box::new(signed) })
    }
}

impl ApprovalRequestView {
    /// The command by which `who` refuses without having read the request: a refusal needs no reading.
    ///
    /// # Errors
    /// [`ApprovalError`] if the system returns no random number for the nonce.
    pub fn refuse(&self, who: &Identity, reason: &str) -> Result<Command, ApprovalError> {
        let signed = who.sign(Approval {
            who: who.info().name.clone(),
            role: who.info().role,
            decision: ApprovalDecision::Reject,
            reason: reason.to_owned(),
            version: self.version.clone(),
            candidate_digest: self.candidate,
            row_version: self.row_version,
            evidence_digest: self.evidence,
            policy_digest: self.policy,
            profile: self.profile,
            store_id: self.store_id.clone(),
            nonce: Nonce::random()?,
            not_after_ms: self.valid_until.ms().unsigned_abs(),
            break_glass: false,
            shown: None,
        })?;
        Ok(Command::Decide { signed: Box::new(signed) })
    }
}
