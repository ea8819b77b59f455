//! The paper's four deployment outcomes (section 4.5), and which one each result of the rules comes to (readings X57).

use std::collections::BTreeSet;

use super::outcome::{ActivationMode, CheckResult, GateOutcome, Recommendation};

crate::closed_set! {
    /// Deployment outcomes (paper section 4.5).
    Deployability, "deployment outcome", {
        /// May proceed to gated activation.
        Fully = "fully-compatible",
        /// Admissible under bounded conditions: simulation only, stricter thresholds, shadow first, approval.
        Conditionally = "conditionally-compatible",
        /// Not for activation; the results of sandbox and shadow stay available.
        EvaluationOnly = "evaluation-only",
        /// Rejected, or to be revised.
        Incompatible = "incompatible",
    }
}

impl From<Recommendation> for Deployability {
    fn from(recommendation: Recommendation) -> Self {
        match recommendation {
            Recommendation::Reject => Self::Incompatible,
            Recommendation::Sandbox | Recommendation::RollbackReview => Self::EvaluationOnly,
            Recommendation::Shadow => Self::Conditionally,
            Recommendation::Activate => Self::Fully,
        }
    }
}

impl Deployability {
    /// What the gate comes to: restricted modes and people who have to answer are conditions.
    #[must_use]
    pub fn of_gate(outcome: GateOutcome, modes: &BTreeSet<ActivationMode>) -> Self {
        match outcome {
            GateOutcome::Pass if modes.iter().all(|mode| *mode == ActivationMode::Full) => Self::Fully,
            GateOutcome::Pass | GateOutcome::AwaitApproval | GateOutcome::Hold => Self::Conditionally,
            GateOutcome::Demote => Self::EvaluationOnly,
            GateOutcome::Reject => Self::Incompatible,
        }
    }

    /// What shadow leaves of it: what shadow does not pass stays for evaluation.
    #[must_use]
    pub const fn after_shadow(self, check: CheckResult) -> Self {
        match check {
            CheckResult::Pass | CheckResult::PassRestricted(_) => self,
            CheckResult::Review
            | CheckResult::Fail
            | CheckResult::Inconclusive
            | CheckResult::NoData
            | CheckResult::Skipped => Self::EvaluationOnly,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_recommendation_has_its_deployment_outcome() {
        use Deployability::{Conditionally, EvaluationOnly, Fully, Incompatible};
        let of_each = Recommendation::ALL.map(Deployability::from);
        assert_eq!(of_each, [Incompatible, EvaluationOnly, Conditionally, Fully, EvaluationOnly]);
    }
}
