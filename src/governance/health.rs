//! Absolute monitors: compare a family's active version, baselines too, with the commissioning of the cell.
//!
//! The drift monitor ([`crate::monitor`]) compares a new version with its own measurements. This one knows no
//! candidate: it counts what is normal over the first tasks of the cell, stores it, and charts against it from then on
//! with any active version. A violation is a separate finding. Pure: it returns what was found and what has ended.

use serde::{Deserialize, Serialize};

use crate::profile::HealthSettings;
use crate::stats::{Cusum, StatsError, wilson_upper};

crate::closed_set! {
    /// The charted rates of a family, each as the share of bad tasks.
    HealthRate, "rate of a family's health", {
        /// Tasks that were not done.
        Failure = "failure",
        /// Tasks that ran into their time limit.
        Timeout = "timeout",
        /// Tasks with a larger force than commissioning saw, by the profile's margin.
        Force = "force",
    }
}

/// The values of one live task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HealthValues {
    /// The task was done.
    pub success: bool,
    /// The task ran into its time limit.
    pub timeout: bool,
    /// A measured quantity passed its limit, or the guard denied a command.
    pub violation: bool,
    /// The largest force on wrist, pads or hand, N.
    pub peak_force_n: f64,
}

/// The normal rates at a family's commissioning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommissionedBaseline {
    /// Tasks it was counted over.
    pub tasks: u32,
    /// Of these, not done.
    pub failures: u32,
    /// Of these, ran into their time limit.
    pub timeouts: u32,
    /// The largest force in any of them, N.
    pub peak_force_n: f64,
}

/// A finding of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HealthFinding {
    /// The normal rates are known now and must be stored.
    Commissioned(CommissionedBaseline),
    /// A version violated a limit.
    Violated,
    /// Enough tasks in a row were without a violation: the condition is over.
    ViolationsOver,
    /// The rate of bad tasks is significantly above normal.
    Degraded(HealthRate),
    /// Enough tasks in a row were good in every respect: the condition is over.
    DegradedOver,
}

#[derive(Clone, Debug)]
struct HealthChart {
    rate: HealthRate,
    cusum: Cusum,
}

/// The health of one family.
#[derive(Clone, Debug)]
pub struct FamilyHealth {
    settings: HealthSettings,
    normal: Option<CommissionedBaseline>,
    /// Counted so far, while nothing is known.
    tally: CommissionedBaseline,
    charts: Vec<HealthChart>,
    /// Tasks in a row without a violation, and without anything bad.
    clean: u32,
    good: u32,
    violated: bool,
    degraded: bool,
}

impl FamilyHealth {
    /// The health of a family; `normal` is what its commissioning gave, absent before it.
    ///
    /// # Errors
    /// Settings that no chart can be tuned with.
    pub fn new(settings: HealthSettings, normal: Option<CommissionedBaseline>) -> Result<Self, StatsError> {
        let mut health = Self {
            settings,
            normal,
            tally: CommissionedBaseline::default(),
            charts: Vec::new(),
            clean: 0,
            good: 0,
            violated: false,
            degraded: false,
        };
        health.reset_for_version()?;
        Ok(health)
    }

    /// Another version is active from now on: earlier counts are dropped, and the normal rates stay.
    ///
    /// # Errors
    /// As [`FamilyHealth::new`].
    pub fn reset_for_version(&mut self) -> Result<(), StatsError> {
        self.tally = CommissionedBaseline::default();
        (self.clean, self.good) = (0, 0);
        (self.violated, self.degraded) = (false, false);
        self.set_charts()
    }

    /// A condition whose alarm predates a restart is present until it is measured to be over.
    pub const fn restore_alarms(&mut self, violated: bool, degraded: bool) {
        self.violated = violated;
        self.degraded = degraded;
    }

    /// The normal rates, once known.
    #[must_use]
    pub const fn normal(&self) -> Option<&CommissionedBaseline> {
        self.normal.as_ref()
    }

    fn set_charts(&mut self) -> Result<(), StatsError> {
        let limit = self.settings.failure_max;
        // What so few tasks cannot exclude counts as normal.
        let alpha = self.settings.normal_alpha;
        let share = |count: u32, tasks: u32| wilson_upper(count.into(), tasks.into(), alpha);
        let rates = match &self.normal {
            // Until the normal rates are known, the profile's maximum counts as normal, and no force does.
            None => vec![(HealthRate::Failure, limit), (HealthRate::Timeout, limit)],
            Some(normal) => vec![
                (HealthRate::Failure, share(normal.failures, normal.tasks)?),
                (HealthRate::Timeout, share(normal.timeouts, normal.tasks)?),
                (HealthRate::Force, share(0, normal.tasks)?),
            ],
        };
        self.charts = rates
            .into_iter()
            .map(|(rate, share)| {
                let normal = share.clamp(self.settings.rate_min, limit);
                let degraded = normal + self.settings.shift;
                Ok(HealthChart { rate, cusum: Cusum::new(normal, degraded, self.settings.cusum_limit)? })
            })
            .collect::<Result<_, StatsError>>()?;
        Ok(())
    }

    /// Takes in one live task of the family's active version.
    ///
    /// # Errors
    /// As [`FamilyHealth::new`].
    pub fn observe(&mut self, task: &HealthValues) -> Result<Vec<HealthFinding>, StatsError> {
        let mut found = Vec::new();
        let force_max =
            self.normal.map_or(f64::INFINITY, |normal| normal.peak_force_n * self.settings.force_margin);
        // A force that is no number is above every limit.
        let forced = !matches!(task.peak_force_n.partial_cmp(&force_max), Some(o) if o.is_le());
        let bad = |rate| match rate {
            HealthRate::Failure => !task.success,
            HealthRate::Timeout => task.timeout,
            HealthRate::Force => forced,
        };
        let all_good = HealthRate::ALL.into_iter().all(|rate| !bad(rate)) && !task.violation;
        self.clean = if task.violation { 0 } else { self.clean.saturating_add(1) };
        self.good = if all_good { self.good.saturating_add(1) } else { 0 };
        if task.violation {
            self.violated = true;
            found.push(HealthFinding::Violated);
        } else if self.violated && self.clean >= self.settings.clear_tasks {
            self.violated = false;
            found.push(HealthFinding::ViolationsOver);
        }
        let alarmed: Vec<HealthRate> = self
            .charts
            .iter_mut()
            .filter_map(|chart| chart.cusum.update(bad(chart.rate)).then_some(chart.rate))
            .collect();
        if let (Some(rate), false) = (alarmed.first(), self.degraded) {
            self.degraded = true;
            found.push(HealthFinding::Degraded(*rate));
        } else if self.degraded && self.good >= self.settings.clear_tasks {
            self.degraded = false;
            // A chart that alarmed stays so; later tasks are charted afresh.
            self.set_charts()?;
            found.push(HealthFinding::DegradedOver);
        }
        found.extend(self.count(task)?.map(HealthFinding::Commissioned));
        Ok(found)
    }

    /// Counts toward the commissioning. A family that fails more than the profile allows is not commissioned.
    fn count(&mut self, task: &HealthValues) -> Result<Option<CommissionedBaseline>, StatsError> {
        if self.normal.is_some() {
            return Ok(None);
        }
        let tally = &mut self.tally;
        tally.tasks += 1;
        tally.failures += u32::from(!task.success);
        tally.timeouts += u32::from(task.timeout);
        tally.peak_force_n = tally.peak_force_n.max(task.peak_force_n);
        if tally.tasks < self.settings.commissioning_tasks {
            return Ok(None);
        }
        let done = std::mem::take(tally);
        let allowed = f64::from(done.tasks) * self.settings.failure_max;
        if f64::from(done.failures) > allowed || !done.peak_force_n.is_finite() {
            return Ok(None);
        }
        self.normal = Some(done);
        if !self.degraded {
            self.set_charts()?;
        }
        Ok(Some(done))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Profile, ProfileName};

    const GOOD: HealthValues =
        HealthValues { success: true, timeout: false, violation: false, peak_force_n: 20.0 };
    const FAILED: HealthValues = HealthValues { success: false, ..GOOD };

    fn settings() -> HealthSettings {
        Profile::builtin(ProfileName::Sim).unwrap().health
    }

    /// A family whose commissioning had one failure in twenty.
    fn commissioned() -> FamilyHealth {
        let mut health = FamilyHealth::new(settings(), None).unwrap();
        let tasks = settings().commissioning_tasks;
        let found: Vec<HealthFinding> = (0..tasks)
            .flat_map(|task| health.observe(if task % 20 == 7 { &FAILED } else { &GOOD }).unwrap())
            .collect();
        let failures = (0..tasks).filter(|task| task % 20 == 7).count();
        let normal = CommissionedBaseline {
            tasks,
            failures: u32::try_from(failures).unwrap(),
            timeouts: 0,
            peak_force_n: 20.0,
        };
        assert_eq!(found, [HealthFinding::Commissioned(normal)]);
        health
    }

    fn until(health: &mut FamilyHealth, task: &HealthValues, wanted: HealthFinding) -> Option<usize> {
        (1..=40).find(|_| health.observe(task).unwrap().contains(&wanted))
    }

    #[test]
    fn total_failure_raises_an_alarm_within_ten_tasks() {
        let failing = HealthFinding::Degraded(HealthRate::Failure);
        let mut fresh = FamilyHealth::new(settings(), None).unwrap();
        let before = until(&mut fresh, &FAILED, failing).unwrap();
        let after = until(&mut commissioned(), &FAILED, failing).unwrap();
        println!("failing altogether: after {before} tasks without, {after} with a commissioning");
        assert!(before <= 10 && after <= 10, "{before}, {after}");
        let forced = HealthValues { peak_force_n: 26.0, ..GOOD };
        let force = until(&mut commissioned(), &forced, HealthFinding::Degraded(HealthRate::Force));
        assert!(force.is_some_and(|tasks| tasks <= 10), "{force:?}");
        let nan = HealthValues { peak_force_n: f64::NAN, ..GOOD };
        assert!(until(&mut commissioned(), &nan, HealthFinding::Degraded(HealthRate::Force)).is_some());
        let late = HealthValues { timeout: true, ..GOOD };
        assert!(until(&mut commissioned(), &late, HealthFinding::Degraded(HealthRate::Timeout)).is_some());
    }

    #[test]
    fn failing_cell_is_not_commissioned() {
        let mut health = FamilyHealth::new(settings(), None).unwrap();
        for _ in 0..5 * settings().commissioning_tasks {
            health.observe(&FAILED).unwrap();
        }
        assert_eq!(health.normal(), None);
    }

    #[test]
    fn violation_is_found_at_once_and_ends_only_by_measurement() {
        let mut health = commissioned();
        let violated = HealthValues { violation: true, ..GOOD };
        assert_eq!(health.observe(&violated).unwrap(), [HealthFinding::Violated]);
        assert_eq!(health.observe(&violated).unwrap(), [HealthFinding::Violated]);
        let over = until(&mut health, &GOOD, HealthFinding::ViolationsOver);
        assert_eq!(over, usize::try_from(settings().clear_tasks).ok());
        until(&mut health, &FAILED, HealthFinding::Degraded(HealthRate::Failure)).unwrap();
        let over = until(&mut health, &GOOD, HealthFinding::DegradedOver);
        assert_eq!(over, usize::try_from(settings().clear_tasks).ok());
        assert!(until(&mut health, &FAILED, HealthFinding::Degraded(HealthRate::Failure)).is_some());
        // A restart does not end the condition of an earlier alarm.
        let mut restarted = FamilyHealth::new(settings(), health.normal().copied()).unwrap();
        restarted.restore_alarms(false, true);
        assert!(restarted.observe(&GOOD).unwrap().is_empty());
        assert!(until(&mut restarted, &GOOD, HealthFinding::DegradedOver).is_some());
    }

    /// The bound of the charts holds: with what is normal at the unfavourable end of its bound, far fewer than one
    /// false alarm in 10,000 tasks.
    #[test]
    fn normal_tasks_seldom_raise_an_alarm() {
        let mut state = 11_u64;
        // SplitMix64 (Steele, Lea & Flood 2014), as a share.
        let mut unit = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            f64::from(u32::try_from((mixed ^ (mixed >> 31)) >> 32).unwrap()) / f64::from(u32::MAX)
        };
        let (mut alarms, runs, tasks) = (0, 50, 2_000);
        for _ in 0..runs {
            let mut health = commissioned();
            let rate = wilson_upper(
                health.normal().unwrap().failures.into(),
                health.normal().unwrap().tasks.into(),
                settings().normal_alpha,
            )
            .unwrap();
            for _ in 0..tasks {
                let task = if unit() < rate { FAILED } else { GOOD };
                let found = health.observe(&task).unwrap();
                alarms += found.iter().filter(|f| matches!(f, HealthFinding::Degraded(_))).count();
            }
        }
        println!("{alarms} false alarms in {} tasks at the bound of the normal rate", runs * tasks);
        assert!(alarms <= 10, "{alarms}");
    }
}
