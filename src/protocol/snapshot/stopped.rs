//! A stopped cell: who stopped it, when and why.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::caller::Caller;
use holdpoint_governance::wall_time::WallTime;

/// A cell that a person stopped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StoppedView {
    /// The person's own name, unverified.
    pub by: String,
    /// The requesting process, as the operating system reports it.
    pub caller: Caller,
    /// Why, in the person's own words; may be empty.
    pub reason: String,
    /// Virtual time of the stop, ms.
    pub since_ms: u64,
    /// The wall time of it; absent in scripts, and if it is on no record yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<WallTime>,
    /// Ticks from the request until every joint is at rest; absent before.
    pub stood_after_ticks: Option<u64>,
    /// Later stops, by the time of each person's last one: the last [`STOPS_NAMED_MAX`] of them.
    #[serde(default)]
    pub again: Vec<RepeatedStop>,
    /// Number of further stops between the first and those.
    #[serde(default)]
    pub unnamed: u64,
    /// Stops since the cell last ran, the first included; a start request states how many of them its signer knows.
    #[serde(default)]
    pub stops: u64,
}

/// The most people named for later stops.
pub const STOPS_NAMED_MAX: usize = 4;

/// A further stop of a stopped cell. The person who starts the cell again answers for this one too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RepeatedStop {
    /// The person's own name, unverified.
    pub by: String,
    /// The requesting process, as the operating system reports it.
    pub caller: Caller,
    /// Why, in the person's own words; may be empty.
    pub reason: String,
    /// Virtual time of it, ms.
    pub at_ms: u64,
    /// The wall time of it; absent in scripts, and if it is on no record yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<WallTime>,
}

impl StoppedView {
    /// A first stop; the arm may still move.
    #[must_use]
    pub const fn first(by: String, caller: Caller, reason: String, since_ms: u64) -> Self {
        Self {
            by,
            caller,
            reason,
            since_ms,
            wall: None,
            stood_after_ticks: None,
            again: Vec::new(),
            unnamed: 0,
            stops: 1,
        }
    }

    /// Adds a stop of the stopped cell. A repetition with the same reason is kept once, with the last time.
    pub fn record_repeat(&mut self, stop: RepeatedStop) {
        let is_same =
            |one: &RepeatedStop| one.by == stop.by && one.caller == stop.caller && one.reason == stop.reason;
        self.stops += 1;
        self.again.retain(|one| !is_same(one));
        self.again.push(stop);
        if self.again.len() > STOPS_NAMED_MAX {
            self.again.remove(0);
            self.unnamed += 1;
        }
    }

    /// Virtual time of the last stop, ms.
    #[must_use]
    pub fn last_ms(&self) -> u64 {
        self.again.last().map_or(self.since_ms, |stop| stop.at_ms)
    }
}
