//! Whether it is better or worse since a moment, with how sure that is and what else differs between the two sides.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::Serialize;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::stats::Interval;

/// One side of a moment.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Half {
    /// Live tasks.
    pub tasks: u64,
    /// Of these, done.
    pub succeeded: u64,
    /// Of these, with a violation.
    pub violated: u64,
    /// Who worked them, and how many each.
    pub versions: BTreeMap<CapabilityId, u64>,
}

/// Whether it is better or worse since a moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Whose tasks.
    pub family: Family,
    /// The moment, in words.
    pub moment: String,
    /// Whether only a sample of the tasks was read.
    pub sampled: bool,
    /// As much of the span as lies before it.
    pub before: Half,
    /// From it to the end of the span.
    pub since: Half,
    /// Since minus before, as shares, at 95 %: Newcombe's interval of two Wilson intervals; absent where a side has no task.
    pub interval: Option<Interval>,
}

/// Which way it went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trend {
    /// The interval lies above zero.
    Better,
    /// It lies below zero.
    Worse,
    /// Zero is within it.
    NotShown,
    /// A side has no task.
    NoData,
}

impl Verdict {
    /// Which way success went.
    #[must_use]
    pub fn trend(&self) -> Trend {
        match self.interval {
            None => Trend::NoData,
            Some(interval) if interval.lower > 0.0 => Trend::Better,
            Some(interval) if interval.upper < 0.0 => Trend::Worse,
            Some(_) => Trend::NotShown,
        }
    }

    /// The verdict with its numbers, one sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { family, moment, sampled, before, since, interval } = self;
        let side = |half: &Half| {
            if half.tasks == 0 {
                return "no task on record".to_owned();
            }
            format!("{:.1} % of {}", 100.0 * half.succeeded as f64 / half.tasks as f64, half.tasks)
        };
        let mut text =
            format!("success of {family} since {moment}: {}, before {}", side(since), side(before));
        if let Some(Interval { lower, upper, .. }) = interval {
            let share = |half: &Half| half.succeeded as f64 / half.tasks.max(1) as f64;
            let points = 100.0 * (share(since) - share(before));
            let (low, high) = (100.0 * lower, 100.0 * upper);
            let _ = match self.trend() {
                // The direction is in the word: the numbers have no sign.
                Trend::Worse => {
                    write!(text, ": worse by {:.1} points [{:.1}, {:.1}]", -points, -high, -low)
                }
                Trend::Better => write!(text, ": better by {points:.1} points [{low:.1}, {high:.1}]"),
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

    /// What else differs between the two sides, if who worked does; one sentence.
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
