//! A live task in telemetry: its record, and marks that the record cannot contain.

use holdpoint_runtime::task::TaskRecord;
use serde::{Deserialize, Serialize};

/// The telemetry stream for live tasks of monitored versions.
pub const LIVE: &str = "live";

/// The stream for versions without a monitor, without their paths. No rule reads it; it shows the time before an upgrade.
pub const UNWATCHED: &str = "live-unwatched";

/// A live task, to be written.
#[derive(Serialize)]
pub struct LiveTaskRecord<'a> {
    #[serde(flatten)]
    pub record: &'a TaskRecord,
    #[serde(flatten)]
    pub marks: LiveTaskMarks,
}

/// The marks beside the record of a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct LiveTaskMarks {
    /// A person stopped the arm during the task, of which therefore only a danger counts.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub cut_short: bool,
    /// The monitor received only that a person intervened.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub stepped_in: bool,
    /// It ran under a tighter envelope than the version was measured under.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub tightened: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;

    /// Stores from before the marks read and write as before.
    #[test]
    fn a_task_without_a_mark_is_stored_as_its_record() {
        let record = TaskRecord::invalid(TaskKind::Align, 7);
        let bytes = |cut_short| {
            let marks = LiveTaskMarks { cut_short, ..LiveTaskMarks::default() };
            serde_json::to_vec(&LiveTaskRecord { record: &record, marks }).unwrap()
        };
        assert_eq!(bytes(false), serde_json::to_vec(&record).unwrap());
        for cut_short in [false, true] {
            let (body, marks) = (bytes(cut_short), LiveTaskMarks { cut_short, ..LiveTaskMarks::default() });
            assert_eq!(serde_json::from_slice::<TaskRecord>(&body).unwrap(), record);
            assert_eq!(serde_json::from_slice::<LiveTaskMarks>(&body).unwrap(), marks);
        }
    }
}
