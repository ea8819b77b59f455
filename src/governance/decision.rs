//! What every decision carries: its outcome, the reasons that made it, four answers and what it was made under.
//!
//! Must not decide anything itself.

mod codes;

use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::deployability::Deployability;
use super::ids::Digest;

pub use self::codes::{ReasonCode, ReasonCodeError};
pub use super::kappa::{Kappa, KappaError};

crate::words! {
    /// The part of the rules a reason belongs to.
    Dimension, "dimension", {
        /// `kappa_I`: signature, schema, conditions, dependencies.
        Interface = "interface",
        /// `kappa_P`: coverage of reachable modes by policy.
        Policy = "policy",
        /// `kappa_B`: measured behaviour against the active version.
        Behavior = "behavior",
        /// `kappa_R`: rehearsed recovery against the active version.
        Recovery = "recovery",
        /// The rule that joins the four, `Psi`.
        Composition = "composition",
        /// Shadow deployment, `Delta_shadow`: the live world against its twin.
        Shadow = "shadow",
        /// The activation gate, `theta_act`.
        Gate = "gate",
        /// The people who were asked, and the rules by which their answers count.
        Approval = "approval",
        /// Monitoring after activation, `M`.
        Monitor = "monitor",
    }
}

impl Dimension {
    /// Its name in running text, spelled as people write it.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Interface => "interface",
            Self::Policy => "policy",
            Self::Behavior => "behaviour",
            Self::Recovery => "recovery",
            Self::Composition => "composition",
            Self::Shadow => "shadow",
            Self::Gate => "gate",
            Self::Approval => "approval",
            Self::Monitor => "monitor",
        }
    }
}

/// One reason: what was found, with the number and the limit it was held against if there are any.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reason {
    /// Stable name of what was found, as the audit record and scenario files have it.
    pub code: ReasonCode,
    /// The part of the rules it belongs to.
    pub dimension: Dimension,
    /// What was found, one plain sentence for the operator; may quote foreign text.
    pub text: String,
    /// The measured value; absent if there is none or it is not finite.
    pub evidence: Option<f64>,
    /// The limit the value was held against; absent if there is none or it is not finite.
    pub limit: Option<f64>,
}

impl Reason {
    /// A reason without numbers.
    #[must_use]
    pub fn new(code: ReasonCode, dimension: Dimension, text: impl Into<String>) -> Self {
        Self { code, dimension, text: text.into(), evidence: None, limit: None }
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
pub fn telling(reasons: &[Reason]) -> Option<&Reason> {
    reasons.iter().find(|reason| reason.code.tells_what_was_found()).or_else(|| reasons.first())
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.code, self.code.told(&self.text))?;
        match (self.evidence, self.limit) {
            (Some(found), Some(limit)) => write!(f, " [{found:.3} against {limit:.3}]"),
            _ => Ok(()),
        }
    }
}

/// The four questions every decision answers for the operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answers {
    /// Is it admitted (to the next stage, or to act)?
    pub admitted: bool,
    /// Under which conditions may it be used? Empty: without any.
    pub conditions: Vec<Condition>,
    /// How is it monitored from now on?
    pub monitoring: String,
    /// What would take it off again?
    pub rollback_when: String,
    /// Which of the paper's four deployment outcomes it comes to; absent in records of older builds.
    #[serde(default)]
    pub deployment: Option<Deployability>,
}

/// Digests of what a decision was made under; a change of any of them voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MadeUnder {
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
    /// The evidence the decision was computed from, canonical JSON.
    pub evidence: Digest,
}

/// An outcome with its reasons, answers and circumstances. Built by the rules of this module tree only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision<O> {
    outcome: O,
    reasons: Vec<Reason>,
    answers: Answers,
    made_under: MadeUnder,
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
        answers: Answers,
        made_under: &MadeUnder,
    ) -> Self {
        Self { outcome, reasons, answers, made_under: *made_under }
    }

    /// What was decided, in the words of the rule that decided.
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
    pub const fn answers(&self) -> &Answers {
        &self.answers
    }

    /// Digests of the circumstances; the decision is void when one of them changes.
    #[must_use]
    pub const fn made_under(&self) -> &MadeUnder {
        &self.made_under
    }

    /// Whether a reason with this name is among the reasons.
    #[must_use]
    pub fn has(&self, code: ReasonCode) -> bool {
        self.reasons.iter().any(|reason| reason.code == code)
    }
}
