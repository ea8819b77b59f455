//! Outcomes: what each rule can come to. Closed sets, no catch-all, each with its meaning.

use serde::{Deserialize, Serialize};

use super::decision::{Kappa, Reason};

/// Outcome of one compatibility dimension, in its own words (paper table 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InterfaceOutcome {
    /// Usable as it is.
    Compatible,
    /// Usable with an adapter.
    Conditional,
    /// Not usable.
    Incompatible,
    /// Nothing to assess with.
    NoData,
}

/// Outcome of `kappa_P`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyOutcome {
    /// Every reachable mode is covered and allowed.
    Compatible,
    /// Usable under a tighter envelope, or with new modes the guard will deny.
    Conditional,
    /// A person has to decide.
    Review,
    /// Not usable under this profile.
    Incompatible,
    /// Nothing to assess with.
    NoData,
}

/// Outcome of `kappa_B`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BehaviorOutcome {
    /// Worsening beyond tolerance is excluded.
    Compatible,
    /// Not excluded, not established.
    Suspicious,
    /// Worsening beyond tolerance is established.
    Incompatible,
    /// Fewer episodes than the budget.
    Inconclusive,
    /// No usable episodes.
    NoData,
}

/// Outcome of `kappa_R`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RecoveryOutcome {
    /// As good as the active version.
    Compatible,
    /// Above the floor, clearly below the active version.
    Conditional,
    /// Below the floor.
    Fragile,
    /// Not recoverable enough.
    Incompatible,
    /// Too few feasible drills.
    NoData,
}

/// How a version may be active (paper table 4). Several can hold at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActivationMode {
    /// Without restriction.
    Full,
    /// Under typed conditions.
    Conditional,
    /// Only with people's approval.
    ApprovalBound,
    /// The predecessor stays loaded and takes over at the first trip.
    RollbackCoupled,
}

impl ActivationMode {
    /// Every mode, the least restricted first.
    pub const ALL: [Self; 4] = [Self::Full, Self::Conditional, Self::RollbackCoupled, Self::ApprovalBound];
    /// The name on screen and in records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Conditional => "conditional",
            Self::ApprovalBound => "approval-bound",
            Self::RollbackCoupled => "rollback-coupled",
        }
    }
}

/// One check's result in the common form every rule above the dimensions reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Check {
    /// Advances.
    Pass,
    /// Advances, at most in this mode.
    PassRestricted(ActivationMode),
    /// A person has to decide before it can advance.
    Review,
    /// Does not advance.
    Fail,
    /// The evidence does not decide; does not advance.
    Inconclusive,
    /// There is no usable evidence; does not advance.
    NoData,
    /// Left out on purpose; exists in experiments only, refused everywhere else.
    Skipped,
}

impl Check {
    /// Only `Pass` and `PassRestricted` advance.
    #[must_use]
    pub const fn advances(self) -> bool {
        match self {
            Self::Pass | Self::PassRestricted(_) => true,
            Self::Review | Self::Fail | Self::Inconclusive | Self::NoData | Self::Skipped => false,
        }
    }
}

impl From<InterfaceOutcome> for Check {
    fn from(outcome: InterfaceOutcome) -> Self {
        match outcome {
            InterfaceOutcome::Compatible => Self::Pass,
            InterfaceOutcome::Conditional => Self::PassRestricted(ActivationMode::Conditional),
            InterfaceOutcome::Incompatible => Self::Fail,
            InterfaceOutcome::NoData => Self::NoData,
        }
    }
}

impl From<PolicyOutcome> for Check {
    fn from(outcome: PolicyOutcome) -> Self {
        match outcome {
            PolicyOutcome::Compatible => Self::Pass,
            PolicyOutcome::Conditional => Self::PassRestricted(ActivationMode::Conditional),
            PolicyOutcome::Review => Self::Review,
            PolicyOutcome::Incompatible => Self::Fail,
            PolicyOutcome::NoData => Self::NoData,
        }
    }
}

impl From<BehaviorOutcome> for Check {
    fn from(outcome: BehaviorOutcome) -> Self {
        match outcome {
            BehaviorOutcome::Compatible => Self::Pass,
            BehaviorOutcome::Suspicious => Self::PassRestricted(ActivationMode::RollbackCoupled),
            BehaviorOutcome::Incompatible => Self::Fail,
            BehaviorOutcome::Inconclusive => Self::Inconclusive,
            BehaviorOutcome::NoData => Self::NoData,
        }
    }
}

impl From<RecoveryOutcome> for Check {
    fn from(outcome: RecoveryOutcome) -> Self {
        match outcome {
            RecoveryOutcome::Compatible => Self::Pass,
            RecoveryOutcome::Conditional | RecoveryOutcome::Fragile => {
                Self::PassRestricted(ActivationMode::RollbackCoupled)
            }
            RecoveryOutcome::Incompatible => Self::Fail,
            RecoveryOutcome::NoData => Self::NoData,
        }
    }
}

/// Whether a value was measured or only estimated from declared or earlier traces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// Measured under the present circumstances.
    Measured,
    /// Declared, or from earlier traces; no gate uses it.
    Estimated,
}

/// What one dimension came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Assessment<O> {
    /// The outcome in the dimension's own words.
    pub outcome: O,
    /// The value; absent where there is no data.
    pub kappa: Option<Kappa>,
    /// Measured or estimated.
    pub basis: Basis,
    /// Why, the deciding reasons first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used.
    pub conditions: Vec<super::condition::Condition>,
}

/// The recommendation of `Psi` = the next permitted stage (paper equation 2; readings X39).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Recommendation {
    /// Not to be used.
    Reject,
    /// Evaluation in the sandbox only.
    Sandbox,
    /// Shadow deployment.
    Shadow,
    /// Eligible for activation.
    Activate,
    /// Waits for people; never skips sandbox or shadow.
    RollbackReview,
}

impl Recommendation {
    /// Every recommendation.
    pub const ALL: [Self; 5] =
        [Self::Reject, Self::Sandbox, Self::Shadow, Self::Activate, Self::RollbackReview];
    /// The name on screen and in records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reject => "reject",
            Self::Sandbox => "sandbox",
            Self::Shadow => "shadow",
            Self::Activate => "activate",
            Self::RollbackReview => "rollback-review",
        }
    }
    /// The paper's table 11: ACCEPT = {activate, shadow}.
    #[must_use]
    pub const fn is_accept(self) -> bool {
        match self {
            Self::Activate | Self::Shadow => true,
            Self::Reject | Self::Sandbox | Self::RollbackReview => false,
        }
    }
}
