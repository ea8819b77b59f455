//! The outcomes of each rule. Closed sets, no catch-all, each with its meaning.

use serde::{Deserialize, Serialize};

use super::closed_set::convert_equal_terms;
use super::decision::{Kappa, Reason};

crate::closed_set! {
    /// Outcome of one compatibility dimension, in its own words (paper table 3).
    InterfaceOutcome, "outcome of kappa I", {
        /// Callers of the active version can call it as it is.
        Compatible = "compatible",
        /// Usable where each call is checked first, or once a dependency has another version active.
        Conditional = "conditional",
        /// A caller of the active version would break, beyond what an adapter repairs.
        Incompatible = "incompatible",
        /// The code's exports could not be read.
        NoData = "no-data",
    }
}

crate::closed_set! {
    /// Outcome of `kappa_P`, policy coverage, in its own words (paper table 3).
    PolicyOutcome, "outcome of kappa P", {
        /// Every reachable mode is covered and allowed.
        Compatible = "compatible",
        /// Usable under a tighter envelope, or with new modes the guard will deny.
        Conditional = "conditional",
        /// A person has to decide: it escalates authority, or a policy requires it.
        Review = "review",
        /// A reachable mode is forbidden, uncovered at high risk, or coverage is too low.
        Incompatible = "incompatible",
        /// The exports are unknown, or the table is another profile's.
        NoData = "no-data",
    }
}

crate::closed_set! {
    /// Outcome of `kappa_B`, measured behavior, in its own words (paper table 3, with two words for missing evidence).
    BehaviorOutcome, "outcome of kappa B", {
        /// Every component is non-inferior.
        Compatible = "compatible",
        /// Inconclusive: neither significantly worse nor non-inferior.
        Suspicious = "suspicious",
        /// The significant worsenings bring `kappa_B` below its threshold, or there was a hard stop.
        Incompatible = "incompatible",
        /// Fewer episodes than the profile's budget, so nothing is concluded.
        Inconclusive = "inconclusive",
        /// No usable episodes: none, or of another version, or implausible.
        NoData = "no-data",
    }
}

crate::closed_set! {
    /// Outcome of `kappa_R`, drilled recovery, in its own words (paper table 3).
    RecoveryOutcome, "outcome of kappa R", {
        /// As good as the active version's recovery, and above the floor.
        Compatible = "compatible",
        /// Above the floor, clearly below the active version.
        Conditional = "conditional",
        /// `rho` is below the profile's floor: usable only if rollback-coupled.
        Fragile = "fragile",
        /// `kappa_R` is below its threshold, `rho` far below the floor, or rollback itself fails too often.
        Incompatible = "incompatible",
        /// Too few feasible drills, or drills of another version.
        NoData = "no-data",
    }
}

crate::closed_set! {
    /// Outcome of any of the four dimensions: the words of [`InterfaceOutcome`], [`PolicyOutcome`],
    /// [`BehaviorOutcome`] and [`RecoveryOutcome`], each with its meaning there.
    DimensionOutcome, "outcome of a dimension", {
        /// Usable as it is.
        Compatible = "compatible",
        /// Usable under a restriction.
        Conditional = "conditional",
        /// A person has to decide (policy).
        Review = "review",
        /// Neither significantly worse nor non-inferior (behavior).
        Suspicious = "suspicious",
        /// `rho` is below the profile's floor (recovery).
        Fragile = "fragile",
        /// Significantly worse, or refused by policy.
        Incompatible = "incompatible",
        /// Incomplete: fewer episodes than the budget (behavior).
        Inconclusive = "inconclusive",
        /// Nothing to assess with.
        NoData = "no-data",
    }
}

convert_equal_terms! { InterfaceOutcome => DimensionOutcome: Compatible, Conditional, Incompatible, NoData }
convert_equal_terms! { PolicyOutcome => DimensionOutcome: Compatible, Conditional, Review, Incompatible, NoData }
convert_equal_terms! {
    BehaviorOutcome => DimensionOutcome:
    Compatible, Suspicious, Incompatible, Inconclusive, NoData
}
convert_equal_terms! { RecoveryOutcome => DimensionOutcome: Compatible, Conditional, Fragile, Incompatible, NoData }

crate::closed_set! {
    /// The activation modes (paper table 4). Several can apply at once.
    ActivationMode, "activation mode", {
        /// Every permission the manifest declares, within the profile's limits.
        Full = "full",
        /// Under typed conditions of use, which guard and monitor enforce (see
        /// [`Condition`](super::condition::Condition)).
        Conditional = "conditional",
        /// Only with people's approval, signed and bound to this activation.
        ApprovalBound = "approval-bound",
        /// The predecessor stays loaded and takes over at the first trip.
        RollbackCoupled = "rollback-coupled",
    }
}

/// One check's result in the common form every rule above the dimensions reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CheckResult {
    /// Advances to the next stage without restriction.
    Pass,
    /// Advances, and caps the activation at this mode.
    PassRestricted(ActivationMode),
    /// A person has to decide before it can advance.
    Review,
    /// Does not advance: significantly worse, or refused.
    Fail,
    /// The evidence does not decide; does not advance.
    Inconclusive,
    /// There is no usable evidence; does not advance.
    NoData,
    /// Left out on purpose; exists in experiments only, refused everywhere else.
    Skipped,
}

impl CheckResult {
    /// Only `Pass` and `PassRestricted` advance.
    #[must_use]
    pub const fn advances(self) -> bool {
        match self {
            Self::Pass | Self::PassRestricted(_) => true,
            Self::Review | Self::Fail | Self::Inconclusive | Self::NoData | Self::Skipped => false,
        }
    }
}

impl From<InterfaceOutcome> for CheckResult {
    fn from(outcome: InterfaceOutcome) -> Self {
        match outcome {
            InterfaceOutcome::Compatible => Self::Pass,
            InterfaceOutcome::Conditional => Self::PassRestricted(ActivationMode::Conditional),
            InterfaceOutcome::Incompatible => Self::Fail,
            InterfaceOutcome::NoData => Self::NoData,
        }
    }
}

impl From<PolicyOutcome> for CheckResult {
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

impl From<BehaviorOutcome> for CheckResult {
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

impl From<RecoveryOutcome> for CheckResult {
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
    /// Measured under the present circumstances: this version, profile, policy and environment.
    Measured,
    /// Declared, or from earlier traces; no gate uses it.
    Estimated,
}

/// The result of one dimension: outcome, value and reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Assessment<O> {
    /// The outcome in the dimension's own words.
    pub outcome: O,
    /// The value; absent if there is no data.
    pub kappa: Option<Kappa>,
    /// Whether the value was measured under the present circumstances or is an estimate, which opens no gate.
    pub basis: Basis,
    /// Why, the deciding reasons first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used.
    pub conditions: Vec<super::condition::Condition>,
}

impl<O> Assessment<O> {
    /// An outcome without a value and without conditions.
    #[must_use]
    pub const fn without_value(outcome: O, basis: Basis, reasons: Vec<Reason>) -> Self {
        Self { outcome, kappa: None, basis, reasons, conditions: Vec::new() }
    }
}

crate::closed_set! {
    /// The recommendation of `Psi` = the next permitted stage (paper equation 2; readings X39).
    Recommendation, "recommendation", {
        /// Interface or policy is incompatible: not to be used.
        Reject = "reject",
        /// Behavior or recovery is missing, inconclusive or incompatible: evaluation in the sandbox only.
        Sandbox = "sandbox",
        /// Shadow deployment is next; a restriction or an estimate stands against activation.
        Shadow = "shadow",
        /// Eligible for activation; the sandbox and shadow still have to be passed.
        Activate = "activate",
        /// Waits for people; never skips sandbox or shadow.
        RollbackReview = "rollback-review",
    }
}

crate::closed_set! {
    /// The outcome of `theta_act`.
    GateOutcome, "outcome of the gate", {
        /// May be activated under the terms of its pass.
        Pass = "pass",
        /// All other conditions are met; approvals are missing.
        AwaitApproval = "await-approval",
        /// Not now: a freeze, an open review, or no answer in time. Nothing changes.
        Hold = "hold",
        /// Evidence is missing, stale or not enough: back to evaluation.
        Demote = "demote",
        /// Significantly worse, forbidden by a site policy, or refused by people.
        Reject = "reject",
    }
}

crate::closed_set! {
    /// What a stage ended with, in its own rule's word: a [`Recommendation`] after validation and sandbox, a
    /// [`CheckResult`] after shadow, a [`GateOutcome`] after the gate.
    StageOutcome, "outcome of a stage", {
        /// Refused, by a recommendation or by the gate.
        Reject = "reject",
        /// Evaluation in the sandbox is next.
        Sandbox = "sandbox",
        /// Shadow deployment is next.
        Shadow = "shadow",
        /// Eligible for activation once every stage before the gate is passed.
        Activate = "activate",
        /// Waits for people before it continues.
        RollbackReview = "rollback-review",
        /// Shadow or the gate is passed without restriction.
        Pass = "pass",
        /// Passed under a restricted mode.
        PassRestricted = "pass-restricted",
        /// A person has to decide.
        Review = "review",
        /// In shadow the candidate is significantly worse than the active version.
        Fail = "fail",
        /// The evidence does not decide.
        Inconclusive = "inconclusive",
        /// There is no usable evidence.
        NoData = "no-data",
        /// Left out on purpose; in experiments only.
        Skipped = "skipped",
        /// The gate waits for people's answers.
        AwaitApproval = "await-approval",
        /// Not now: a freeze, an open review, or no answer in time.
        Hold = "hold",
        /// Back to evaluation: the gate found evidence missing, stale or not enough.
        Demote = "demote",
    }
}

convert_equal_terms! { Recommendation => StageOutcome: Reject, Sandbox, Shadow, Activate, RollbackReview }

impl From<CheckResult> for StageOutcome {
    fn from(check: CheckResult) -> Self {
        match check {
            CheckResult::Pass => Self::Pass,
            CheckResult::PassRestricted(_) => Self::PassRestricted,
            CheckResult::Review => Self::Review,
            CheckResult::Fail => Self::Fail,
            CheckResult::Inconclusive => Self::Inconclusive,
            CheckResult::NoData => Self::NoData,
            CheckResult::Skipped => Self::Skipped,
        }
    }
}

convert_equal_terms! { GateOutcome => StageOutcome: Pass, AwaitApproval, Hold, Demote, Reject }

#[cfg(test)]
mod tests {
    use super::*;

    /// A stage reports the word of its rule's outcome in the record.
    #[test]
    fn stage_outcome_has_the_name_of_its_rule() {
        let text = |value: serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        for recommendation in Recommendation::ALL {
            assert_eq!(StageOutcome::from(recommendation).name(), recommendation.name());
        }
        for outcome in GateOutcome::ALL {
            assert_eq!(StageOutcome::from(outcome).name(), outcome.name());
        }
        for check in [
            CheckResult::Pass,
            CheckResult::Review,
            CheckResult::Fail,
            CheckResult::Inconclusive,
            CheckResult::NoData,
            CheckResult::Skipped,
        ] {
            assert_eq!(StageOutcome::from(check).name(), text(serde_json::to_value(check).unwrap()));
        }
    }

    #[test]
    fn dimension_outcome_has_its_own_name() {
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
