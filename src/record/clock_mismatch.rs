//! The record of a clock mismatch.

use holdpoint_governance::wall_time::{ClockMismatch, WallTime};
use serde::{Deserialize, Serialize};

/// A clock mismatch in the audit chain.
#[derive(Serialize, Deserialize)]
pub struct ClockMismatchRecord {
    pub doubt: ClockMismatch,
    /// The time of the machine's clock.
    pub said: Option<WallTime>,
}

/// The mismatch in a record's body. An unreadable body counts as a mismatch.
#[must_use]
pub fn read(body: &str) -> ClockMismatch {
    let unread = ClockMismatch::Jumped { by_ms: 0 };
    serde_json::from_str::<ClockMismatchRecord>(body).map_or(unread, |on_record| on_record.doubt)
}
