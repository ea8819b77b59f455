//! Whether a family is better or worse since a moment, with the interval and other differences of the two sides.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::stats::Interval;

/// The fewest tasks of a side from which a difference is stated. Of two sides with one rate of .5 to .99, fewer are called
/// different in up to .15 of all comparisons (one task) and .07 (19), as against the nominal .05.
pub const SIDE_TASKS_MIN: u64 = 20;

/// One side of a moment.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct VerdictSide {
    /// Live tasks.
    pub tasks: u64,
    /// Of these, done.
    pub succeeded: u64,
    /// Of these, with a violation.
    pub violated: u64,
    /// The versions that ran them, with their counts.
    pub versions: BTreeMap<CapabilityId, u64>,
}

/// The comparison of the tasks before and since a moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HealthVerdict {
    /// The family.
    pub family: Family,
    /// The moment, in words.
    pub moment: String,
    /// Whether only a sample of the tasks was read.
    pub sampled: bool,
    /// The newest live tasks, which no record seals yet: they are on neither side.
    pub unsealed: u64,
    /// The part of the span before it.
    pub before: VerdictSide,
    /// From it to the end of the span.
    pub since: VerdictSide,
    /// Rate since minus rate before, at 95 %: Newcombe's interval of two Wilson intervals; absent if a side has no task.
    pub interval: Option<Interval>,
}

/// The direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trend {
    /// The interval lies above zero.
    Better,
    /// It lies below zero.
    Worse,
    /// It contains zero.
    NotShown,
    /// A side has fewer than [`SIDE_TASKS_MIN`] tasks.
    TooFew,
    /// A side has no task.
    NoData,
}

impl HealthVerdict {
    /// The direction of success.
    #[must_use]
    pub fn trend(&self) -> Trend {
        match self.interval {
            None => Trend::NoData,
            Some(_) if self.before.tasks.min(self.since.tasks) < SIDE_TASKS_MIN => Trend::TooFew,
            Some(interval) if interval.lower > 0.0 => Trend::Better,
            Some(interval) if interval.upper < 0.0 => Trend::Worse,
            Some(_) => Trend::NotShown,
        }
    }
}
