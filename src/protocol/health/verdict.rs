//! Whether a family is better or worse since a moment, with the interval and other differences of the two sides.

use std::collections::BTreeMap;
use std::fmt::Write as _;

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

    /// The verdict with its numbers, one sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { family, moment, sampled, before, since, interval } = self;
        let side = |half: &VerdictSide| {
            if half.tasks == 0 {
                return "no task on record".to_owned();
            }
            format!("{:.1} % of {}", 100.0 * half.succeeded as f64 / half.tasks as f64, half.tasks)
        };
        let mut text =
            format!("success of {family} since {moment}: {}, before {}", side(since), side(before));
        if let Some(Interval { lower, upper, .. }) = interval {
            let share = |half: &VerdictSide| half.succeeded as f64 / half.tasks.max(1) as f64;
            let points = 100.0 * (share(since) - share(before));
            let (low, high) = (100.0 * lower, 100.0 * upper);
            let _ = match self.trend() {
                // The direction is in the word: the numbers have no sign.
                Trend::Worse => {
                    write!(text, ": worse by {:.1} points [{:.1}, {:.1}]", -points, -high, -low)
                }
                Trend::Better => write!(text, ": better by {points:.1} points [{low:.1}, {high:.1}]"),
                Trend::TooFew => {
                    write!(text, ": too few to compare, {SIDE_TASKS_MIN} on each side are needed")
                }
                Trend::NotShown | Trend::NoData => {
                    write!(text, ": no difference shown, {points:+.1} points [{low:+.1}, {high:+.1}]")
                }
            };
        }
        if *sampled {
            text.push_str(", of a sample");
        }
        text
    }

    /// The different versions of the two sides, if any; one sentence.
    #[must_use]
    pub fn confounding(&self) -> Option<String> {
        let (before, since) = (&self.before.versions, &self.since.versions);
        if before.is_empty() || since.is_empty() || before.keys().eq(since.keys()) && before.len() == 1 {
            return None;
        }
        let who = |versions: &BTreeMap<CapabilityId, u64>| {
            let all: Vec<String> =
                versions.iter().map(|(version, tasks)| format!("{version} ({tasks})")).collect();
            all.join(", ")
        };
        Some(format!("not the same version worked: before {}, since {}", who(before), who(since)))
    }
}
