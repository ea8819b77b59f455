//! The senses of the cell: whether the camera measures as it did when the cell was commissioned.
//!
//! No skill has a part in what is charted here, so ten tasks tell what ten outcomes cannot: a camera that shakes or
//! loses pictures. What is normal is the largest value of the first live tasks, whoever is active, and is kept; until
//! then, and beyond it, the profile's limits hold. Pure, as [`crate::health`].

use serde::{Deserialize, Serialize};

use crate::profile::HealthSettings;
use crate::stats::{Cusum, DriftSignal, StatsError, wilson_upper};

/// One-sided error of the bound that a commissioning leaves open, as in [`crate::health`].
const NORMAL_ALPHA: f64 = 0.05;

/// Least part of its limit that is taken for normal: a quantity that was hardly there in 40 tasks is not for that
/// reason abnormal when it is measured at all.
const FLOOR_SHARE: f64 = 0.1;

crate::words! {
    /// What is measured of the cell itself.
    Sense, "sense of the cell", {
        /// Root mean square of how far the tray, which stands, moves from one picture to the next, m.
        PictureJitter = "picture-jitter",
        /// Share of the task's ticks, after the first picture, in which the newest picture was lost.
        PicturesMissing = "pictures-missing",
    }
}

/// What one task showed of the cell; absent where nothing could be measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensedValues {
    /// See [`Sense::PictureJitter`], m.
    pub picture_jitter_m: Option<f64>,
    /// See [`Sense::PicturesMissing`].
    pub pictures_missing: Option<f64>,
}

impl SensedValues {
    /// The value of a sense, in its unit.
    #[must_use]
    pub const fn of(&self, sense: Sense) -> Option<f64> {
        match sense {
            Sense::PictureJitter => self.picture_jitter_m,
            Sense::PicturesMissing => self.pictures_missing,
        }
    }
}

/// What was normal when the cell was commissioned: the largest value of each sense in one task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NormalSenses {
    /// Tasks it was measured over.
    pub tasks: u32,
    /// See [`Sense::PictureJitter`], m.
    pub picture_jitter_m: f64,
    /// See [`Sense::PicturesMissing`].
    pub pictures_missing: f64,
}

impl NormalSenses {
    /// The largest value of a sense, in its unit.
    #[must_use]
    pub const fn of(&self, sense: Sense) -> f64 {
        match sense {
            Sense::PictureJitter => self.picture_jitter_m,
            Sense::PicturesMissing => self.pictures_missing,
        }
    }
}

/// What a task brought to light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SensesFinding {
    /// What is normal is known now, and to be kept.
    Commissioned(NormalSenses),
    /// A sense is established as worse than normal.
    Degraded(Sense),
    /// So many tasks in a row were good: the condition is over.
    Over,
}

/// The senses of one cell.
#[derive(Clone, Debug)]
pub struct CellSenses {
    settings: HealthSettings,
    normal: Option<NormalSenses>,
    /// Measured so far, while nothing is known, and how many of these tasks were bad.
    tally: NormalSenses,
    bad: u32,
    charts: Vec<(Sense, Cusum)>,
    /// Tasks in a row without anything bad.
    good: u32,
    degraded: bool,
}

impl CellSenses {
    /// The senses of a cell; `normal` is what its commissioning gave, absent before it. What an alarm from before a
    /// restart stands for (`degraded`) is present until it is measured to be over.
    ///
    /// # Errors
    /// Settings that no chart can be tuned with.
    pub fn new(
        settings: HealthSettings,
        normal: Option<NormalSenses>,
        degraded: bool,
    ) -> Result<Self, StatsError> {
        let charts = charts(&settings)?;
        Ok(Self { settings, normal, tally: NormalSenses::default(), bad: 0, charts, good: 0, degraded })
    }

    /// From where on a sense counts as bad, in its unit: above the commissioning by the margin, and never above the
    /// profile's limit.
    #[must_use]
    pub fn limit(&self, sense: Sense) -> f64 {
        let most = match sense {
            Sense::PictureJitter => self.settings.jitter_max_m,
            Sense::PicturesMissing => self.settings.missing_max,
        };
        self.normal.map_or(most, |normal| {
            (normal.of(sense).max(FLOOR_SHARE * most) * self.settings.sense_margin).min(most)
        })
    }

    /// Takes in one live task, whoever worked it.
    ///
    /// # Errors
    /// As [`CellSenses::new`].
    pub fn observe(&mut self, sensed: &SensedValues) -> Result<Vec<SensesFinding>, StatsError> {
        let mut alarmed = None;
        let mut all_good = true;
        let limits = Sense::ALL.map(|sense| (sense, self.limit(sense)));
        for (sense, limit) in limits {
            let Some(value) = sensed.of(sense) else { continue };
            // A value that is no number is above every limit.
            let good = matches!(value.partial_cmp(&limit), Some(order) if order.is_le());
            all_good &= good;
            let chart = self.charts.iter_mut().find(|(charted, _)| *charted == sense);
            if chart.is_some_and(|(_, cusum)| cusum.update(!good) == DriftSignal::Alarm) {
                alarmed.get_or_insert(sense);
            }
        }
        self.good = if all_good { self.good.saturating_add(1) } else { 0 };
        let mut found = Vec::new();
        if let (Some(sense), false) = (alarmed, self.degraded) {
            self.degraded = true;
            found.push(SensesFinding::Degraded(sense));
        } else if self.degraded && self.good >= self.settings.clear_tasks {
            self.degraded = false;
            // A chart that alarmed stays so; what comes next is looked at afresh.
            self.charts = charts(&self.settings)?;
            found.push(SensesFinding::Over);
        }
        found.extend(self.count(sensed, all_good).map(SensesFinding::Commissioned));
        Ok(found)
    }

    /// Counts towards the commissioning, which a cell beyond the profile's limits does not get.
    fn count(&mut self, sensed: &SensedValues, is_good: bool) -> Option<NormalSenses> {
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

/// One for each sense: how often a task is beyond the largest of so many.
fn charts(settings: &HealthSettings) -> Result<Vec<(Sense, Cusum)>, StatsError> {
    let normal = wilson_upper(0, settings.commissioning_tasks.into(), NORMAL_ALPHA)?;
    let normal = normal.clamp(settings.rate_min, settings.failure_max);
    Sense::ALL
        .into_iter()
        .map(|sense| Ok((sense, Cusum::new(normal, normal + settings.shift, settings.cusum_limit)?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Profile, ProfileName};

    const STEADY: SensedValues = SensedValues { picture_jitter_m: Some(0.002), pictures_missing: Some(0.1) };

    fn settings() -> HealthSettings {
        Profile::builtin(ProfileName::Sim).unwrap().health
    }

    fn commissioned() -> CellSenses {
        let mut senses = CellSenses::new(settings(), None, false).unwrap();
        let found: Vec<SensesFinding> =
            (0..settings().commissioning_tasks).flat_map(|_| senses.observe(&STEADY).unwrap()).collect();
        let tasks = settings().commissioning_tasks;
        let normal = NormalSenses { tasks, picture_jitter_m: 0.002, pictures_missing: 0.1 };
        assert_eq!(found, [SensesFinding::Commissioned(normal)]);
        senses
    }

    fn until(senses: &mut CellSenses, task: &SensedValues, wanted: SensesFinding) -> Option<u32> {
        (1..=60).find(|_| senses.observe(task).unwrap().contains(&wanted))
    }

    #[test]
    fn each_sense_alarms_within_ten_tasks_before_and_after_commissioning_and_is_measured_to_be_over() {
        for (sense, after, before) in [
            (Sense::PictureJitter, 0.003, settings().jitter_max_m * 1.01),
            (Sense::PicturesMissing, 0.15, settings().missing_max * 1.01),
        ] {
            for (mut senses, value) in
                [(commissioned(), after), (CellSenses::new(settings(), None, false).unwrap(), before)]
            {
                let knocked = match sense {
                    Sense::PictureJitter => SensedValues { picture_jitter_m: Some(value), ..STEADY },
                    Sense::PicturesMissing => SensedValues { pictures_missing: Some(value), ..STEADY },
                };
                let alarm = until(&mut senses, &knocked, SensesFinding::Degraded(sense)).unwrap();
                assert!(alarm <= 10, "{sense}: {alarm}");
                assert_eq!(senses.normal.is_some(), value == after, "what is bad does not become normal");
                let over = until(&mut senses, &STEADY, SensesFinding::Over);
                assert_eq!(over, Some(settings().clear_tasks));
            }
        }
    }

    #[test]
    fn a_shaky_cell_is_not_commissioned_and_what_is_no_number_is_bad() {
        let mut senses = CellSenses::new(settings(), None, false).unwrap();
        let shaky = SensedValues { picture_jitter_m: Some(0.02), ..STEADY };
        for _ in 0..5 * settings().commissioning_tasks {
            senses.observe(&shaky).unwrap();
        }
        assert_eq!(senses.normal, None);
        let broken = SensedValues { picture_jitter_m: Some(f64::NAN), ..STEADY };
        let found = until(&mut commissioned(), &broken, SensesFinding::Degraded(Sense::PictureJitter));
        assert!(found.is_some_and(|tasks| tasks <= 10));
    }

    #[test]
    fn a_condition_outlives_a_restart_until_it_is_measured_to_be_over() {
        let normal = commissioned().normal;
        let mut restarted = CellSenses::new(settings(), normal, true).unwrap();
        assert_eq!(until(&mut restarted, &STEADY, SensesFinding::Over), Some(settings().clear_tasks));
    }
}
