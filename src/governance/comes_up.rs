//! Whether an engine comes up with the cell stopped, by what the one before it left.
//!
//! Under `real` and `human` an engine puts on record that it begins to work the cell, and that it ended in good order. A
//! beginning without an end is a sudden end: a kill, a panic, a power cut. Nobody knows what stood in the cell then.

use super::profile::ProfileName;

crate::words! {
    /// Why a cell comes up stopped.
    ComesUpStopped, "reason for coming up stopped", {
        /// The last engine began to work the cell, and no record says that it ended.
        UncleanEnd = "unclean-end",
        /// Somebody stopped the cell, and that was not on record yet.
        UnrecordedStop = "unrecorded-stop",
    }
}

/// What the audit chain says of the last engine that worked the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LastEngine {
    /// It ended in good order; or none put on record that it began. An engine under `sim`, of a script, or of an earlier
    /// version puts nothing on record: what was stopped then is on record itself, or in a mark.
    Ended,
    /// It began, and did not end.
    Began,
}

/// Whether an engine under this profile puts on record that it works the cell.
#[must_use]
pub const fn keeps_its_end(profile: ProfileName) -> bool {
    match profile {
        ProfileName::Sim => false,
        ProfileName::Real | ProfileName::Human => true,
    }
}

/// Why the cell comes up stopped, under whatever profile; `None` if it does not. `marked`: a stop is kept beside the
/// record.
#[must_use]
pub const fn comes_up_stopped(last: LastEngine, marked: bool) -> Option<ComesUpStopped> {
    match (marked, last) {
        (true, _) => Some(ComesUpStopped::UnrecordedStop),
        (false, LastEngine::Began) => Some(ComesUpStopped::UncleanEnd),
        (false, LastEngine::Ended) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beginning_without_an_end_and_a_mark_stop_the_cell() {
        for (last, marked, why) in [
            (LastEngine::Ended, false, None),
            (LastEngine::Began, false, Some(ComesUpStopped::UncleanEnd)),
            (LastEngine::Ended, true, Some(ComesUpStopped::UnrecordedStop)),
            (LastEngine::Began, true, Some(ComesUpStopped::UnrecordedStop)),
        ] {
            assert_eq!(comes_up_stopped(last, marked), why, "{last:?}, marked: {marked}");
        }
        assert_eq!(ProfileName::ALL.map(keeps_its_end), [false, true, true]);
    }
}
