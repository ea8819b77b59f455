//! Times of records, and mismatches of the machine's clock, in words.

use holdpoint_governance::wall_time::{ClockMismatch, WallTime};
use holdpoint_protocol::clock::clock_time;

/// The time of a record for people; virtual time where a script wrote it.
#[must_use]
pub fn record_time(at_ms: u64, wall: Option<WallTime>) -> String {
    wall.map_or_else(|| clock_time(at_ms), WallTime::label)
}

/// How the machine's clock disagrees with the record, one sentence.
#[must_use]
pub fn clock_mismatch(of: &ClockMismatch) -> String {
    let secs = |ms: u64| ms as f64 / 1_000.0;
    match of {
        ClockMismatch::Jumped { by_ms } => {
            let direction = if *by_ms < 0 { "back" } else { "forward" };
            format!("the machine's clock was set {direction} by {:.1} s", secs(by_ms.unsigned_abs()))
        }
        ClockMismatch::Behind { by_ms } => {
            format!("the machine's clock is {:.1} s behind the newest record", secs(*by_ms))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mismatch_names_its_direction_and_size() {
        for (mismatch, text) in [
            (ClockMismatch::Jumped { by_ms: -3_600_000 }, "the machine's clock was set back by 3600.0 s"),
            (ClockMismatch::Jumped { by_ms: 9_000 }, "the machine's clock was set forward by 9.0 s"),
            (ClockMismatch::Behind { by_ms: 1_000 }, "the machine's clock is 1.0 s behind the newest record"),
        ] {
            assert_eq!(clock_mismatch(&mismatch), text);
        }
    }
}
