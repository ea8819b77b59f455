//! The result of a lab job, returned as the requested kind or as an error.

use super::drills::DrillResult;
use crate::fault::TrialFault;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_runtime::task::TaskRecord;

/// The result of a lab job.
pub enum JobOutcome {
    /// An episode of one version.
    Alone(Box<TaskRecord>),
    /// The same episode of both: the candidate's, the active version's.
    Pair(Box<[TaskRecord; 2]>),
    Drill(DrillResult),
    /// The phases that undisturbed work shows.
    Phases(Vec<WorkPhase>),
    /// The same sequence with both versions in their place: the candidate's, and the active version's where it is not
    /// known.
    Sequences(Vec<TaskRecord>, Option<Vec<TaskRecord>>),
}

impl JobOutcome {
    /// An episode, and the other version's if it was worked too.
    pub(super) fn pair(self) -> Result<(TaskRecord, Option<TaskRecord>), TrialFault> {
        match self {
            Self::Alone(record) => Ok((*record, None)),
            Self::Pair(records) => {
                let [new, old] = *records;
                Ok((new, Some(old)))
            }
            Self::Drill(_) | Self::Phases(_) | Self::Sequences(..) => Err(other("a drill", "an episode")),
        }
    }

    pub(super) fn phases(self) -> Result<Vec<WorkPhase>, TrialFault> {
        let Self::Phases(phases) = self else { return Err(other("something else", "phases")) };
        Ok(phases)
    }

    pub(super) fn sequences(self) -> Result<(Vec<TaskRecord>, Option<Vec<TaskRecord>>), TrialFault> {
        let Self::Sequences(new, old) = self else { return Err(other("something else", "sequences")) };
        Ok((new, old))
    }

    pub(super) fn drill(self) -> Result<DrillResult, TrialFault> {
        let Self::Drill(result) = self else { return Err(other("an episode", "a drill")) };
        Ok(result)
    }
}

fn other(found: &str, wanted: &str) -> TrialFault {
    TrialFault::Impossible(format!("{found} was handed over for {wanted}"))
}
