//! The units of work that a stage counts in its progress.

use holdpoint_governance::evidence::{DrillKind, SandboxMode};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How much of one kind of work is done, against the budget of that kind alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PartCount {
    /// What is done of it.
    pub done: u64,
    /// How much there is of it; an early end may come before.
    pub budget: u64,
}

holdpoint_governance::closed_set! {
    /// The unit of work of a progress report. The names are those of records and of the screen.
    WorkUnit, "unit of work", {
        /// Unperturbed episodes of the candidate alone.
        Canonical = "canonical",
        /// Perturbed episodes.
        Perturbation = "perturbation",
        /// Episodes of the candidate alone, under stress.
        Adversarial = "adversarial",
        /// A confirmation begins.
        Confirmation = "confirmation",
        /// A re-evaluation of a version whose behavior shifted begins.
        ReEvaluation = "behavior shifted: re-evaluation",
        /// Pairs of episodes on the same seeds.
        PairedEpisodes = "paired episodes",
        /// Rollback drills.
        RollbackDrills = "rollback drills",
        /// Fallback drills.
        FallbackDrills = "fallback drills",
        /// Abort drills.
        AbortDrills = "abort drills",
        /// Detection drills.
        DetectDrills = "detect drills",
        /// Episodes of the family's anchor.
        AnchorEpisodes = "anchor episodes",
        /// Whole sequences.
        WholeSequences = "whole sequences",
        /// The comparison is complete.
        NothingLeft = "nothing is left",
        /// Pairs of a search for the worst episode.
        WorstCaseSearch = "a search for the worst episode",
        /// Sequences of shadow.
        ShadowSequences = "shadow sequences",
        /// Pairs of a confirmation.
        ConfirmationPairs = "confirmation, paired episodes",
        /// Rollback drills of a confirmation.
        ConfirmationRollbackDrills = "confirmation, rollback drills",
        /// Fallback drills of a confirmation.
        ConfirmationFallbackDrills = "confirmation, fallback drills",
        /// Abort drills of a confirmation.
        ConfirmationAbortDrills = "confirmation, abort drills",
        /// Detection drills of a confirmation.
        ConfirmationDetectDrills = "confirmation, detect drills",
        /// Episodes of the family's anchor in a confirmation.
        ConfirmationAnchorEpisodes = "confirmation, anchor episodes",
        /// Whole sequences of a confirmation.
        ConfirmationSequences = "confirmation, whole sequences",
        /// A confirmation is complete.
        ConfirmationNothingLeft = "confirmation, nothing is left",
        /// Pairs of a re-evaluation.
        ReEvaluationPairs = "behavior shifted: re-evaluation, paired episodes",
        /// Rollback drills of a re-evaluation.
        ReEvaluationRollbackDrills = "behavior shifted: re-evaluation, rollback drills",
        /// Fallback drills of a re-evaluation.
        ReEvaluationFallbackDrills = "behavior shifted: re-evaluation, fallback drills",
        /// Abort drills of a re-evaluation.
        ReEvaluationAbortDrills = "behavior shifted: re-evaluation, abort drills",
        /// Detection drills of a re-evaluation.
        ReEvaluationDetectDrills = "behavior shifted: re-evaluation, detect drills",
        /// Whole sequences of a re-evaluation.
        ReEvaluationSequences = "behavior shifted: re-evaluation, whole sequences",
        /// A re-evaluation is complete.
        ReEvaluationNothingLeft = "behavior shifted: re-evaluation, nothing is left",
    }
}

impl From<DrillKind> for WorkUnit {
    fn from(kind: DrillKind) -> Self {
        match kind {
            DrillKind::Rollback => Self::RollbackDrills,
            DrillKind::Fallback => Self::FallbackDrills,
            DrillKind::Abort => Self::AbortDrills,
            DrillKind::Detect => Self::DetectDrills,
        }
    }
}

impl From<SandboxMode> for WorkUnit {
    fn from(mode: SandboxMode) -> Self {
        match mode {
            SandboxMode::Canonical => Self::Canonical,
            SandboxMode::Perturbation => Self::Perturbation,
            SandboxMode::Adversarial => Self::Adversarial,
            SandboxMode::Confirmation => Self::Confirmation,
        }
    }
}

impl WorkUnit {
    /// The same unit as part of a confirmation.
    #[must_use]
    pub const fn of_confirmation(self) -> Self {
        match self {
            Self::PairedEpisodes => Self::ConfirmationPairs,
            Self::RollbackDrills => Self::ConfirmationRollbackDrills,
            Self::FallbackDrills => Self::ConfirmationFallbackDrills,
            Self::AbortDrills => Self::ConfirmationAbortDrills,
            Self::DetectDrills => Self::ConfirmationDetectDrills,
            Self::AnchorEpisodes => Self::ConfirmationAnchorEpisodes,
            Self::WholeSequences => Self::ConfirmationSequences,
            Self::NothingLeft => Self::ConfirmationNothingLeft,
            _ => Self::Confirmation,
        }
    }

    /// The same unit as part of a re-evaluation.
    #[must_use]
    pub const fn of_re_evaluation(self) -> Self {
        match self {
            Self::PairedEpisodes => Self::ReEvaluationPairs,
            Self::RollbackDrills => Self::ReEvaluationRollbackDrills,
            Self::FallbackDrills => Self::ReEvaluationFallbackDrills,
            Self::AbortDrills => Self::ReEvaluationAbortDrills,
            Self::DetectDrills => Self::ReEvaluationDetectDrills,
            Self::WholeSequences => Self::ReEvaluationSequences,
            Self::NothingLeft => Self::ReEvaluationNothingLeft,
            _ => Self::ReEvaluation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_name_precedes_the_name_of_its_part() {
        for unit in WorkUnit::ALL {
            let (confirmed, again) = (unit.of_confirmation(), unit.of_re_evaluation());
            if confirmed != WorkUnit::Confirmation {
                assert_eq!(confirmed.name(), format!("confirmation, {}", unit.name()));
            }
            if again != WorkUnit::ReEvaluation {
                assert_eq!(again.name(), format!("behavior shifted: re-evaluation, {}", unit.name()));
            }
        }
        for kind in DrillKind::ALL {
            assert_eq!(WorkUnit::from(kind).name(), format!("{} drills", kind.name()));
        }
        for mode in SandboxMode::ALL {
            assert_eq!(WorkUnit::from(mode).name(), mode.name());
        }
    }
}
