//! A live task as telemetry keeps it: its record, and what the record itself cannot say.

use holdpoint_runtime::task::TaskRecord;
use serde::{Deserialize, Serialize};

/// The stream of telemetry that live tasks of watched versions are kept in.
pub(crate) const LIVE: &str = "live";

/// As above, of versions that no monitor watches: without their paths. No rule reads them; they say how it was before
/// an upgrade.
pub(crate) const UNWATCHED: &str = "live-unwatched";

/// A live task, to be written.
#[derive(Serialize)]
pub(crate) struct KeptTask<'a> {
    #[serde(flatten)]
    pub(crate) record: &'a TaskRecord,
    #[serde(flatten)]
    pub(crate) marks: KeptMarks,
}

/// What stands beside the record of a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct KeptMarks {
    /// A person stopped the arm in its midst: it is judged as no task.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(crate) cut_short: bool,
    /// The monitor was told that a person stepped in, and nothing else of it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(crate) stepped_in: bool,
    /// It was worked under a tighter envelope than the version was measured under.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(crate) tightened: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;

    /// Stores made before there was a mark read and write as they did.
    #[test]
    fn a_task_without_a_mark_is_kept_as_its_record_alone() {
        let record = TaskRecord::invalid(TaskKind::Align, 7);
        let kept = |cut_short| {
            let marks = KeptMarks { cut_short, ..KeptMarks::default() };
            serde_json::to_vec(&KeptTask { record: &record, marks }).unwrap()
        };
        assert_eq!(kept(false), serde_json::to_vec(&record).unwrap());
        for cut_short in [false, true] {
            let (body, marks) = (kept(cut_short), KeptMarks { cut_short, ..KeptMarks::default() });
            assert_eq!(serde_json::from_slice::<TaskRecord>(&body).unwrap(), record);
            assert_eq!(serde_json::from_slice::<KeptMarks>(&body).unwrap(), marks);
        }
    }
}
