//! The finding of a stage against a candidate, in the paper's categories of regression (its section 8.3 and figure 5).

use std::collections::BTreeSet;

use holdpoint_governance::behavior::{ComponentName, component_of};
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::finding::TwinSignal;
use holdpoint_governance::gate::worse_signal;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::Fate;
use holdpoint_protocol::scenario_state::Decider;

use crate::pipeline_experiments::candidate_run::CandidateEnd;

holdpoint_governance::closed_set! {
    /// A category of regression; the first five are the paper's, in its order.
    Regression, "category of regression", {
        /// Tries more often.
        Retry = "retry instability",
        /// Nearer to limits or past them, or harm.
        Policy = "policy-sensitive drift",
        /// Slower, or it does not end.
        Timeout = "timeout or stall",
        /// Is stopped, undone or replaced less well.
        Recovery = "recovery degradation",
        /// Behaves differently in the live cell.
        Live = "live-context divergence",
        /// Does less of its task, or shows an anomaly that is in no other category.
        Outcome = "outcome",
    }
}

/// The categories that the reasons of the stage that stopped a candidate name; none for one that validation stopped, or
/// that nothing did.
#[must_use]
pub fn categories(end: &CandidateEnd) -> BTreeSet<Regression> {
    let Fate::Blocked { stage } = end.fate else { return BTreeSet::new() };
    if stage == Stage::Validation {
        return BTreeSet::new();
    }
    let decided = end.stages.iter().rev().find(|record| record.stage == Decider::from(stage));
    decided.map_or_else(BTreeSet::new, |record| record.reasons.iter().filter_map(category).collect())
}

/// The category of a reason; nothing for one that says nothing against a version.
fn category(reason: &Reason) -> Option<Regression> {
    use ReasonCode as Code;
    match reason.code {
        Code::BehaviorEstablishedWorse | Code::BehaviorSuspicious | Code::BehaviorSafetyTraded => {
            Some(match component_of(reason) {
                Some(ComponentName::Retry) => Regression::Retry,
                Some(ComponentName::Violation) => Regression::Policy,
                Some(ComponentName::Time) => Regression::Timeout,
                Some(ComponentName::Recovery) => Regression::Recovery,
                Some(ComponentName::Success | ComponentName::Anomaly) | None => Regression::Outcome,
            })
        }
        Code::BehaviorSequenceWorse | Code::BehaviorSequenceSuspicious => Some(Regression::Outcome),
        Code::BehaviorHarmEstablished
        | Code::BehaviorHarmSuspicious
        | Code::BehaviorAsksMore
        | Code::BehaviorHardStop
        | Code::GateHardLimit => Some(Regression::Policy),
        Code::RecoveryBelowThreshold
        | Code::RecoveryFarBelowFloor
        | Code::RecoveryRollbackBelowFloor
        | Code::RecoveryFragile
        | Code::RecoveryConditional
        | Code::RecoveryLeaning
        | Code::RecoveryEstablishedWorse
        | Code::RecoveryPhaseFailing
        | Code::RecoveryPhaseWorse
        | Code::RecoveryEndedEarly => Some(Regression::Recovery),
        // Differences in the twins of the live cell: the finding names the signal.
        Code::ShadowGovernanceDivergence if worse_signal(reason) == Some(TwinSignal::PolicyHit) => {
            Some(Regression::Policy)
        }
        Code::ShadowGovernanceDivergence
        | Code::ShadowShifted
        | Code::ShadowWorkedAgain
        | Code::ShadowLeaning
        | Code::ShadowOutputDivergence
        | Code::ShadowEnvelopeDivergence => {
            (reason.dimension == Dimension::Shadow).then_some(Regression::Live)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_experiments::candidate_run::{
        DecisionOutcome, EpisodeEffort, PostRunCheck, StageRecord,
    };
    use holdpoint_governance::finding::Finding;
    use holdpoint_governance::outcome::StageOutcome;
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_protocol::scenario_state::ScenarioState;

    fn blocked_end(stage: Stage, findings: &[(ReasonCode, Dimension, &str)]) -> CandidateEnd {
        let reasons = findings
            .iter()
            .map(|(code, dimension, text)| Reason {
                finding: None,
                older_text: (*text).to_owned(),
                ..Reason::coded(*code, *dimension, Finding::LeftOut)
            })
            .collect();
        let record = StageRecord {
            stage: Decider::from(stage),
            decision: DecisionOutcome::Stage(StageOutcome::Reject),
            reasons,
        };
        CandidateEnd {
            name: "grasp-001".to_owned(),
            version: "grasp@1.1.1".parse().unwrap(),
            profile: ProfileName::Sim,
            seed: 100,
            dimensions: Vec::new(),
            composite: None,
            stages: vec![record],
            state: ScenarioState::Confirmed,
            restricted: false,
            fate: Fate::Blocked { stage },
            effort: EpisodeEffort::default(),
            afterwards: PostRunCheck::default(),
        }
    }

    #[test]
    fn stage_reports_its_findings_and_no_notes() {
        use Dimension::{Behavior, Recovery, Shadow};
        use ReasonCode as Code;
        let sandbox = blocked_end(
            Stage::Sandbox,
            &[
                (Code::BehaviorEndedEarly, Behavior, "the pairs ended early"),
                (Code::BehaviorEstablishedWorse, Behavior, "time is established as worse"),
                (Code::BehaviorSuspicious, Behavior, "retry may be worse beyond its tolerance"),
                (Code::BehaviorImproved, Behavior, "success is better"),
                (Code::RecoveryFragile, Recovery, "one kind of drill"),
            ],
        );
        let names = |end: &CandidateEnd| categories(end).into_iter().collect::<Vec<_>>();
        assert_eq!(names(&sandbox), [Regression::Retry, Regression::Timeout, Regression::Recovery]);
        let hits = "policy hits are established as more frequent than under the active version";
        let shadow = blocked_end(
            Stage::Shadow,
            &[
                (Code::ShadowGovernanceDivergence, Shadow, hits),
                (Code::ShadowShifted, Shadow, "success shifted"),
            ],
        );
        assert_eq!(names(&shadow), [Regression::Policy, Regression::Live]);
        let desk = blocked_end(Stage::Validation, &[(Code::RecoveryHookMissing, Recovery, "no hook")]);
        assert!(categories(&desk).is_empty());
        let confirmed = CandidateEnd { fate: Fate::Kept, ..sandbox };
        assert!(categories(&confirmed).is_empty());
    }
}
