//! Health over time: results of live tasks by bucket, events beside them, and whether a family is better or worse since a
//! moment.
//!
//! Plain values that the engine computes and every front end shows. Missing data is absent: a bucket without a task is
//! never zero, and nothing is interpolated.

mod alarm_history;
mod chart_content;
mod verdict;

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::clock::clock_time;
use holdpoint_governance::calendar;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::stats::{SHOWN_LEVEL, difference, wilson};

pub use self::alarm_history::{AlarmEpisode, AlarmStep, duration_label};
pub use self::chart_content::{HealthPanel, MarkContent, MarkedAct};
pub use self::verdict::{HealthVerdict, SIDE_TASKS_MIN, Trend, VerdictSide};

/// The most buckets of one answer.
pub const BUCKETS_MAX: u16 = 480;

/// The narrowest bucket, ms: a minute.
pub const BUCKET_MS_MIN: u64 = 60_000;

/// The widest bucket, ms: a day.
pub const BUCKET_MS_MAX: u64 = 86_400_000;

/// The offered bucket widths, ms, the narrowest first.
pub const BUCKET_WIDTHS_MS: [u64; 10] = [
    60_000, 300_000, 900_000, 1_800_000, 3_600_000, 7_200_000, 14_400_000, 28_800_000, 43_200_000, 86_400_000,
];

holdpoint_governance::closed_set! {
    /// The clock of the buckets.
    HealthClock, "clock", {
        /// The machine's, in UTC.
        Wall = "wall",
        /// The engine's own.
        Virtual = "virtual",
    }
}

holdpoint_governance::closed_set! {
    /// Events beside the tasks.
    MarkKind, "kind of mark", {
        /// A candidate passed the gate and became active.
        Promotion = "promotion",
        /// The upgrade was confirmed: no longer provisional.
        Confirmed = "confirmed",
        /// A version was rolled back and never runs again.
        Rollback = "rollback",
        /// A version was returned to evaluation.
        Demotion = "demotion",
        /// An earlier version became active again.
        Restored = "restored",
        /// A family has no active version any more.
        Vacated = "vacated",
        /// The first version of a family became active.
        FirstVersion = "first-version",
        /// A version is restricted.
        Restriction = "restriction",
        /// One person activated a version by break-glass.
        BreakGlass = "break-glass",
        /// A family or the cell became abnormal: degraded, shifted, out of tune.
        DriftAlarm = "drift-alarm",
        /// Another alarm was raised.
        AlarmRaised = "alarm-raised",
        /// A person closed an alarm with a reason.
        AlarmReset = "alarm-reset",
        /// A drift of the live cell set in, or ended.
        Drift = "drift",
        /// Something in the live cell broke or was repaired.
        LiveFault = "live-fault",
        /// A person stopped the cell.
        Stopped = "stopped",
        /// A person started the cell again.
        Released = "released",
        /// The agent has another goal.
        Goal = "goal",
        /// A person left a note.
        Note = "note",
        /// Profile, policy or thresholds came into force.
        Context = "context",
        /// The normal rates of a family were counted.
        Commissioned = "commissioned",
        /// No engine ran, or the machine slept: only the machine's clock advanced.
        EngineOff = "engine-off",
    }
}

impl MarkKind {
    /// The letter that stands for it on a line.
    #[must_use]
    pub const fn letter(self) -> char {
        match self {
            Self::Promotion => 'P',
            Self::Confirmed => 'c',
            Self::Rollback => 'R',
            Self::Demotion => 'D',
            Self::Restored => 'r',
            Self::Vacated => 'V',
            Self::FirstVersion => 'f',
            Self::Restriction => 't',
            Self::BreakGlass => 'E',
            Self::DriftAlarm => '!',
            Self::AlarmRaised => 'a',
            Self::AlarmReset => 'z',
            Self::Drift => 'd',
            Self::LiveFault => 'F',
            Self::Stopped => 'X',
            Self::Released => 'W',
            Self::Goal => 'g',
            Self::Note => 'N',
            Self::Context => 'p',
            Self::Commissioned => 'n',
            Self::EngineOff => 'o',
        }
    }

    /// The display order of several at one place: the smallest number is shown.
    #[must_use]
    pub const fn weight(self) -> u8 {
        match self {
            Self::Rollback | Self::Vacated | Self::BreakGlass => 0,
            Self::Demotion | Self::Promotion | Self::Stopped => 1,
            Self::DriftAlarm | Self::Restriction => 2,
            Self::Drift | Self::LiveFault | Self::Restored => 3,
            Self::Confirmed | Self::Released | Self::EngineOff | Self::Note => 4,
            Self::AlarmRaised | Self::AlarmReset => 5,
            Self::FirstVersion | Self::Goal | Self::Context | Self::Commissioned => 6,
        }
    }
}

/// A query of the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HealthQuery {
    /// The clock; absent for the machine's, if the record has it.
    #[serde(default)]
    pub clock: Option<HealthClock>,
    /// End of the last bucket on that clock, ms. Absent for the current bucket, or for the end of the record if no
    /// engine runs; such buckets begin at whole multiples of their width.
    #[serde(default)]
    pub until_ms: Option<i64>,
    /// Returns alarms only, without tasks and marks.
    #[serde(default)]
    pub only_alarms: bool,
    /// Width of a bucket, ms: [`BUCKET_MS_MIN`] to [`BUCKET_MS_MAX`].
    pub bucket_ms: u64,
    /// How many buckets: 1 to [`BUCKETS_MAX`].
    pub buckets: u16,
}

impl HealthQuery {
    /// Its error, one sentence; `None` if it is valid.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        if !(BUCKET_MS_MIN..=BUCKET_MS_MAX).contains(&self.bucket_ms) {
            return Some(format!(
                "a bucket of {} ms is not allowed; {BUCKET_MS_MIN} (a minute) to {BUCKET_MS_MAX} (a day) are",
                self.bucket_ms
            ));
        }
        (!(1..=BUCKETS_MAX).contains(&self.buckets))
            .then(|| format!("{} buckets are not allowed; 1 to {BUCKETS_MAX} are", self.buckets))
    }
}

/// Results of the live tasks of one version in one bucket, which has at least one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HealthPoint {
    /// The version.
    pub version: CapabilityId,
    /// Which bucket, from 0.
    pub bucket: u32,
    /// Live tasks.
    pub tasks: u64,
    /// Of these, found done by the inspection after the task.
    pub succeeded: u64,
    /// Wilson's 95 % interval of the success rate.
    pub success: [f64; 2],
    /// Tasks with a violation: a measured quantity past its limit, or a denial by the guard.
    pub violated: u64,
    /// Tasks with a violation or a value near its limit.
    pub near: u64,
    /// Median and 95th percentile of the tasks' time, s.
    pub time_s: [f64; 2],
    /// Median and 95th percentile of the tasks' largest force, N.
    pub force_n: [f64; 2],
    /// Virtual time at the end of the first and the last of the tasks, ms.
    pub at_ms: [u64; 2],
}

/// An event beside the tasks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HealthMark {
    /// Its kind.
    pub kind: MarkKind,
    /// When, on the clock of the series, ms.
    pub on_clock_ms: i64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The machine's time, ms since 1970; absent in scripts.
    pub wall_ms: Option<i64>,
    /// The family it is about; absent if it is about the cell.
    pub family: Option<Family>,
    /// One sentence: what, about whom, by whom and why, as the record has it.
    pub text: String,
    /// Its record.
    pub record: u64,
}

/// The basis of the numbers, and the omitted data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HealthCoverage {
    /// Live tasks that are counted.
    pub tasks: u64,
    /// Digested telemetry batches in the requested span.
    pub blocks: u64,
    /// Of these, read. Fewer than all is an evenly spread sample; all other omissions are listed here.
    pub blocks_read: u64,
    /// Tasks without a result: stopped by a person, or lost by a failure of simulator or body.
    pub not_judged: u64,
    /// Batches in the chain that do not exist any more: removed for age, or missing.
    pub removed: u64,
    /// Batches digested only after their engine had ended.
    pub late: u64,
    /// Batches that differ from their digest in the chain, or cannot be read.
    pub damaged: u64,
    /// Tasks without a known machine time, which the machine's clock cannot place.
    pub without_wall: u64,
    /// Omitted marks, the oldest of the least important.
    pub marks_left_off: u64,
    /// Omitted changes of alarms, the oldest.
    pub alarms_left_off: u64,
}

impl HealthCoverage {
    /// Whether only a part of the requested span was read.
    #[must_use]
    pub const fn is_sample(&self) -> bool {
        self.blocks_read < self.blocks
    }
}

/// The health of every family over a span of time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HealthSeries {
    /// The clock of the buckets.
    pub clock: HealthClock,
    /// Beginning of the first bucket on that clock, ms.
    pub from_ms: i64,
    /// Width of a bucket, ms.
    pub bucket_ms: u64,
    /// How many buckets there are, empty ones included.
    pub buckets: u32,
    /// Virtual time of the last record when this was read, ms.
    pub last_at_ms: u64,
    /// The machine's time of the last record, ms since 1970; absent in scripts.
    pub last_wall_ms: Option<i64>,
    /// Every version and bucket with a task, by family, bucket and version.
    pub points: Vec<HealthPoint>,
    /// Events beside them, in order.
    pub marks: Vec<HealthMark>,
    /// The alarms that changed, the newest first.
    pub alarms: Vec<AlarmEpisode>,
    /// The basis of the numbers.
    pub coverage: HealthCoverage,
    /// Live tasks of each family that no record seals yet: they are in no number.
    #[serde(default)]
    pub unsealed: BTreeMap<Family, u64>,
}

impl HealthSeries {
    /// Beginning of a bucket on the clock, ms.
    #[must_use]
    pub fn start_ms(&self, bucket: u32) -> i64 {
        let width = i64::try_from(self.bucket_ms).unwrap_or(i64::MAX);
        self.from_ms.saturating_add(width.saturating_mul(i64::from(bucket)))
    }

    /// End of the last bucket on the clock, ms.
    #[must_use]
    pub fn until_ms(&self) -> i64 {
        self.start_ms(self.buckets)
    }

    /// The bucket of a moment on the clock; `None` if it lies outside.
    #[must_use]
    pub fn bucket_of(&self, on_clock_ms: i64) -> Option<u32> {
        let passed = u64::try_from(on_clock_ms.checked_sub(self.from_ms)?).ok()?;
        let bucket = u32::try_from(passed / self.bucket_ms.max(1)).ok()?;
        (bucket < self.buckets).then_some(bucket)
    }

    /// Families with a task, by name.
    #[must_use]
    pub fn families(&self) -> Vec<Family> {
        let mut families: Vec<Family> = Vec::new();
        for point in &self.points {
            if families.last() != Some(&point.version.family) && !families.contains(&point.version.family) {
                families.push(point.version.family.clone());
            }
        }
        families.sort();
        families
    }

    /// The results of a family's versions in a bucket.
    pub fn at<'a>(
        &'a self,
        family: &'a Family,
        bucket: u32,
    ) -> impl Iterator<Item = &'a HealthPoint> + use<'a> {
        self.points.iter().filter(move |point| point.bucket == bucket && point.version.family == *family)
    }

    /// The marks of a family, or of the cell, in a bucket.
    pub fn marks_in<'a>(
        &'a self,
        family: Option<&'a Family>,
        bucket: u32,
    ) -> impl Iterator<Item = &'a HealthMark> + use<'a> {
        self.marks.iter().filter(move |mark| {
            self.bucket_of(mark.on_clock_ms) == Some(bucket)
                && (family.is_none() || mark.family.is_none() || mark.family.as_ref() == family)
        })
    }

    /// A moment on the clock in words.
    #[must_use]
    pub fn time_text(&self, on_clock_ms: i64) -> String {
        match self.clock {
            HealthClock::Wall => calendar::day_and_time(on_clock_ms),
            HealthClock::Virtual => clock_time(u64::try_from(on_clock_ms).unwrap_or(0)),
        }
    }

    /// Compares a family's success from the beginning of a bucket on with its success before, within the span.
    #[must_use]
    pub fn verdict(&self, family: &Family, bucket: u32) -> HealthVerdict {
        let mut halves = [VerdictSide::default(), VerdictSide::default()];
        for point in self.points.iter().filter(|point| point.version.family == *family) {
            let [before, since] = &mut halves;
            let half = if point.bucket < bucket { before } else { since };
            half.tasks += point.tasks;
            half.succeeded += point.succeeded;
            half.violated += point.violated;
            *half.versions.entry(point.version.clone()).or_default() += point.tasks;
        }
        let [before, since] = halves;
        let counts = |half: &VerdictSide| (half.succeeded, half.tasks);
        let interval = difference(counts(&before), counts(&since), SHOWN_LEVEL).ok();
        HealthVerdict {
            family: family.clone(),
            moment: self.time_text(self.start_ms(bucket)),
            sampled: self.coverage.is_sample(),
            unsealed: self.unsealed.get(family).copied().unwrap_or(0),
            before,
            since,
            interval,
        }
    }
}

/// Success of all versions of a family in one bucket: tasks, done, and the interval of the rate.
#[must_use]
pub fn together<'a>(points: impl Iterator<Item = &'a HealthPoint>) -> Option<(u64, u64, [f64; 2])> {
    let (tasks, done) =
        points.fold((0, 0), |(tasks, done), point| (tasks + point.tasks, done + point.succeeded));
    let interval = wilson(done, tasks, SHOWN_LEVEL).ok()?;
    Some((tasks, done, [interval.lower, interval.upper]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(version: &str, bucket: u32, tasks: u64, succeeded: u64) -> HealthPoint {
        HealthPoint {
            version: version.parse().unwrap(),
            bucket,
            tasks,
            succeeded,
            success: [0.0, 1.0],
            violated: 0,
            near: 0,
            time_s: [4.0, 5.0],
            force_n: [10.0, 20.0],
            at_ms: [0, 1],
        }
    }

    fn series(points: Vec<HealthPoint>) -> HealthSeries {
        HealthSeries {
            clock: HealthClock::Wall,
            from_ms: 1_794_902_400_000,
            bucket_ms: 3_600_000,
            buckets: 24,
            last_at_ms: 0,
            last_wall_ms: None,
            points,
            marks: Vec::new(),
            alarms: Vec::new(),
            coverage: HealthCoverage::default(),
            unsealed: BTreeMap::new(),
        }
    }

    #[test]
    fn a_verdict_has_a_trend() {
        let worse = series(vec![point("grasp@1.0.0", 3, 810, 761), point("grasp@1.0.0", 8, 340, 300)]);
        let grasp = Family::new("grasp").unwrap();
        let verdict = worse.verdict(&grasp, 8);
        assert_eq!(verdict.trend(), Trend::Worse);
        let same = series(vec![point("grasp@1.0.0", 3, 81, 76), point("grasp@1.1.0", 8, 34, 30)]);
        let verdict = same.verdict(&grasp, 8);
        assert_eq!(verdict.trend(), Trend::NotShown);
        // 0 of 2 against 76 of 81 lies beyond the interval, and says nothing.
        for (tasks, trend) in [
            (1, Trend::TooFew),
            (2, Trend::TooFew),
            (SIDE_TASKS_MIN - 1, Trend::TooFew),
            (SIDE_TASKS_MIN, Trend::Worse),
        ] {
            for (before, since, expected) in [((81, 76), (tasks, 0), trend), ((tasks, tasks), (81, 0), trend)]
            {
                let points = vec![
                    point("grasp@1.0.0", 3, before.0, before.1),
                    point("grasp@1.0.0", 8, since.0, since.1),
                ];
                let verdict = series(points).verdict(&grasp, 8);
                assert_eq!(verdict.trend(), expected, "{tasks}");
            }
        }
        let none = series(vec![point("grasp@1.0.0", 3, 81, 76)]).verdict(&grasp, 8);
        assert_eq!(none.trend(), Trend::NoData);
    }

    #[test]
    fn buckets_have_their_columns_and_every_mark_its_own_letter() {
        let series = series(Vec::new());
        assert_eq!(series.bucket_of(series.from_ms), Some(0));
        assert_eq!(series.bucket_of(series.from_ms - 1), None);
        assert_eq!(series.bucket_of(series.until_ms()), None);
        assert_eq!(series.bucket_of(series.until_ms() - 1), Some(23));
        assert_eq!(series.bucket_of(i64::MIN), None);
        let letters: std::collections::BTreeSet<char> = MarkKind::ALL.map(MarkKind::letter).into();
        assert_eq!(letters.len(), MarkKind::ALL.len());
    }
}
