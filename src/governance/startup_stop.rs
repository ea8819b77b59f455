//! Whether an engine starts with the cell stopped, by the state that the previous one left.
//!
//! An engine records that it begins to run the cell, and that it ended cleanly. A beginning without an end is a sudden end:
//! a kill, a panic, a power cut. The state of the cell is then unknown, whatever the profile. Under `sim`, an engine with
//! known seeds records neither: it is an experiment or a demonstration, whose records are equal in every run.

use super::profile::ProfileName;

crate::closed_set! {
    /// Why a cell comes up stopped.
    StartStoppedReason, "reason for coming up stopped", {
        /// The last engine began to run the cell, and no record says that it ended.
        UncleanEnd = "unclean-end",
        /// A person stopped the cell, and that was not on record yet.
        UnrecordedStop = "unrecorded-stop",
    }
}

/// The audit chain's account of the last engine that ran the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LastEngineRun {
    /// It ended cleanly, or none recorded that it began. An engine of a script, one with known seeds under `sim`, or one of
    /// an earlier version records neither: a stop is then on record itself, or in a mark.
    Ended,
    /// It began, and did not end.
    Began,
}

/// Whether an engine under this profile records that it runs the cell. Consoles and services have secret seeds.
#[must_use]
pub const fn records_run_end(profile: ProfileName, has_secret_seeds: bool) -> bool {
    profile.is_at_risk() || has_secret_seeds
}

/// Why the cell comes up stopped, under whatever profile; `None` if it does not. `marked`: a stop is kept beside the
/// record.
#[must_use]
pub const fn start_stopped_reason(last: LastEngineRun, marked: bool) -> Option<StartStoppedReason> {
    match (marked, last) {
        (true, _) => Some(StartStoppedReason::UnrecordedStop),
        (false, LastEngineRun::Began) => Some(StartStoppedReason::UncleanEnd),
        (false, LastEngineRun::Ended) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unclean_end_or_stop_mark_starts_the_cell_stopped() {
        for (last, marked, why) in [
            (LastEngineRun::Ended, false, None),
            (LastEngineRun::Began, false, Some(StartStoppedReason::UncleanEnd)),
            (LastEngineRun::Ended, true, Some(StartStoppedReason::UnrecordedStop)),
            (LastEngineRun::Began, true, Some(StartStoppedReason::UnrecordedStop)),
        ] {
            assert_eq!(start_stopped_reason(last, marked), why, "{last:?}, marked: {marked}");
        }
        let classes = [ProfileName::Sim, ProfileName::Real, ProfileName::Human];
        for (has_secret_seeds, records) in [(true, [true; 3]), (false, [false, true, true])] {
            assert_eq!(classes.map(|profile| records_run_end(profile, has_secret_seeds)), records);
        }
    }
}
