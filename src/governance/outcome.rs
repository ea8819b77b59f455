//! Outcomes: what each rule can come to. Closed sets, no catch-all, each with its meaning.

use serde::{Deserialize, Serialize};

use super::decision::{Kappa, Reason};
use super::words::same_words;

crate::words! {
    /// Outcome of one compatibility dimension, in its own words (paper table 3).
    InterfaceOutcome, "outcome of kappa I", {
        /// Usable as it is.
        Compatible = "compatible",
        /// Usable with an adapter.
        Conditional = "conditional",
        /// Not usable.
        Incompatible = "incompatible",
        /// Nothing to assess with.
        NoData = "no-data",
    }
}

crate::words! {
    /// Outcome of `kappa_P`.
    PolicyOutcome, "outcome of kappa P", {
        /// Every reachable mode is covered and allowed.
        Compatible = "compatible",
        /// Usable under a tighter envelope, or with new modes the guard will deny.
        Conditional = "conditional",
        /// A person has to decide.
        Review = "review",
        /// Not usable under this profile.
        Incompatible = "incompatible",
        /// Nothing to assess with.
        NoData = "no-data",
    }
}

crate::words! {
    /// Outcome of `kappa_B`.
    BehaviorOutcome, "outcome of kappa B", {
        /// Worsening beyond tolerance is excluded.
        Compatible = "compatible",
        /// Not excluded, not established.
        Suspicious = "suspicious",
        /// Worsening beyond tolerance is established.
        Incompatible = "incompatible",
        /// Fewer episodes than the budget.
        Inconclusive = "inconclusive",
        /// No usable episodes.
        NoData = "no-data",
    }
}

crate::words! {
    /// Outcome of `kappa_R`.
    RecoveryOutcome, "outcome of kappa R", {
        /// As good as the active version.
        Compatible = "compatible",
        /// Above the floor, clearly below the active version.
        Conditional = "conditional",
        /// Below the floor.
        Fragile = "fragile",
        /// Not recoverable enough.
        Incompatible = "incompatible",
        /// Too few feasible drills.
        NoData = "no-data",
    }
}

crate::words! {
    /// Outcome of any of the four dimensions: the words of [`InterfaceOutcome`], [`PolicyOutcome`],
    /// [`BehaviorOutcome`] and [`RecoveryOutcome`], each with its meaning there.
    DimensionOutcome, "outcome of a dimension", {
        /// Usable as it is.
        Compatible = "compatible",
        /// Usable under a restriction.
        Conditional = "conditional",
        /// A person has to decide (policy).
        Review = "review",
        /// Worsening is neither excluded nor established (behaviour).
        Suspicious = "suspicious",
        /// Below the floor (recovery).
        Fragile = "fragile",
        /// Not usable.
        Incompatible = "incompatible",
        /// Fewer episodes than the budget (behaviour).
        Inconclusive = "inconclusive",
        /// Nothing to assess with.
        NoData = "no-data",
    }
}

same_words! { InterfaceOutcome => DimensionOutcome: Compatible, Conditional, Incompatible, NoData }
same_words! { PolicyOutcome => DimensionOutcome: Compatible, Conditional, Review, Incompatible, NoData }
same_words! {
    BehaviorOutcome => DimensionOutcome:
    Compatible, Suspicious, Incompatible, Inconclusive, NoData
}
same_words! { RecoveryOutcome => DimensionOutcome: Compatible, Conditional, Fragile, Incompatible, NoData }

/// How a version may be active (paper table 4). Several can hold at once.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
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

crate::words! {
    /// The recommendation of `Psi` = the next permitted stage (paper equation 2; readings X39).
    Recommendation, "recommendation", {
        /// Not to be used.
        Reject = "reject",
        /// Evaluation in the sandbox only.
        Sandbox = "sandbox",
        /// Shadow deployment.
        Shadow = "shadow",
        /// Eligible for activation.
        Activate = "activate",
        /// Waits for people; never skips sandbox or shadow.
        RollbackReview = "rollback-review",
    }
}

impl Recommendation {
    /// The paper's table 11: ACCEPT = {activate, shadow}.
    #[must_use]
    pub const fn is_accept(self) -> bool {
        match self {
            Self::Activate | Self::Shadow => true,
            Self::Reject | Self::Sandbox | Self::RollbackReview => false,
        }
    }
}

crate::words! {
    /// What the gate comes to.
    GateOutcome, "outcome of the gate", {
        /// May be activated under its terms.
        Pass = "pass",
        /// Everything else holds; people have to answer.
        AwaitApproval = "await-approval",
        /// Not now: a freeze, an open review, or no answer in time. Nothing changes.
        Hold = "hold",
        /// Evidence is missing, stale or not enough: back to evaluation.
        Demote = "demote",
        /// Refused.
        Reject = "reject",
    }
}

crate::words! {
    /// What a stage ended with, in its own rule's word: a [`Recommendation`] after validation and sandbox, a
    /// [`Check`] after shadow, a [`GateOutcome`] after the gate.
    StageOutcome, "outcome of a stage", {
        /// Refused, by a recommendation or by the gate.
        Reject = "reject",
        /// Evaluation in the sandbox is next.
        Sandbox = "sandbox",
        /// Shadow deployment is next.
        Shadow = "shadow",
        /// Eligible for activation.
        Activate = "activate",
        /// Waits for people before it goes on.
        RollbackReview = "rollback-review",
        /// Shadow or the gate is passed.
        Pass = "pass",
        /// Passed under a restricted mode.
        PassRestricted = "pass-restricted",
        /// A person has to decide.
        Review = "review",
        /// Shadow is not passed.
        Fail = "fail",
        /// The evidence does not decide.
        Inconclusive = "inconclusive",
        /// There is no usable evidence.
        NoData = "no-data",
        /// Left out on purpose; in experiments only.
        Skipped = "skipped",
        /// People have to answer.
        AwaitApproval = "await-approval",
        /// Not now; nothing changes.
        Hold = "hold",
        /// Back to evaluation.
        Demote = "demote",
    }
}

same_words! { Recommendation => StageOutcome: Reject, Sandbox, Shadow, Activate, RollbackReview }

impl From<Check> for StageOutcome {
    fn from(check: Check) -> Self {
        match check {
            Check::Pass => Self::Pass,
            Check::PassRestricted(_) => Self::PassRestricted,
            Check::Review => Self::Review,
            Check::Fail => Self::Fail,
            Check::Inconclusive => Self::Inconclusive,
            Check::NoData => Self::NoData,
            Check::Skipped => Self::Skipped,
        }
    }
}

same_words! { GateOutcome => StageOutcome: Pass, AwaitApproval, Hold, Demote, Reject }

#[cfg(test)]
mod tests {
    use super::*;

    /// What a stage tells is the word that its rule's outcome has in the record.
    #[test]
    fn a_stage_tells_its_rules_own_word() {
        let word = |value: serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        for recommendation in Recommendation::ALL {
            assert_eq!(StageOutcome::from(recommendation).name(), recommendation.name());
        }
        for outcome in GateOutcome::ALL {
            assert_eq!(StageOutcome::from(outcome).name(), outcome.name());
        }
        for check in
            [Check::Pass, Check::Review, Check::Fail, Check::Inconclusive, Check::NoData, Check::Skipped]
        {
            assert_eq!(StageOutcome::from(check).name(), word(serde_json::to_value(check).unwrap()));
        }
    }

    #[test]
    fn a_dimension_tells_its_own_word() {
        for outcome in InterfaceOutcome::ALL {
            assert_eq!(DimensionOutcome::from(outcome).name(), outcome.name());
        }
        for outcome in PolicyOutcome::ALL {
            assert_eq!(DimensionOutcome::from(outcome).name(), outcome.name());
        }
        for outcome in BehaviorOutcome::ALL {
            assert_eq!(DimensionOutcome::from(outcome).name(), outcome.name());
        }
        for outcome in RecoveryOutcome::ALL {
            assert_eq!(DimensionOutcome::from(outcome).name(), outcome.name());
        }
    }
}
