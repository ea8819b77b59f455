//! Clocks, repeated samples, and the two numbers that are reported of them.
//!
//! Owns how a figure is taken; must not know the subject.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use super::BenchError;

/// The clock of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FigureClock {
    /// CPU time of the measuring thread: other programs on the machine hardly affect it.
    ThreadCpu,
    /// CPU time of all threads of the program.
    ProcessCpu,
    /// Elapsed time, for work that waits for the disk.
    Wall,
}

impl FigureClock {
    /// The name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ThreadCpu => "thread cpu",
            Self::ProcessCpu => "process cpu",
            Self::Wall => "wall",
        }
    }

    /// The clock's reading, s, from any fixed point.
    #[must_use]
    pub fn secs(self) -> f64 {
        let id = match self {
            Self::ThreadCpu => ClockId::ThreadCPUTime,
            Self::ProcessCpu => ClockId::ProcessCPUTime,
            Self::Wall => ClockId::Monotonic,
        };
        let reading = clock_gettime(id);
        reading.tv_sec as f64 + 1.0e-9 * reading.tv_nsec as f64
    }
}

/// The unit a figure is given in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum FigureUnit {
    /// Microseconds, written `us`.
    #[serde(rename = "us")]
    Micros,
    /// Milliseconds, written `ms`.
    #[serde(rename = "ms")]
    Millis,
}

impl FigureUnit {
    /// The name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Micros => "us",
            Self::Millis => "ms",
        }
    }

    const fn per_sec(self) -> f64 {
        match self {
            Self::Micros => 1.0e6,
            Self::Millis => 1.0e3,
        }
    }
}

/// How long a figure may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FigureEffort {
    /// Fewest samples of a figure; without them there is no figure.
    pub samples_min: usize,
    /// Most samples of a figure.
    pub samples_max: usize,
    /// Time after which no sample beyond the fewest is begun, s.
    pub slow_secs: f64,
    /// The same for what takes microseconds, s.
    pub fast_secs: f64,
    /// Records of the audit chain that is verified.
    pub audit_records: u64,
}

impl FigureEffort {
    pub const DEFAULT: Self =
        Self { samples_min: 5, samples_max: 101, slow_secs: 1.5, fast_secs: 0.5, audit_records: 10_000 };
    /// A run of some seconds, as a check.
    pub const QUICK: Self =
        Self { samples_min: 3, samples_max: 31, slow_secs: 0.25, fast_secs: 0.1, audit_records: 2_000 };
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredFigure {
    pub name: String,
    /// Samples it was taken from.
    pub n: usize,
    /// Median of the samples.
    pub median: f64,
    /// The sample that nine in ten are at or below.
    pub p90: f64,
    pub unit: FigureUnit,
    /// The clock.
    pub clock: FigureClock,
    /// The content of one sample.
    pub sample: &'static str,
}

/// The subject of a measurement, and how it is reported.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    pub(super) name: String,
    pub(super) unit: FigureUnit,
    pub(super) clock: FigureClock,
    pub(super) sample: &'static str,
}

impl Figure {
    pub(super) fn new(
        name: impl Into<String>,
        unit: FigureUnit,
        clock: FigureClock,
        sample: &'static str,
    ) -> Self {
        Self { name: name.into(), unit, clock, sample }
    }

    /// Takes samples for `secs_max`, after one call that is not counted. `work` gets the number of the call and returns
    /// its units of work, which divide its time; `None` if the call does not count.
    pub(super) fn take(
        self,
        effort: &FigureEffort,
        secs_max: f64,
        mut work: impl FnMut(u64) -> Result<Option<u64>, BenchError>,
    ) -> Result<MeasuredFigure, BenchError> {
        work(0)?;
        let begin = Instant::now();
        let mut samples = Vec::new();
        // A call that does not count must not keep the figure from ending.
        for call in 1..=4 * effort.samples_max as u64 {
            let before = self.clock.secs();
            let units = work(call)?;
            let spent = self.clock.secs() - before;
            samples.extend(units.filter(|units| *units > 0).map(|units| spent / units as f64));
            let enough = samples.len() >= effort.samples_min && begin.elapsed().as_secs_f64() >= secs_max;
            if enough || samples.len() >= effort.samples_max {
                break;
            }
        }
        self.of(samples, effort.samples_min)
    }

    /// The figure of samples in seconds.
    pub(super) fn of(self, mut samples: Vec<f64>, needed: usize) -> Result<MeasuredFigure, BenchError> {
        samples.sort_by(f64::total_cmp);
        let too_few = BenchError::TooFew { name: self.name.clone(), found: samples.len(), needed };
        if samples.len() < needed {
            return Err(too_few);
        }
        let (Some(median), Some(p90)) = (median(&samples), quantile(&samples, 9, 10)) else {
            return Err(too_few);
        };
        let scale = self.unit.per_sec();
        Ok(MeasuredFigure {
            name: self.name,
            n: samples.len(),
            median: median * scale,
            p90: p90 * scale,
            unit: self.unit,
            clock: self.clock,
            sample: self.sample,
        })
    }
}

/// Median of sorted samples: the middle one, or the mean of the two.
#[must_use]
pub fn median(sorted: &[f64]) -> Option<f64> {
    let upper = sorted.get(sorted.len() / 2)?;
    if sorted.len() % 2 == 1 {
        return Some(*upper);
    }
    sorted.get(sorted.len() / 2 - 1).map(|lower| f64::midpoint(*lower, *upper))
}

/// Nearest-rank quantile `part / whole` of sorted samples.
fn quantile(sorted: &[f64], part: usize, whole: usize) -> Option<f64> {
    let rank = (sorted.len() * part).div_ceil(whole);
    sorted.get(rank.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_few_samples() {
        for (sorted, middle, ninth) in [
            (vec![], None, None),
            (vec![3.0], Some(3.0), Some(3.0)),
            (vec![1.0, 2.0], Some(1.5), Some(2.0)),
            ((1..=10).map(f64::from).collect(), Some(5.5), Some(9.0)),
            ((1..=11).map(f64::from).collect(), Some(6.0), Some(10.0)),
        ] {
            assert_eq!(median(&sorted), middle, "{sorted:?}");
            assert_eq!(quantile(&sorted, 9, 10), ninth, "{sorted:?}");
        }
    }

    #[test]
    fn unmeasured_calls_give_no_figure() {
        let effort = FigureEffort { samples_min: 2, samples_max: 4, ..FigureEffort::QUICK };
        let figure = || Figure::new("nothing", FigureUnit::Micros, FigureClock::Wall, "a call");
        let mut calls = 0;
        let none = figure().take(&effort, 0.0, |_| {
            calls += 1;
            Ok(None)
        });
        assert!(matches!(none, Err(BenchError::TooFew { found: 0, needed: 2, .. })), "{none:?}");
        assert_eq!(calls, 17);
        let some = figure().take(&effort, 1.0e9, |call| Ok((call % 2 == 0).then_some(1))).unwrap();
        assert_eq!(some.n, 4);
        assert!(some.median <= some.p90);
    }
}
