//! What `health` prints around the verdicts: the span, an empty span, the heading of a chart, marks that are left out.

use std::fmt::Display;

use holdpoint_protocol::health::HealthClock;

use crate::counted;

/// The span of a report: its ends, its clock, the length of a bucket, the end of the record.
#[must_use]
pub fn span(from: &str, until: &str, clock: HealthClock, bucket_min: u64, record_end: &str) -> String {
    let by = match clock {
        HealthClock::Wall => "UTC",
        HealthClock::Virtual => "by the engine's clock",
    };
    format!("{from} to {until}, {by}; a bucket is {bucket_min} min; the record ends {record_end}")
}

/// A span without a task.
pub const NO_TASKS: &str = "no live task of this span is on record: only tasks of versions that passed the gate are \
                            kept, and none of a family's baseline";

/// The heading of a chart, with the lowest success that it shows, percent.
#[must_use]
pub fn chart_heading(family: impl Display, lowest_percent: f64) -> String {
    format!("{family}: success by bucket, from {lowest_percent:.0} % to 100 %")
}

/// Marks before the first one that is printed.
#[must_use]
pub fn earlier_marks(count: usize) -> String {
    format!("({}: --json and --csv list all)", counted(count, "earlier mark"))
}

/// A panel of a chart without a task.
pub const EMPTY_PANEL: &str = "no task on record";

/// Marks that a chart does not list.
#[must_use]
pub fn unlisted_marks(more: usize) -> String {
    format!("and {}", counted(more, "more mark"))
}
