//! The camera check: whether the camera measures as it did when the cell was commissioned.
//!
//! No skill influences what is charted here, so ten tasks reveal what ten outcomes cannot: a camera that shakes or
//! loses frames. Normal is the largest value of the first live tasks, with any active version, and is stored; until
//! then, and beyond it, the profile's limits apply. Pure, as [`crate::health`].

use serde::{Deserialize, Serialize};

use crate::profile::HealthSettings;
use crate::stats::{Cusum, StatsError, wilson_upper};

crate::closed_set! {
    /// The signals of the camera check.
    SensorSignal, "sense of the cell", {
        /// Root mean square of how far the fixed tray moves from one camera frame to the next, m.
        PictureJitter = "picture-jitter",
        /// Share of the task's ticks, after the first camera frame, in which the newest frame was lost.
        PicturesMissing = "pictures-missing",
    }
}

/// The readings of one task; absent where nothing could be measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorReadings {
    /// See [`SensorSignal::PictureJitter`], m.
    pub picture_jitter_m: Option<f64>,
    /// See [`SensorSignal::PicturesMissing`].
    pub pictures_missing: Option<f64>,
}

impl SensorReadings {
    /// The value of a signal, in its unit.
    #[must_use]
    pub const fn of(&self, sense: SensorSignal) -> Option<f64> {
        match sense {
            SensorSignal::PictureJitter => self.picture_jitter_m,
            SensorSignal::PicturesMissing => self.pictures_missing,
        }
    }
}

/// The normal values at commissioning: the largest value of each signal in one task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorBaseline {
    /// Tasks it was measured over.
    pub tasks: u32,
    /// See [`SensorSignal::PictureJitter`], m.
    pub picture_jitter_m: f64,
    /// See [`SensorSignal::PicturesMissing`].
    pub pictures_missing: f64,
}

impl SensorBaseline {
    /// The largest value of a signal, in its unit.
    #[must_use]
    pub const fn of(&self, sense: SensorSignal) -> f64 {
        match sense {
            SensorSignal::PictureJitter => self.picture_jitter_m,
            SensorSignal::PicturesMissing => self.pictures_missing,
        }
    }
}

/// A finding of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SensorFinding {
    /// The normal values are known now and must be stored.
    Commissioned(SensorBaseline),
    /// A signal is significantly worse than normal.
    Degraded(SensorSignal),
    /// Enough tasks in a row were good: the condition is over.
    Over,
}

/// The camera check of one cell.
#[derive(Clone, Debug)]
pub struct SensorMonitor {
    settings: HealthSettings,
    normal: Option<SensorBaseline>,
    /// Measured so far, while nothing is known, and how many of these tasks were bad.
    tally: SensorBaseline,
    bad: u32,
    charts: Vec<(SensorSignal, Cusum)>,
    /// Tasks in a row without anything bad.
    good: u32,
    degraded: bool,
}

impl SensorMonitor {
    /// The camera check of a cell; `normal` comes from its commissioning, absent before it. A condition whose alarm
    /// predates a restart (`degraded`) is present until it is measured to be over.
    ///
    /// # Errors
    /// Settings that no chart can be tuned with.
    pub fn new(
        settings: HealthSettings,
        normal: Option<SensorBaseline>,
        degraded: bool,
    ) -> Result<Self, StatsError> {
        let charts = charts(&settings)?;
        Ok(Self { settings, normal, tally: SensorBaseline::default(), bad: 0, charts, good: 0, degraded })
    }

    /// From where on a sense counts as bad, in its unit: above the commissioning by the margin, and never above the
    /// profile's limit.
    #[must_use]
    pub fn limit(&self, sense: SensorSignal) -> f64 {
        let most = match sense {
            SensorSignal::PictureJitter => self.settings.jitter_max_m,
            SensorSignal::PicturesMissing => self.settings.missing_max,
        };
        self.normal.map_or(most, |normal| {
            let floor = self.settings.sense_floor_share * most;
            (normal.of(sense).max(floor) * self.settings.sense_margin).min(most)
        })
    }

    /// Takes in one live task of any version.
    ///
    /// # Errors
    /// As [`SensorMonitor::new`].
    pub fn observe(&mut self, sensed: &SensorReadings) -> Result<Vec<SensorFinding>, StatsError> {
        let mut alarmed = None;
        let mut all_good = true;
        let limits = SensorSignal::ALL.map(|sense| (sense, self.limit(sense)));
        for (sense, limit) in limits {
            let Some(value) = sensed.of(sense) else { continue };
            // A value that is no number is above every limit.
            let good = matches!(value.partial_cmp(&limit), Some(order) if order.is_le());
            all_good &= good;
            let chart = self.charts.iter_mut().find(|(charted, _)| *charted == sense);
            if chart.is_some_and(|(_, cusum)| cusum.update(!good)) {
                alarmed.get_or_insert(sense);
            }
        }
        self.good = if all_good { self.good.saturating_add(1) } else { 0 };
        let mut found = Vec::new();
        if let (Some(sense), false) = (alarmed, self.degraded) {
            self.degraded = true;
            found.push(SensorFinding::Degraded(sense));
        } else if self.degraded && self.good >= self.settings.clear_tasks {
            self.degraded = false;
            // A chart that alarmed stays so; later tasks are charted afresh.
            self.charts = charts(&self.settings)?;
            found.push(SensorFinding::Over);
        }
        found.extend(self.samples_counted(sensed, all_good).map(SensorFinding::Commissioned));
        Ok(found)
    }

    /// Counts toward the commissioning, which a cell beyond the profile's limits does not get.
    fn samples_counted(&mut self, sensed: &SensorReadings, is_good: bool) -> Option<SensorBaseline> {
        if self.normal.is_some() {
            return None;
        }
        let (Some(jitter_m), Some(missing)) = (sensed.picture_jitter_m, sensed.pictures_missing) else {
            return None;
        };
        let tally = &mut self.tally;
        tally.tasks += 1;
        tally.picture_jitter_m = tally.picture_jitter_m.max(jitter_m);
        tally.pictures_missing = tally.pictures_missing.max(missing);
        self.bad += u32::from(!is_good);
        if tally.tasks < self.settings.commissioning_tasks {
            return None;
        }
        let done = std::mem::take(tally);
        if std::mem::take(&mut self.bad) > 0 || self.degraded {
            return None;
        }
        self.normal = Some(done);
        Some(done)
    }
}

/// One for each signal: how often a task is beyond the largest value of the commissioning.
fn charts(settings: &HealthSettings) -> Result<Vec<(SensorSignal, Cusum)>, StatsError> {
    let normal = wilson_upper(0, settings.commissioning_tasks.into(), settings.normal_alpha)?;
    let normal = normal.clamp(settings.rate_min, settings.failure_max);
    SensorSignal::ALL
        .into_iter()
        .map(|sense| Ok((sense, Cusum::new(normal, normal + settings.shift, settings.cusum_limit)?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Profile, ProfileName};

    const STEADY: SensorReadings =
        SensorReadings { picture_jitter_m: Some(0.002), pictures_missing: Some(0.1) };

    fn settings() -> HealthSettings {
        Profile::builtin(ProfileName::Sim).unwrap().health
    }

    fn commissioned() -> SensorMonitor {
        let mut monitor = SensorMonitor::new(settings(), None, false).unwrap();
        let found: Vec<SensorFinding> =
            (0..settings().commissioning_tasks).flat_map(|_| monitor.observe(&STEADY).unwrap()).collect();
        let tasks = settings().commissioning_tasks;
        let normal = SensorBaseline { tasks, picture_jitter_m: 0.002, pictures_missing: 0.1 };
        assert_eq!(found, [SensorFinding::Commissioned(normal)]);
        monitor
    }

    fn until(monitor: &mut SensorMonitor, task: &SensorReadings, expected: SensorFinding) -> Option<u32> {
        (1..=60).find(|_| monitor.observe(task).unwrap().contains(&expected))
    }

    #[test]
    fn each_signal_alarms_within_ten_tasks_and_clears_when_measured() {
        for (sense, after, before) in [
            (SensorSignal::PictureJitter, 0.003, settings().jitter_max_m * 1.01),
            (SensorSignal::PicturesMissing, 0.15, settings().missing_max * 1.01),
        ] {
            for (mut monitor, value) in
                [(commissioned(), after), (SensorMonitor::new(settings(), None, false).unwrap(), before)]
            {
                let knocked = match sense {
                    SensorSignal::PictureJitter => SensorReadings { picture_jitter_m: Some(value), ..STEADY },
                    SensorSignal::PicturesMissing => {
                        SensorReadings { pictures_missing: Some(value), ..STEADY }
                    }
                };
                let alarm = until(&mut monitor, &knocked, SensorFinding::Degraded(sense)).unwrap();
                assert!(alarm <= 10, "{sense}: {alarm}");
                assert_eq!(monitor.normal.is_some(), value == after, "what is bad does not become normal");
                let over = until(&mut monitor, &STEADY, SensorFinding::Over);
                assert_eq!(over, Some(settings().clear_tasks));
            }
        }
    }

    #[test]
    fn shaky_cell_is_not_commissioned_and_nan_raises_a_finding() {
        let mut monitor = SensorMonitor::new(settings(), None, false).unwrap();
        let shaky = SensorReadings { picture_jitter_m: Some(0.02), ..STEADY };
        for _ in 0..5 * settings().commissioning_tasks {
            monitor.observe(&shaky).unwrap();
        }
        assert_eq!(monitor.normal, None);
        let broken = SensorReadings { picture_jitter_m: Some(f64::NAN), ..STEADY };
        let found = until(&mut commissioned(), &broken, SensorFinding::Degraded(SensorSignal::PictureJitter));
        assert!(found.is_some_and(|tasks| tasks <= 10));
    }

    #[test]
    fn degraded_sensor_survives_a_restart_until_measured_good() {
        let normal = commissioned().normal;
        let mut restarted = SensorMonitor::new(settings(), normal, true).unwrap();
        assert_eq!(until(&mut restarted, &STEADY, SensorFinding::Over), Some(settings().clear_tasks));
    }
}
