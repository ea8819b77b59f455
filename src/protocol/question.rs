//! A question to people: the facts behind it, the lines that say them, and what somebody who answers signs.
//!
//! The engine makes the facts and renders them, once for each signer. A front end shows the lines that it was given, all of
//! them and nothing between them, and has their digest signed. What changes by the second is no part of them: it stands
//! apart, headed "live, not signed" ([`live_lines`]).

mod lines;
mod live;

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::command::Command;
use super::detail::Changes;
use super::event::DimensionResult;
use super::purpose::Purpose;
use super::snapshot::PromptView;
use holdpoint_approvals::{
    Approval, ApprovalError, BoundFacts, Identity, Nonce, ShownQuestion, facts_digest, lines_digest,
};
use holdpoint_governance::approval::{Answer, Author, Requester, Role};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, StaleCause};
use holdpoint_governance::ids::{CapabilityId, Digest, canonical_json};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::{ProfileName, SiteName};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::submission::Risk;
use holdpoint_governance::vocabulary::Deployability;
use holdpoint_governance::wall_time::WallTime;

pub use lines::{RENDERER_VERSION, render};
pub use live::{LIVE_HEADING, live_lines};

/// What a question is about and rests on: codes and values. Its canonical JSON is what is signed and kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuestionFacts {
    /// Who is asked, and what their answer would count for; absent where nobody in particular reads.
    pub asked: Option<AskedPerson>,
    /// Id of the question.
    pub question: String,
    /// What is asked.
    pub purpose: Purpose,
    /// The version it is about.
    pub version: CapabilityId,
    /// The active version it would replace, or the way back from it; absent if there is none.
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
    /// Profile that it would be under.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    pub site: Option<SiteName>,
    /// Distinct people who have to approve.
    pub needed: u32,
    /// When the unanswered question ends; absent for an emergency, which nobody waits for.
    pub until: Option<WallTime>,
    /// Risk class that decides whose approvals count.
    pub risk: Risk,
    /// The risk class as it was assessed, with its causes; absent before it was, which counts as high.
    pub assessed: Option<RiskClass>,
    /// Who registered the candidate.
    pub requester: Requester,
    /// Who wrote the candidate, and how far that is known.
    pub author: Author,
    /// Who put this very question; absent for an activation.
    pub asked_by: Option<String>,
    /// What a release or a review is about, one sentence; empty for an activation.
    pub about: String,
    /// The lifecycle state it is in.
    pub state: State,
    /// Which of the paper's four deployment outcomes it comes to so far.
    pub deployment: Option<Deployability>,
    /// Why what was measured of it does not count any more; empty while it does.
    pub stale: Vec<StaleCause>,
    /// The four dimensions as they were last assessed.
    pub dimensions: Vec<DimensionResult>,
    /// Paired episodes of the sandbox.
    pub pairs: Option<PairsFacts>,
    /// Sequences in shadow.
    pub shadow: Option<ShadowFacts>,
    /// Why people are asked: the reasons that do not speak for it.
    pub reasons: Vec<Reason>,
    /// What decided on behaviour and recovery, with the numbers, as the engine's explanation has it.
    pub why: Vec<String>,
    /// Permissions that the active version does not have, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version.
    pub changes: Changes,
    /// What it would be let in under.
    pub conditions: Vec<Condition>,
    /// What was not tested.
    pub untested: Vec<Untested>,
    /// What happens when it gets worse after its activation; absent for a release or a review.
    pub on_drift: Option<OnDrift>,
}

/// Who is asked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AskedPerson {
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
    /// The candidate's share of successes.
    pub candidate: f64,
    /// Its interval.
    pub candidate_interval: [f64; 2],
    /// The active version's share.
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

/// Something that was not tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "untested", content = "of")]
pub enum Untested {
    /// On a physical arm.
    PhysicalArm,
    /// Anything: no stage assessed it.
    Everything,
    /// A dimension, of which there is no value.
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

impl fmt::Display for Untested {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PhysicalArm => {
                f.write_str("It was not tried on a physical arm: everything was measured in simulation")
            }
            Self::Everything => f.write_str("Nothing was assessed yet"),
            Self::Unmeasured(what) => {
                write!(f, "There is no value for {}: it was not measured", compatibility(*what))
            }
            Self::Estimated(what) => {
                write!(f, "The value for {} is an estimate, not measured", compatibility(*what))
            }
            Self::Pairs => f.write_str("It was not compared with the active version episode by episode"),
            Self::Drill(kind) => write!(f, "No {} drill was carried out with it", kind.name()),
            Self::Twin => f.write_str("It was not run in a twin of the live world"),
        }
    }
}

const fn compatibility(of: Dimension) -> &'static str {
    match of {
        Dimension::Interface => "interface compatibility",
        Dimension::Policy => "policy compatibility",
        Dimension::Behavior => "behaviour",
        other => other.words(),
    }
}

/// What happens when a version gets worse after its activation, and what confirms it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OnDrift {
    /// The version that takes over again; absent if the family stops.
    pub back: Option<CapabilityId>,
    /// Whether the first warning of a chart takes it off without asking.
    pub coupled: bool,
    /// To what share of speed and force a drifting rate lowers it, 0 to 1.
    pub restricted_to: f64,
    /// How long people have to answer the monitor then, s.
    pub answer_within_s: f64,
    /// Live tasks after which it is confirmed.
    pub confirmed_after: u32,
    /// Whether a doubt it is let in with has to be settled on fresh evidence before.
    pub in_doubt: bool,
    /// The levels of the charts, where they are stricter than the profile's.
    pub limits: Option<String>,
}

impl fmt::Display for OnDrift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let back = self.back.as_ref().map_or_else(
            || "it is taken off and the family stops, for there is no way back".to_owned(),
            |id| format!("{id} takes over again"),
        );
        if self.coupled {
            write!(f, "after a safety event or the first warning of a chart {back}, and nobody is asked")?;
        } else {
            write!(
                f,
                "after a safety event or an established rise of a rate {back}; a drifting rate lowers speed and force \
                 to {:.0} % and asks people, for {:.0} s",
                100.0 * self.restricted_to,
                self.answer_within_s
            )?;
        }
        // The live window alone settles no doubt.
        let settled = if self.in_doubt {
            " and once the doubt it is let in with is settled on fresh evidence"
        } else {
            ""
        };
        write!(f, "; confirmed after {} live tasks{settled}", self.confirmed_after)?;
        self.limits.as_ref().map_or(Ok(()), |limits| write!(f, "; {limits}"))
    }
}

/// A question as one person gets it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuestionView {
    /// What is to be shown, all of it, line by line; the signature covers the digest.
    pub lines: Vec<String>,
    /// The facts behind the lines: canonical JSON of [`QuestionFacts`]; the signature covers the digest.
    pub facts: String,
    /// Version of the renderer that made the lines of the facts.
    pub renderer: u32,
    /// Nonce of this request; the answer names it.
    pub request: Nonce,
    /// Id of the store; a decision signed for it counts in no other.
    pub store_id: String,
    /// Public key of the store, 64 hexadecimal digits; the signature covers it.
    pub store_key: String,
    /// Until when a decision signed now is good.
    pub valid_until: WallTime,
}

impl QuestionView {
    /// Lines and text of facts.
    ///
    /// # Errors
    /// If a fact has no JSON form.
    pub fn texts(facts: &QuestionFacts) -> Result<(Vec<String>, String), serde_json::Error> {
        Ok((render(facts), canonical_json(facts)?))
    }

    /// The digest of what it shows.
    #[must_use]
    pub fn lines_digest(&self) -> Digest {
        lines_digest(&self.lines)
    }

    /// What of the facts a decision repeats, if the question is the one that was asked for.
    ///
    /// # Errors
    /// [`ApprovalError::NoForm`] if it is another question, or another person's.
    pub fn bound(
        &self,
        version: &CapabilityId,
        purpose: Purpose,
        who: &str,
    ) -> Result<BoundFacts, ApprovalError> {
        let bound = BoundFacts::read(&self.facts)?;
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

    /// The command by which `who` decides on it, over the lines and facts that are in it.
    ///
    /// # Errors
    /// [`ApprovalError`] if the facts cannot be read, or the machine gives no random number for the nonce.
    pub fn answer(&self, who: &Identity, decision: Answer, reason: &str) -> Result<Command, ApprovalError> {
        let bound = BoundFacts::read(&self.facts)?;
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
            shown: Some(ShownQuestion {
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

impl PromptView {
    /// The command by which `who` refuses without having read the question: what stops something takes no reading.
    ///
    /// # Errors
    /// [`ApprovalError`] if the machine gives no random number for the nonce.
    pub fn refuse(&self, who: &Identity, reason: &str) -> Result<Command, ApprovalError> {
        let signed = who.sign(Approval {
            who: who.info().name.clone(),
            role: who.info().role,
            decision: Answer::Reject,
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
