//! The parts of every decision: outcome, reasons, four answers and context.
//!
//! Must not decide anything itself.

mod codes;

use serde::{Deserialize, Serialize};

use super::closed_set::Lenient;
use super::condition::Condition;
use super::deployability::Deployability;
use super::finding::Finding;
use super::ids::Digest;
use super::rules_version::RulesVersion;

pub use self::codes::{ReasonCode, ReasonCodeError};
pub use super::kappa::{Kappa, KappaError};

crate::closed_set! {
    /// The part of the rules a reason belongs to.
    Dimension, "dimension", {
        /// `kappa_I`: signature, schema, conditions, dependencies.
        Interface = "interface",
        /// `kappa_P`: coverage of reachable modes by policy.
        Policy = "policy",
        /// `kappa_B`: measured behavior against the active version.
        Behavior = "behavior",
        /// `kappa_R`: drilled recovery against the active version.
        Recovery = "recovery",
        /// The rule that joins the four, `Psi`.
        Composition = "composition",
        /// Shadow deployment, `Delta_shadow`: the live world against its twin.
        Shadow = "shadow",
        /// The activation gate, `theta_act`.
        Gate = "gate",
        /// Approvals and the rules of their validity.
        Approval = "approval",
        /// Monitoring after activation, `M`.
        Monitor = "monitor",
    }
}

/// One reason: the finding, with the number and its limit if there are any.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reason {
    /// Stable name of what was found, as the audit record and scenario files have it.
    pub code: ReasonCode,
    /// The part of the rules it belongs to.
    pub dimension: Dimension,
    /// What was found; absent in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub finding: Option<Finding>,
    /// The sentence in a record of an older build, which has no finding; empty otherwise. It may quote foreign text.
    #[serde(default, rename = "text", skip_serializing_if = "String::is_empty")]
    pub older_text: String,
    /// The measured value; absent if there is none or it is not finite.
    pub evidence: Option<f64>,
    /// The limit the value was compared with; absent if there is none or it is not finite.
    pub limit: Option<f64>,
}

impl Reason {
    /// A reason without numbers.
    #[must_use]
    pub const fn new(dimension: Dimension, finding: Finding) -> Self {
        Self::coded(finding.code(), dimension, finding)
    }

    /// A reason under another code than that of its finding.
    #[must_use]
    pub const fn coded(code: ReasonCode, dimension: Dimension, finding: Finding) -> Self {
        Self {
            code,
            dimension,
            finding: Some(finding),
            older_text: String::new(),
            evidence: None,
            limit: None,
        }
    }

    /// The same reason with its measured value and limit; what is not finite is left out.
    #[must_use]
    pub fn with(mut self, evidence: f64, limit: f64) -> Self {
        self.evidence = evidence.is_finite().then_some(evidence);
        self.limit = limit.is_finite().then_some(limit);
        self
    }
}

/// The reason for where there is room for one: the first that tells what was found, or else the first; `None` if there is
/// none.
#[must_use]
pub fn lead_reason(reasons: &[Reason]) -> Option<&Reason> {
    reasons.iter().find(|reason| reason.code.is_finding()).or_else(|| reasons.first())
}

crate::closed_set! {
    /// How a version is monitored after a decision.
    DecisionMonitoring, "monitoring of a decision", {
        /// By the watcher and the policy guard of the stage that it is admitted to.
        StageGuard = "stage-guard",
        /// By its charts, provisionally for the episodes of its terms and then continuously.
        Charts = "charts",
    }
}

crate::closed_set! {
    /// What takes a version off again after a decision.
    DecisionRollback, "rollback of a decision", {
        /// Nothing: it is not active, and leaving the stage leaves the active version untouched.
        NotActive = "not-active",
        /// The first safety event or warning of a chart, without asking; the predecessor stays loaded.
        FirstWarning = "first-warning",
        /// A safety event, an established worsening, or an unanswered escalation.
        EstablishedWorsening = "established-worsening",
    }
}

/// The four questions every decision answers for the operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionAnswers {
    /// Is it admitted (to the next stage, or to act)?
    pub admitted: bool,
    /// Under which conditions may it be used? Empty: without any.
    pub conditions: Vec<Condition>,
    /// How is it monitored from now on? Records of older builds have a sentence.
    pub monitoring: Lenient<DecisionMonitoring>,
    /// What would roll it back? Records of older builds have a sentence.
    pub rollback_when: Lenient<DecisionRollback>,
    /// The deployment outcome; absent in records of older builds.
    #[serde(default)]
    pub deployment: Option<Deployability>,
}

/// The digests a decision depends on; a change of any voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionContext {
    /// The candidate's bundle and manifest.
    pub candidate: Digest,
    /// The version that was active; absent for a bootstrap.
    pub active: Option<Digest>,
    /// The policy set (see [`super::policy::PolicyTable`]).
    pub policy: Digest,
    /// The profile with every number in it.
    pub profile: Digest,
    /// The identities and roles in force.
    pub authority: Digest,
    /// Robot, scene and engine build.
    pub environment: Digest,
    /// The versions beside it, and its fallback; absent where it has neither, and in decisions of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<Digest>,
    /// The family's anchor; absent where that is the active version, and in decisions of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<Digest>,
    /// The evidence the decision was computed from, canonical JSON.
    pub evidence: Digest,
    /// The version of the rules that made it.
    #[serde(default)]
    pub rules: RulesVersion,
}

/// An outcome with its reasons, answers and circumstances. Built by the rules of this module tree only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision<O> {
    outcome: O,
    reasons: Vec<Reason>,
    answers: DecisionAnswers,
    made_under: DecisionContext,
}

impl<O> Decision<O> {
    /// The same decision with another deployment outcome.
    pub(super) const fn with_deployment(mut self, deployment: Deployability) -> Self {
        self.answers.deployment = Some(deployment);
        self
    }

    pub(super) const fn new(
        outcome: O,
        reasons: Vec<Reason>,
        answers: DecisionAnswers,
        made_under: &DecisionContext,
    ) -> Self {
        Self { outcome, reasons, answers, made_under: *made_under }
    }

    /// The outcome, in the words of the deciding rule.
    pub const fn outcome(&self) -> &O {
        &self.outcome
    }

    /// Why, the deciding reasons first.
    #[must_use]
    pub fn reasons(&self) -> &[Reason] {
        &self.reasons
    }

    /// Admission, conditions, monitoring and rollback, as the operator reads them.
    #[must_use]
    pub const fn answers(&self) -> &DecisionAnswers {
        &self.answers
    }

    /// Digests of the circumstances; the decision is void when one of them changes.
    #[must_use]
    pub const fn made_under(&self) -> &DecisionContext {
        &self.made_under
    }

    /// Whether a reason with this name is among the reasons.
    #[must_use]
    pub fn has(&self, code: ReasonCode) -> bool {
        self.reasons.iter().any(|reason| reason.code == code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// An older build wrote sentences where this one writes codes; both are written again as they were read.
    #[test]
    fn answers_of_older_builds_keep_their_sentences() {
        let answers = |monitoring: &str, rollback_when: &str| {
            json!({
                "admitted": true, "conditions": [], "monitoring": monitoring, "rollback_when": rollback_when,
                "deployment": null
            })
        };
        let (older, own) =
            (answers("by the watcher", "at a safety event"), answers("charts", "first-warning"));
        let read = |text: &serde_json::Value| DecisionAnswers::deserialize(text).unwrap();
        assert_eq!(serde_json::to_value(read(&older)).unwrap(), older);
        assert_eq!(read(&older).monitoring.known(), None);
        assert_eq!(serde_json::to_value(read(&own)).unwrap(), own);
        assert_eq!(read(&own).rollback_when, DecisionRollback::FirstWarning);
    }
}
