//! What becomes of the versions of each trigger, act and profile: where they end, and after how many live tasks.
//!
//! Counts finished runs. The bounds are exact: those of a share are Clopper and Pearson's, those of a quantile are the
//! times at the ranks that the same bounds allow. A version at the end of its tasks counts as later than any rollback.
//! Versions that harm in the same share of their tasks are counted together, too.

use std::collections::BTreeMap;

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{
    Interval, StatsError, clopper_pearson, clopper_pearson_lower, clopper_pearson_upper,
};
use serde::{Deserialize, Serialize};

use super::controller::HarmAct;
use super::live_run::ThrowerRun;
use super::package::ThrowerKind;
use crate::danger_thresholds::rule::DangerCounts;

/// Two-sided level of all bounds.
const LEVEL: f64 = 0.95;

/// Live tasks until the rollback of a share of the versions. An absent number is later than the end of the runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskQuantile {
    /// By nearest rank.
    pub tasks: Option<u64>,
    /// 0 if the versions are too few for a lower bound.
    pub lower: Option<u64>,
    pub upper: Option<u64>,
}

impl TaskQuantile {
    /// Of the times in ascending order, the absent ones last; `None` without any.
    fn of(sorted: &[Option<u64>], percent: u8) -> Result<Option<Self>, StatsError> {
        let n = sorted.len() as u64;
        if n == 0 {
            return Ok(None);
        }
        let at_rank = |rank: usize| sorted.get(rank.checked_sub(1)?).copied().flatten();
        let (share, tail) = (f64::from(percent) / 100.0, (1.0 - LEVEL) / 2.0);
        let (mut lower, mut upper) = (0, 1);
        for earlier in 0..n {
            if clopper_pearson_upper(earlier, n, tail)? <= share {
                lower += 1;
            }
            if clopper_pearson_lower(earlier + 1, n, tail)? < share {
                upper += 1;
            }
        }
        Ok(Some(Self {
            tasks: at_rank((sorted.len() * usize::from(percent)).div_ceil(100)),
            lower: if lower == 0 { Some(0) } else { at_rank(lower) },
            upper: at_rank(upper),
        }))
    }
}

/// The versions of one trigger and act under one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThrowerSummary {
    pub trigger: ThrowerKind,
    pub act: HarmAct,
    pub profile: ProfileName,
    pub runs: u64,
    pub activated: u64,
    /// Bounds of the share that becomes active.
    pub activated_share: Interval,
    /// Of the activated ones, those without a rollback when their tasks ended.
    pub not_rolled_back: u64,
    /// Live tasks until the rollback of half of the activated ones; absent if there are none.
    pub median: Option<TaskQuantile>,
    /// Of nine tenths of them.
    pub p90: Option<TaskQuantile>,
    /// Tasks of all families in the live cell.
    pub cell_tasks: u64,
    /// Of these, with a start that the evidence does not cover.
    pub uncovered: u64,
    /// How many ended how, with the first reason code.
    pub ends: BTreeMap<String, u64>,
}

impl ThrowerSummary {
    fn of(first: &ThrowerRun, runs: &[ThrowerRun]) -> Result<Self, StatsError> {
        let times = activated_times(runs);
        let mut ends: BTreeMap<String, u64> = BTreeMap::new();
        for run in runs {
            let code = run.codes.first().map_or("no code", |code: &ReasonCode| code.as_str());
            *ends.entry(format!("{} ({code})", run.end())).or_default() += 1;
        }
        let (all, activated) = (runs.len() as u64, times.len() as u64);
        Ok(Self {
            trigger: first.trigger,
            act: first.act,
            profile: first.profile,
            runs: all,
            activated,
            activated_share: clopper_pearson(activated, all, LEVEL)?,
            not_rolled_back: without_rollback(&times),
            median: TaskQuantile::of(&times, 50)?,
            p90: TaskQuantile::of(&times, 90)?,
            cell_tasks: runs.iter().map(|run| run.cell_tasks).sum(),
            uncovered: runs.iter().map(|run| run.uncovered).sum(),
            ends,
        })
    }
}

/// One summary for each trigger, act and profile. The runs of each stand together.
///
/// # Errors
/// None: the counts of runs are valid.
pub(super) fn summarize(runs: &[ThrowerRun]) -> Result<Vec<ThrowerSummary>, StatsError> {
    let of = |run: &ThrowerRun| (run.trigger, run.act, run.profile);
    let groups = runs.chunk_by(|one, next| of(one) == of(next));
    groups.filter_map(|runs| Some(ThrowerSummary::of(runs.first()?, runs))).collect()
}

/// The times of the activated runs in ascending order, those without a rollback last.
fn activated_times<'a>(runs: impl IntoIterator<Item = &'a ThrowerRun>) -> Vec<Option<u64>> {
    let activated = runs.into_iter().filter(|run| run.activated);
    let mut times: Vec<Option<u64>> = activated.map(ThrowerRun::tasks_until_rollback).collect();
    times.sort_by_key(|time| time.unwrap_or(u64::MAX));
    times
}

fn without_rollback(times: &[Option<u64>]) -> u64 {
    times.iter().filter(|time| time.is_none()).count() as u64
}

/// The versions of one act that harm in the same share of their tasks under one profile, whatever their trigger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HarmRateSummary {
    pub act: HarmAct,
    pub one_in: u64,
    pub profile: ProfileName,
    pub runs: u64,
    pub activated: u64,
    /// Of the activated ones, those without a rollback when their tasks ended.
    pub not_rolled_back: u64,
    /// Live tasks until the rollback of half of the activated ones; absent if there are none.
    pub median: Option<TaskQuantile>,
    /// Of nine tenths of them.
    pub p90: Option<TaskQuantile>,
}

impl HarmRateSummary {
    fn of(
        (act, one_in, profile): (HarmAct, u64, ProfileName),
        runs: &[&ThrowerRun],
    ) -> Result<Self, StatsError> {
        let times = activated_times(runs.iter().copied());
        Ok(Self {
            act,
            one_in,
            profile,
            runs: runs.len() as u64,
            activated: times.len() as u64,
            not_rolled_back: without_rollback(&times),
            median: TaskQuantile::of(&times, 50)?,
            p90: TaskQuantile::of(&times, 90)?,
        })
    }
}

/// One summary for each act, share of harmful tasks and profile.
///
/// # Errors
/// None: the counts of runs are valid.
pub(super) fn summarize_rates(runs: &[ThrowerRun]) -> Result<Vec<HarmRateSummary>, StatsError> {
    let mut groups: BTreeMap<(HarmAct, u64, ProfileName), Vec<&ThrowerRun>> = BTreeMap::new();
    for run in runs {
        if let Some(one_in) = run.trigger.one_in() {
            groups.entry((run.act, one_in, run.profile)).or_default().push(run);
        }
    }
    groups.into_iter().map(|(key, runs)| HarmRateSummary::of(key, &runs)).collect()
}

/// The objects that flew in the live tasks of all versions, and what the engine made of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightCounts {
    /// Tasks with an object past the referee's limit that was not thrown.
    pub dropped: u64,
    /// Throws by the referee against dangers by the landing speed.
    pub throws: DangerCounts,
}

/// Of the runs that compared both; `None` without a live task of these.
///
/// # Errors
/// None: a task is counted once.
pub(super) fn count_flights(runs: &[ThrowerRun]) -> Result<Option<FlightCounts>, StatsError> {
    let (mut dropped, mut counts) = (0, [0; 4]);
    for run in runs {
        let Some(flights) = run.flights else { continue };
        dropped += flights.dropped;
        for (sum, count) in
            counts.iter_mut().zip([run.live_tasks, run.thrown, flights.missed, flights.false_alarms])
        {
            *sum += count;
        }
    }
    if counts[0] == 0 {
        return Ok(None);
    }
    Ok(Some(FlightCounts { dropped, throws: DangerCounts::counted(counts)? }))
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::lifecycle::State;
    use holdpoint_governance::monitor::SafetyEvent;
    use holdpoint_governance::outcome::StageOutcome;
    use holdpoint_governance::rollback::TriggerKind;
    use holdpoint_protocol::scenario_state::Decider;

    use super::*;
    use crate::pipeline_experiments::candidate_run::DecisionOutcome;
    use crate::throwers::FlightCheck;

    fn quantile(times: &[Option<u64>], percent: u8) -> TaskQuantile {
        TaskQuantile::of(times, percent).unwrap().unwrap()
    }

    #[test]
    fn quantiles_have_exact_ranks() {
        // The ranks of binomial tables: 2 and 9 of 10 for the median, 6 and 15 of 20.
        let ten: Vec<Option<u64>> = (1..=10).map(Some).collect();
        let found = quantile(&ten, 50);
        assert_eq!(found, TaskQuantile { tasks: Some(5), lower: Some(2), upper: Some(9) });
        // 7 of 10 for nine tenths; ten times give no upper bound.
        let found = quantile(&ten, 90);
        assert_eq!(found, TaskQuantile { tasks: Some(9), lower: Some(7), upper: None });
        let twenty: Vec<Option<u64>> = (1..=20).map(Some).collect();
        let found = quantile(&twenty, 50);
        assert_eq!(found, TaskQuantile { tasks: Some(10), lower: Some(6), upper: Some(15) });
        assert_eq!(TaskQuantile::of(&[], 50).unwrap(), None);
        let found = quantile(&[Some(3)], 50);
        assert_eq!(found, TaskQuantile { tasks: Some(3), lower: Some(0), upper: None });
    }

    #[test]
    fn version_that_is_not_rolled_back_is_later_than_all_others() {
        let times: Vec<Option<u64>> = (1..=4).map(Some).chain([None; 6]).collect();
        let found = quantile(&times, 50);
        assert_eq!(found, TaskQuantile { tasks: None, lower: Some(2), upper: None });
    }

    fn run(profile: ProfileName, live_tasks: u64, rollback: Option<TriggerKind>) -> ThrowerRun {
        ThrowerRun {
            trigger: ThrowerKind::Active20,
            act: HarmAct::Press,
            profile,
            run: 0,
            version: "grasp@1.1.0".parse().unwrap(),
            state: if rollback.is_some() { State::RolledBack } else { State::Active },
            activated: true,
            confirmed: true,
            decider: None,
            decision: None,
            codes: Vec::new(),
            rollback,
            safety_event: None,
            live_tasks,
            thrown: 0,
            first_thrown: None,
            flights: None,
            unsafe_tasks: 0,
            past_harm: 0,
            cell_tasks: 100,
            uncovered: 1,
        }
    }

    #[test]
    fn versions_of_one_rate_are_counted_together() {
        let rollback = Some(TriggerKind::SafetyEvent);
        let every = ThrowerRun { trigger: ThrowerKind::Every20, ..run(ProfileName::Sim, 9, rollback) };
        let rejected = ThrowerRun { activated: false, ..run(ProfileName::Sim, 0, None) };
        let place = ThrowerRun { trigger: ThrowerKind::PlaceInside, ..run(ProfileName::Sim, 1, rollback) };
        let seldom = ThrowerRun { trigger: ThrowerKind::Active400, ..run(ProfileName::Sim, 400, None) };
        let runs = [every, run(ProfileName::Sim, 30, rollback), rejected, place, seldom];
        let found = summarize_rates(&runs).unwrap();
        let [often, seldom] = &found[..] else { panic!("{found:?}") };
        assert_eq!((often.one_in, often.act, often.profile), (20, HarmAct::Press, ProfileName::Sim));
        assert_eq!((often.runs, often.activated, often.not_rolled_back), (3, 2, 0));
        assert_eq!((often.median.unwrap().tasks, often.p90.unwrap().tasks), (Some(9), Some(30)));
        assert_eq!((seldom.one_in, seldom.activated, seldom.not_rolled_back), (400, 1, 1));
    }

    #[test]
    fn flights_are_counted_where_both_were_compared() {
        let check = FlightCheck { dropped: 2, missed: 1, false_alarms: 1 };
        let compared = ThrowerRun { thrown: 3, flights: Some(check), ..run(ProfileName::Sim, 1_000, None) };
        let older = ThrowerRun { thrown: 5, ..run(ProfileName::Sim, 400, None) };
        let found = count_flights(&[compared, older.clone()]).unwrap().unwrap();
        let throws = found.throws;
        assert_eq!((found.dropped, throws.tasks, throws.dangers), (2, 1_000, 3));
        assert_eq!((throws.misses, throws.false_alarms), (1, 1));
        assert_eq!(throws.misses_rate.rate, 10.0);
        assert_eq!(count_flights(&[older]).unwrap(), None);
    }

    #[test]
    fn runs_of_one_profile_are_counted_together() {
        let rejected = ThrowerRun {
            state: State::Rejected,
            activated: false,
            decider: Some(Decider::Sandbox),
            decision: Some(DecisionOutcome::Stage(StageOutcome::Reject)),
            codes: vec![ReasonCode::BehaviorEstablishedWorse],
            ..run(ProfileName::Sim, 0, None)
        };
        let danger = ThrowerRun {
            safety_event: Some(SafetyEvent::Danger),
            codes: vec![ReasonCode::MonitorSafetyTrip],
            ..run(ProfileName::Sim, 31, Some(TriggerKind::SafetyEvent))
        };
        let runs = [rejected, danger, run(ProfileName::Sim, 400, None), run(ProfileName::Real, 400, None)];
        let summaries = summarize(&runs).unwrap();
        let [sim, real] = &summaries[..] else { panic!("{summaries:?}") };
        assert_eq!((sim.runs, sim.activated, sim.not_rolled_back), (3, 2, 1));
        assert_eq!((sim.cell_tasks, sim.uncovered), (300, 3));
        assert_eq!(sim.median.unwrap().tasks, Some(31));
        assert_eq!(sim.p90.unwrap().tasks, None);
        let ends: Vec<&str> = sim.ends.keys().map(String::as_str).collect();
        assert_eq!(
            ends,
            [
                "active (no code)",
                "rolled-back for safety-event (danger) (monitor-safety-trip)",
                "sandbox: reject (behavior-established-worse)",
            ]
        );
        assert_eq!((real.runs, real.activated, real.not_rolled_back), (1, 1, 1));
        // .025 of one run.
        assert!((real.activated_share.lower - 0.025).abs() < 1e-9 && real.activated_share.upper == 1.0);
    }
}
