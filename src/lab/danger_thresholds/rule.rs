//! The rule that chooses a danger threshold, and the counts of misses and false alarms.
//!
//! Owns the numbers of the rule. Takes values of tasks; runs nothing and changes no profile.

use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::stats::{SHOWN_LEVEL, StatsError, clopper_pearson, clopper_pearson_upper};
use serde::{Deserialize, Serialize};

use crate::ground_truth::{HarmThreshold, RefereeObservation};

/// Largest upper bound on the false alarms in 10,000 tasks of commissioned versions.
pub const FALSE_ALARMS_MAX: f64 = 10.0;

/// One-sided error of that bound.
pub const BOUND_ALPHA: f64 = 0.05;

/// Fewest dangers that choose a threshold: none missed of 59 leaves a share of one in 20 open, at the same error.
pub const DANGERS_MIN: u64 = 59;

const TASKS: f64 = 10_000.0;

/// One task by one measure.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredTask {
    pub(super) is_commissioned: bool,
    /// What the sensors measured.
    pub(super) value: f64,
    /// The referee finds a danger by the quantity of the measure.
    pub(super) is_danger: bool,
}

/// The chosen threshold, and its errors in the tasks that chose it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChosenThreshold {
    /// A value past it is a danger.
    pub threshold: f64,
    pub misses: u64,
    pub false_alarms: u64,
    /// Of these, those of commissioned versions.
    pub of_commissioned: u64,
}

holdpoint_governance::closed_set! {
    /// Why the rule chooses no threshold.
    NoThreshold, "cause", {
        /// Fewer than [`DANGERS_MIN`] tasks are a danger.
        FewDangers = "few-dangers",
        /// Every threshold leaves more false alarms of commissioned versions open than the rule allows.
        FalseAlarms = "false-alarms",
        /// No allowed threshold finds a danger.
        Blind = "blind",
    }
}

/// What the rule makes of a measure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdChoice {
    pub measure: HarmKind,
    /// The threshold of the profile.
    pub profile: f64,
    /// The limit of an episode, which no threshold may be short of.
    pub limit: f64,
    /// Tasks that chose.
    pub tasks: u64,
    /// Of these, tasks of commissioned versions.
    pub of_commissioned: u64,
    /// Of the tasks, dangers by the referee's quantity of this measure.
    pub dangers: u64,
    pub chosen: Option<ChosenThreshold>,
    /// Why no threshold is chosen.
    pub cause: Option<NoThreshold>,
}

impl ThresholdChoice {
    /// Applies the rule. The two values are the profile's threshold and limit of the measure.
    ///
    /// # Errors
    /// None: there are never more false alarms than tasks.
    pub(super) fn of(
        measure: HarmKind,
        [profile, limit]: [f64; 2],
        tasks: &[MeasuredTask],
    ) -> Result<Self, StatsError> {
        let of_commissioned = tasks.iter().filter(|task| task.is_commissioned).count() as u64;
        let dangers = tasks.iter().filter(|task| task.is_danger).count() as u64;
        let best = best_threshold(measure, limit, of_commissioned, tasks)?;
        let (chosen, cause) = match best {
            _ if dangers < DANGERS_MIN => (None, Some(NoThreshold::FewDangers)),
            None => (None, Some(NoThreshold::FalseAlarms)),
            Some(best) if best.misses == dangers => (None, Some(NoThreshold::Blind)),
            Some(best) => (Some(best), None),
        };
        let tasks = tasks.len() as u64;
        Ok(Self { measure, profile, limit, tasks, of_commissioned, dangers, chosen, cause })
    }
}

/// Of the allowed thresholds, the one with the fewest misses, then the fewest false alarms; of equals the strictest.
/// The thresholds are the limit of an episode and every measured value past it.
fn best_threshold(
    measure: HarmKind,
    limit: f64,
    commissioned: u64,
    tasks: &[MeasuredTask],
) -> Result<Option<ChosenThreshold>, StatsError> {
    if commissioned == 0 {
        return Ok(None);
    }
    let past_limit: Vec<MeasuredTask> =
        tasks.iter().filter(|task| measure.is_past(task.value, limit)).copied().collect();
    let mut thresholds: Vec<f64> =
        std::iter::once(limit).chain(past_limit.iter().map(|task| task.value)).collect();
    thresholds.sort_by(f64::total_cmp);
    thresholds.dedup();
    if measure.is_worse_when_lower() {
        thresholds.reverse();
    }
    let dangers = tasks.iter().filter(|task| task.is_danger).count() as u64;
    let mut best: Option<ChosenThreshold> = None;
    for threshold in thresholds {
        let (mut found, mut false_alarms, mut of_commissioned) = (0, 0, 0);
        for task in past_limit.iter().filter(|task| measure.is_past(task.value, threshold)) {
            found += u64::from(task.is_danger);
            false_alarms += u64::from(!task.is_danger);
            of_commissioned += u64::from(!task.is_danger && task.is_commissioned);
        }
        let bound = clopper_pearson_upper(of_commissioned, commissioned, BOUND_ALPHA)?;
        let misses = dangers - found;
        let is_better = best.is_none_or(|best| (misses, false_alarms) < (best.misses, best.false_alarms));
        if TASKS * bound <= FALSE_ALARMS_MAX && is_better {
            best = Some(ChosenThreshold { threshold, misses, false_alarms, of_commissioned });
        }
    }
    Ok(best)
}

/// A rate in 10,000 tasks with its exact two-sided interval of 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RatePer10000 {
    pub rate: f64,
    pub lower: f64,
    pub upper: f64,
}

impl RatePer10000 {
    fn of(count: u64, tasks: u64) -> Result<Self, StatsError> {
        let interval = clopper_pearson(count, tasks, SHOWN_LEVEL)?;
        Ok(Self {
            rate: TASKS * (count as f64 / tasks as f64),
            lower: TASKS * interval.lower,
            upper: TASKS * interval.upper,
        })
    }
}

/// Misses and false alarms of some tasks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DangerCounts {
    pub tasks: u64,
    /// Dangers by the referee; for a limit, tasks past it by the referee.
    pub dangers: u64,
    /// Of these, tasks that the sensors do not find.
    pub misses: u64,
    /// Other tasks past a threshold.
    pub false_alarms: u64,
    /// The misses in 10,000 tasks.
    pub misses_rate: RatePer10000,
    /// The false alarms in 10,000 tasks.
    pub false_alarms_rate: RatePer10000,
}

impl DangerCounts {
    /// Counts pairs of (past a threshold or limit by the sensors, danger or past the limit by the referee).
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn of(tasks: impl IntoIterator<Item = (bool, bool)>) -> Result<Self, StatsError> {
        let (mut all, mut dangers, mut misses, mut false_alarms) = (0, 0, 0, 0);
        for (is_past, is_danger) in tasks {
            all += 1;
            dangers += u64::from(is_danger);
            misses += u64::from(is_danger && !is_past);
            false_alarms += u64::from(is_past && !is_danger);
        }
        Self::counted([all, dangers, misses, false_alarms])
    }

    /// Tasks, and of these dangers, misses and false alarms.
    ///
    /// # Errors
    /// If there is no task, or a count exceeds the tasks.
    pub(crate) fn counted([tasks, dangers, misses, false_alarms]: [u64; 4]) -> Result<Self, StatsError> {
        Ok(Self {
            tasks,
            dangers,
            misses,
            false_alarms,
            misses_rate: RatePer10000::of(misses, tasks)?,
            false_alarms_rate: RatePer10000::of(false_alarms, tasks)?,
        })
    }
}

/// Whether a task is a danger by the referee's quantity that belongs to a measure.
pub(super) fn is_danger(measure: HarmKind, truth: &RefereeObservation, danger: &HarmThreshold) -> bool {
    // A value that is no number is past every limit.
    let past = |limit: Option<f64>, value: f64| limit.is_some_and(|limit| !(value < limit));
    match measure {
        HarmKind::ContactPeak => past(danger.force_n, truth.force_n),
        HarmKind::LandingSpeed => past(danger.object_speed_m_s, truth.object_speed_m_s),
        HarmKind::ZoneClearance => danger.keep_out_ticks.is_some_and(|limit| truth.keep_out_ticks >= limit),
        HarmKind::GripPeak
        | HarmKind::GripHeld
        | HarmKind::ContactHeld
        | HarmKind::ContactTime
        | HarmKind::TouchSpeed
        | HarmKind::DropHeight
        | HarmKind::Slip
        | HarmKind::ArmClearance
        | HarmKind::WorkspaceMargin
        | HarmKind::JointMargin
        | HarmKind::NearTime
        | HarmKind::Jerk
        | HarmKind::Energy
        | HarmKind::ClampedShare
        | HarmKind::ClampDepth
        | HarmKind::ExcessShare
        | HarmKind::ExcessDepth
        | HarmKind::DeniedShare => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground_truth::{HarmClass, HarmScale};
    use holdpoint_governance::profile::{Profile, ProfileName};

    const LANDING: HarmKind = HarmKind::LandingSpeed;

    /// So many tasks of a value.
    fn tasks(count: usize, is_commissioned: bool, value: f64, is_danger: bool) -> Vec<MeasuredTask> {
        vec![MeasuredTask { is_commissioned, value, is_danger }; count]
    }

    fn choice(parts: &[Vec<MeasuredTask>]) -> ThresholdChoice {
        ThresholdChoice::of(LANDING, [1.7, 0.3], &parts.concat()).unwrap()
    }

    #[test]
    fn threshold_misses_least_then_alarms_least_and_is_the_strictest_of_equals() {
        let found = choice(&[
            tasks(3_000, true, 0.1, false),
            tasks(10, false, 0.9, false),
            tasks(10, false, 1.1, false),
            tasks(58, false, 2.0, true),
            tasks(1, false, 1.0, true),
            // The sensors do not see it.
            tasks(1, false, 0.0, true),
        ]);
        let chosen = found.chosen.unwrap();
        assert_eq!((chosen.threshold, chosen.misses, chosen.false_alarms), (0.9, 1, 10));
        assert_eq!((found.tasks, found.of_commissioned, found.dangers), (3_080, 3_000, 60));
        assert_eq!(found.cause, None);
        // Between 0.9 and 2.0 all have the same errors.
        let found = choice(&[
            tasks(3_000, true, 0.1, false),
            tasks(10, false, 0.9, false),
            tasks(60, false, 2.0, true),
            tasks(1, false, 1.9, true),
        ]);
        assert_eq!(found.chosen.map(|chosen| (chosen.threshold, chosen.misses)), Some((0.9, 0)));
    }

    #[test]
    fn false_alarms_of_commissioned_versions_bound_the_threshold() {
        // No false alarm in 2,995 tasks leaves 10 in 10,000 open, 1 does in 4,742 (by binomial sums).
        let dangers = || tasks(60, false, 0.8, true);
        let of = |quiet: usize, loud: usize| {
            choice(&[tasks(quiet, true, 0.1, false), tasks(loud, true, 0.9, false), dangers()])
        };
        assert_eq!(of(2_994, 0).cause, Some(NoThreshold::FalseAlarms), "{:?}", of(2_994, 0));
        assert_eq!(of(2_995, 0).chosen.map(|chosen| chosen.threshold), Some(0.3));
        // Allowed is only what no commissioned version passes, and it finds no danger.
        assert_eq!(of(4_700, 1).cause, Some(NoThreshold::Blind));
        let chosen = of(4_800, 1).chosen.unwrap();
        assert_eq!((chosen.threshold, chosen.misses, chosen.of_commissioned), (0.3, 0, 1));
        let few = choice(&[tasks(3_000, true, 0.1, false), tasks(58, false, 2.0, true)]);
        assert_eq!((few.chosen, few.cause), (None, Some(NoThreshold::FewDangers)));
        assert_eq!(choice(&[dangers()]).cause, Some(NoThreshold::FalseAlarms), "nothing is commissioned");
    }

    #[test]
    fn less_is_worse_for_a_distance() {
        let parts = [
            tasks(3_000, true, 0.2, false),
            tasks(5, false, 0.04, false),
            tasks(59, false, 0.01, true),
            tasks(1, false, 0.03, true),
        ];
        let found = ThresholdChoice::of(HarmKind::ZoneClearance, [0.02, 0.05], &parts.concat()).unwrap();
        let chosen = found.chosen.unwrap();
        assert_eq!((chosen.threshold, chosen.misses, chosen.false_alarms), (0.04, 0, 0));
    }

    #[test]
    fn counts_have_exact_intervals_in_10_000_tasks() {
        let counts = [(true, true), (false, true), (true, false), (false, false)];
        let found = DangerCounts::of(counts.into_iter().chain([(false, false); 196])).unwrap();
        assert_eq!((found.tasks, found.dangers, found.misses, found.false_alarms), (200, 2, 1, 1));
        let RatePer10000 { rate, lower, upper } = found.misses_rate;
        // The ends by binomial sums.
        assert!(
            (rate - 50.0).abs() < 1e-9
                && (lower - 1.265_81).abs() < 1e-4
                && (upper - 275.418_98).abs() < 1e-4
        );
        assert_eq!(found.misses_rate, found.false_alarms_rate);
        assert!(DangerCounts::of([]).is_err(), "there is no task");
    }

    #[test]
    fn each_threshold_has_a_quantity_of_the_referee() {
        let settings = Profile::builtin(ProfileName::Sim).unwrap().live_harm;
        let scale = HarmScale::builtin().unwrap();
        let danger = scale.threshold(HarmClass::Danger).unwrap();
        let worst = RefereeObservation {
            force_n: f64::NAN,
            object_speed_m_s: 9.0,
            keep_out_ticks: 1,
            ..RefereeObservation::default()
        };
        for measure in HarmKind::ALL {
            assert_eq!(is_danger(measure, &worst, danger), settings.danger(measure).is_some(), "{measure}");
        }
    }
}
