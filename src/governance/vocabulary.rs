//! The paper's five overlapping vocabularies, and the one table that leads from each to the next (readings X57).
//!
//! Every conversion is total. Outcomes of the rules are [`Recommendation`]; the others are ways of saying it.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::outcome::{ActivationMode, CheckResult, GateOutcome, PolicyOutcome, Recommendation};

pub use super::deployability::Deployability;

/// Stage 2's routes (paper section 5.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Route {
    /// Fail-fast rejection: nothing further is run.
    Reject,
    /// Evaluation in the sandbox, and no further.
    SandboxOnly,
    /// May go to shadow after the sandbox.
    ShadowEligible,
    /// May go to the gate, after shadow.
    ActivationEligible,
}

/// Outcomes of the policy check (paper section 4.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PaperPolicyOutcome {
    /// The active policies cover its requests.
    Allow,
    /// The active policies suffice under a tighter envelope.
    Restricted,
    /// Policy suffices only if people approve.
    Approval,
    /// The policies forbid it, or there is nothing to judge by.
    Reject,
}

/// Activation rules (paper appendix D).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActivationRule {
    /// Every dimension is acceptable and shadow divergence is below its threshold.
    Activated,
    /// Active under conditions: recovery is fragile, or the profile requires caution.
    ConditionallyActivated,
    /// Policy suffices only if people approve.
    ReviewBound,
    /// Compatibility or a constraint of the profile is violated.
    Rejected,
}

/// One line of the table: what each vocabulary calls a recommendation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VocabularyRow {
    /// The recommendation of `Psi` the line belongs to.
    pub recommendation: Recommendation,
    /// Where stage 2 sends it.
    pub route: Route,
    /// The equivalent outcome of the policy check.
    pub policy: PaperPolicyOutcome,
    /// The equivalent deployment outcome.
    pub deployability: Deployability,
    /// The activation rule that applies in the end, if nothing new is found.
    pub rule: ActivationRule,
    /// The least restricted mode it can be active in; absent if it cannot.
    pub mode: Option<ActivationMode>,
}

/// The table: one line for each recommendation.
#[must_use]
pub const fn vocabulary_row(recommendation: Recommendation) -> VocabularyRow {
    let (route, policy, deployability, rule, mode) = match recommendation {
        Recommendation::Reject => (
            Route::Reject,
            PaperPolicyOutcome::Reject,
            Deployability::Incompatible,
            ActivationRule::Rejected,
            None,
        ),
        Recommendation::Sandbox => (
            Route::SandboxOnly,
            PaperPolicyOutcome::Restricted,
            Deployability::EvaluationOnly,
            ActivationRule::Rejected,
            None,
        ),
        Recommendation::Shadow => (
            Route::ShadowEligible,
            PaperPolicyOutcome::Restricted,
            Deployability::Conditionally,
            ActivationRule::ConditionallyActivated,
            Some(ActivationMode::Conditional),
        ),
        Recommendation::Activate => (
            Route::ActivationEligible,
            PaperPolicyOutcome::Allow,
            Deployability::Fully,
            ActivationRule::Activated,
            Some(ActivationMode::Full),
        ),
        Recommendation::RollbackReview => (
            Route::SandboxOnly,
            PaperPolicyOutcome::Approval,
            Deployability::EvaluationOnly,
            ActivationRule::ReviewBound,
            Some(ActivationMode::ApprovalBound),
        ),
    };
    VocabularyRow { recommendation, route, policy, deployability, rule, mode }
}

impl From<Route> for Recommendation {
    fn from(route: Route) -> Self {
        match route {
            Route::Reject => Self::Reject,
            Route::SandboxOnly => Self::Sandbox,
            Route::ShadowEligible => Self::Shadow,
            Route::ActivationEligible => Self::Activate,
        }
    }
}

impl From<PaperPolicyOutcome> for Recommendation {
    fn from(outcome: PaperPolicyOutcome) -> Self {
        match outcome {
            PaperPolicyOutcome::Reject => Self::Reject,
            PaperPolicyOutcome::Approval => Self::RollbackReview,
            PaperPolicyOutcome::Restricted => Self::Shadow,
            PaperPolicyOutcome::Allow => Self::Activate,
        }
    }
}

impl From<Deployability> for Recommendation {
    fn from(deployability: Deployability) -> Self {
        match deployability {
            Deployability::Incompatible => Self::Reject,
            Deployability::EvaluationOnly => Self::Sandbox,
            Deployability::Conditionally => Self::Shadow,
            Deployability::Fully => Self::Activate,
        }
    }
}

impl From<ActivationRule> for Recommendation {
    fn from(rule: ActivationRule) -> Self {
        match rule {
            ActivationRule::Rejected => Self::Reject,
            ActivationRule::ReviewBound => Self::RollbackReview,
            ActivationRule::ConditionallyActivated => Self::Shadow,
            ActivationRule::Activated => Self::Activate,
        }
    }
}

impl From<ActivationMode> for Recommendation {
    fn from(mode: ActivationMode) -> Self {
        match mode {
            ActivationMode::Full => Self::Activate,
            ActivationMode::Conditional | ActivationMode::RollbackCoupled => Self::Shadow,
            ActivationMode::ApprovalBound => Self::RollbackReview,
        }
    }
}

/// The policy check's word for its outcome; without data nothing is allowed.
impl From<PolicyOutcome> for PaperPolicyOutcome {
    fn from(outcome: PolicyOutcome) -> Self {
        match outcome {
            PolicyOutcome::Compatible => Self::Allow,
            PolicyOutcome::Conditional => Self::Restricted,
            PolicyOutcome::Review => Self::Approval,
            PolicyOutcome::Incompatible | PolicyOutcome::NoData => Self::Reject,
        }
    }
}

/// The activation rule that a gate outcome comes to; what is held is bound to a review.
#[must_use]
pub fn rule_of_gate(outcome: GateOutcome, restricted: bool) -> ActivationRule {
    match (outcome, restricted) {
        (GateOutcome::Pass, false) => ActivationRule::Activated,
        (GateOutcome::Pass, true) => ActivationRule::ConditionallyActivated,
        (GateOutcome::AwaitApproval | GateOutcome::Hold, _) => ActivationRule::ReviewBound,
        (GateOutcome::Demote | GateOutcome::Reject, _) => ActivationRule::Rejected,
    }
}

/// The deployment outcome that the gate comes to: restricted modes and people who have to answer are conditions.
#[must_use]
pub fn deployability_of_gate(outcome: GateOutcome, modes: &BTreeSet<ActivationMode>) -> Deployability {
    match outcome {
        GateOutcome::Pass if modes.iter().all(|mode| *mode == ActivationMode::Full) => Deployability::Fully,
        GateOutcome::Pass | GateOutcome::AwaitApproval | GateOutcome::Hold => Deployability::Conditionally,
        GateOutcome::Demote => Deployability::EvaluationOnly,
        GateOutcome::Reject => Deployability::Incompatible,
    }
}

/// The deployment outcome that shadow comes to, for a candidate that had `before` when it began: what shadow does not
/// pass stays for evaluation.
#[must_use]
pub const fn deployability_of_shadow(check: CheckResult, before: Deployability) -> Deployability {
    match check {
        CheckResult::Pass | CheckResult::PassRestricted(_) => before,
        CheckResult::Review
        | CheckResult::Fail
        | CheckResult::Inconclusive
        | CheckResult::NoData
        | CheckResult::Skipped => Deployability::EvaluationOnly,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The conservative reading of a word never exceeds the recommendation it came from.
    #[test]
    fn every_term_maps_to_its_recommendation_or_a_stricter_one() {
        let admits = |recommendation| match recommendation {
            Recommendation::Reject => 0,
            Recommendation::Sandbox => 1,
            Recommendation::RollbackReview => 2,
            Recommendation::Shadow => 3,
            Recommendation::Activate => 4,
        };
        for recommendation in Recommendation::ALL {
            let line = vocabulary_row(recommendation);
            assert_eq!(line.recommendation, recommendation);
            assert!(admits(line.route.into()) <= admits(recommendation), "{line:?}");
            assert!(admits(line.deployability.into()) <= admits(recommendation), "{line:?}");
            assert!(admits(line.rule.into()) <= admits(recommendation), "{line:?}");
            if let Some(mode) = line.mode {
                assert!(admits(mode.into()) <= admits(recommendation), "{line:?}");
            }
            let exact = matches!(
                recommendation,
                Recommendation::Reject | Recommendation::Shadow | Recommendation::Activate
            );
            if exact {
                assert_eq!(Recommendation::from(line.route), recommendation);
                assert_eq!(Recommendation::from(line.policy), recommendation);
                assert_eq!(Recommendation::from(line.rule), recommendation);
            }
        }
        assert_eq!(
            Recommendation::from(vocabulary_row(Recommendation::RollbackReview).policy),
            Recommendation::RollbackReview
        );
    }

    #[test]
    fn gate_and_policy_outcomes_have_their_terms() {
        for (outcome, restricted, rule) in [
            (GateOutcome::Pass, false, ActivationRule::Activated),
            (GateOutcome::Pass, true, ActivationRule::ConditionallyActivated),
            (GateOutcome::AwaitApproval, false, ActivationRule::ReviewBound),
            (GateOutcome::Hold, true, ActivationRule::ReviewBound),
            (GateOutcome::Demote, false, ActivationRule::Rejected),
            (GateOutcome::Reject, true, ActivationRule::Rejected),
        ] {
            assert_eq!(rule_of_gate(outcome, restricted), rule);
        }
        for (outcome, word) in [
            (PolicyOutcome::Compatible, PaperPolicyOutcome::Allow),
            (PolicyOutcome::Conditional, PaperPolicyOutcome::Restricted),
            (PolicyOutcome::Review, PaperPolicyOutcome::Approval),
            (PolicyOutcome::Incompatible, PaperPolicyOutcome::Reject),
            (PolicyOutcome::NoData, PaperPolicyOutcome::Reject),
        ] {
            assert_eq!(PaperPolicyOutcome::from(outcome), word);
        }
    }
}
