//! The rates that roll a version back, compared with the rollback target in forks of the same live tasks.
//!
//! A version that fails in live tasks in which the rollback target fails as well shows no difference from it: the cell has
//! changed, or the tasks were hard. So the target runs a fork of each kept task, and for each rate that decided only the
//! tasks count in which one of the two is bad. If both are equal, either is the bad one with the same probability: an exact
//! one-sided sign test, corrected after Holm for rates that differ in other tasks. Source: Dixon & Mood (1946); the paired
//! comparison of the paper's section 6.6, after activation.

use serde::{Deserialize, Serialize};

use super::{Monitor, Rate};
use crate::decision::Reason;
use crate::evidence::EpisodeValues;
use crate::finding::Finding;
use crate::stats::{holm, sign_test};

/// A live task of a version, and the rollback target's in a fork from its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForkedPair {
    /// Seed of the task.
    pub seed: u64,
    /// Values of the version's live task.
    pub version: EpisodeValues,
    /// Values of the rollback target's task in the fork.
    pub target: EpisodeValues,
    /// Both ran under a tighter envelope than they were measured under.
    pub tightened: bool,
}

/// Whether either version was bad in one task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ComparedTask {
    /// Seed of the task.
    pub seed: u64,
    /// The version that was rolled back was bad.
    pub version: bool,
    /// The rollback target was bad.
    pub target: bool,
}

/// One rate that decided, in the kept tasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ComparedRate {
    /// The rate.
    pub rate: Rate,
    /// The tasks in which it was judged, the oldest first.
    pub tasks: Vec<ComparedTask>,
    /// Tasks in which the version alone was bad.
    pub version_alone: u64,
    /// Tasks in which the rollback target alone was bad.
    pub target_alone: u64,
    /// One-sided p-value of the sign test, corrected for the rates that differ in other tasks.
    pub p: f64,
}

/// In how many tasks either version was bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RateTally {
    /// The rate.
    pub rate: Rate,
    /// The compared tasks.
    pub tasks: u64,
    /// Tasks in which the version that was rolled back was bad.
    pub version: u64,
    /// Tasks in which the rollback target was bad.
    pub target: u64,
}

impl RateTally {
    /// Whether the rollback target is bad in at least half as many tasks as the version: it may have the same cause.
    #[must_use]
    pub const fn is_shared(&self) -> bool {
        self.target > 0 && self.target.saturating_mul(2) >= self.version
    }
}

impl ComparedRate {
    /// In how many tasks either version was bad.
    #[must_use]
    pub fn tally(&self) -> RateTally {
        let count =
            |is_bad: fn(&ComparedTask) -> bool| self.tasks.iter().filter(|task| is_bad(task)).count() as u64;
        RateTally {
            rate: self.rate,
            tasks: count(|_| true),
            version: count(|task| task.version),
            target: count(|task| task.target),
        }
    }

    /// The tasks in which one of the two was bad.
    fn differing(&self) -> Vec<ComparedTask> {
        self.tasks.iter().filter(|task| task.version != task.target).copied().collect()
    }
}

/// Corrects the p-values for several tests. Rates that differ in the same tasks are one test: in each task both change sides
/// together. A rate that differs in no task is no test.
fn correct(rates: &mut [ComparedRate]) {
    let mut tests: Vec<(Vec<ComparedTask>, f64)> = Vec::new();
    for compared in rates.iter() {
        let differing = compared.differing();
        if !differing.is_empty() && tests.iter().all(|(known, _)| *known != differing) {
            tests.push((differing, compared.p));
        }
    }
    let p_values: Vec<f64> = tests.iter().map(|(_, p)| *p).collect();
    // Without a test there is nothing to correct.
    let corrected = holm(&p_values).unwrap_or_default();
    for compared in rates {
        let differing = compared.differing();
        let test = tests.iter().position(|(known, _)| *known == differing);
        if let Some(p) = test.and_then(|place| corrected.get(place)) {
            compared.p = *p;
        }
    }
}

/// The rates that rolled a version back, in tasks that the rollback target ran as well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RateComparison {
    /// Error rate of the test over all rates, `monitor.paired_alpha` of the profile.
    pub alpha: f64,
    /// The rates that decided.
    pub rates: Vec<ComparedRate>,
}

impl RateComparison {
    /// Whether the version is worse than the rollback target in at least one rate. Only then it is rolled back for good.
    #[must_use]
    pub fn differs(&self) -> bool {
        self.rates.iter().any(|compared| compared.p <= self.alpha)
    }

    /// In how many tasks either version was bad, rate by rate.
    #[must_use]
    pub fn tallies(&self) -> Vec<RateTally> {
        self.rates.iter().map(ComparedRate::tally).collect()
    }
}

impl Monitor {
    /// Compares a version with its rollback target in these tasks, by the monitor's own limits. A rate that follows from a
    /// tighter envelope is judged in the other tasks alone.
    #[must_use]
    pub fn rate_comparison(&self, rates: &[Rate], pairs: &[ForkedPair], alpha: f64) -> RateComparison {
        let is_bad =
            |rate: Rate, values: &EpisodeValues| rate.is_bad(values, self.slow_over_s, self.limits.as_ref());
        let compared = rates.iter().map(|rate| {
            let judged = pairs.iter().filter(|pair| !(pair.tightened && rate.follows_from_restriction()));
            let tasks: Vec<ComparedTask> = judged
                .map(|pair| ComparedTask {
                    seed: pair.seed,
                    version: is_bad(*rate, &pair.version),
                    target: is_bad(*rate, &pair.target),
                })
                .collect();
            let version_alone = tasks.iter().filter(|task| task.version && !task.target).count() as u64;
            let target_alone = tasks.iter().filter(|task| task.target && !task.version).count() as u64;
            let p = sign_test(version_alone, target_alone);
            ComparedRate { rate: *rate, tasks, version_alone, target_alone, p }
        });
        let mut rates: Vec<ComparedRate> = compared.collect();
        correct(&mut rates);
        RateComparison { alpha, rates }
    }
}

/// The rates that a rollback for these reasons rests on: those that tripped, or else those that warned. Interventions are
/// not among them: they are the conduct of people, and no fork has any.
#[must_use]
pub fn deciding_rates(reasons: &[Reason]) -> Vec<Rate> {
    let (mut tripped, mut warned) = (Vec::new(), Vec::new());
    for reason in reasons {
        match reason.finding {
            Some(Finding::RateWorse { rate }) => tripped.push(rate),
            Some(Finding::RateDrifts { rate }) => warned.push(rate),
            _ => {}
        }
    }
    tripped.retain(|rate| *rate != Rate::Intervention);
    warned.retain(|rate| *rate != Rate::Intervention);
    if tripped.is_empty() { warned } else { tripped }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decision::Dimension;
    use crate::evidence::Signature;
    use crate::profile::{Profile, ProfileName};

    const ALPHA: f64 = 0.05;
    const DONE: EpisodeValues = EpisodeValues::CLEAN;
    const FAILED: EpisodeValues = EpisodeValues { success: false, ..DONE };

    fn compared(rates: &[Rate], pairs: &[ForkedPair]) -> RateComparison {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let expected = Signature { time_p95_s: 8.0, ..crate::behavior::signature([DONE; 4].iter()).unwrap() };
        Monitor::new(&profile, &expected, 0).unwrap().rate_comparison(rates, pairs, ALPHA)
    }

    /// Tasks with these values of the version and of the rollback target.
    fn pairs(of: &[(EpisodeValues, EpisodeValues, usize)]) -> Vec<ForkedPair> {
        let each = of.iter().flat_map(|(version, target, count)| vec![(*version, *target); *count]);
        let each = (0..).zip(each);
        each.map(|(seed, (version, target))| ForkedPair { seed, version, target, tightened: false }).collect()
    }

    #[test]
    fn only_tasks_in_which_one_version_is_bad_count() {
        for (version_alone, target_alone, differs) in [
            (0, 0, false),
            (4, 0, false),
            (5, 0, true),
            (7, 1, true),
            (6, 1, false),
            (9, 9, false),
            (0, 9, false),
        ] {
            let tasks = pairs(&[
                (FAILED, DONE, version_alone),
                (DONE, FAILED, target_alone),
                (FAILED, FAILED, 10),
                (DONE, DONE, 10),
            ]);
            let found = compared(&[Rate::Failure], &tasks);
            let rate = &found.rates[0];
            assert_eq!((rate.version_alone, rate.target_alone), (version_alone as u64, target_alone as u64));
            assert_eq!(found.differs(), differs, "{version_alone} {target_alone}: {}", rate.p);
            let tally = rate.tally();
            assert_eq!(tally.tasks, tasks.len() as u64);
            assert_eq!((tally.version, tally.target), (rate.version_alone + 10, rate.target_alone + 10));
            let stored = serde_json::to_string(&found).unwrap();
            assert_eq!(serde_json::from_str::<RateComparison>(&stored).unwrap(), found);
        }
    }

    #[test]
    fn several_rates_need_more_tasks_and_one_that_differs_is_enough() {
        let retried = EpisodeValues { retries: 1, ..DONE };
        let rates = [Rate::Failure, Rate::Retry];
        for (failed, differs) in [(5, false), (6, true)] {
            let tasks = pairs(&[(FAILED, DONE, failed), (DONE, retried, 1), (retried, retried, 20)]);
            let found = compared(&rates, &tasks);
            assert_eq!(found.differs(), differs, "{failed}");
            assert_eq!(found.rates[1].p, 1.0, "the target alone retries in a task");
        }
    }

    /// Each counted as a test of its own: a version that failed in every way at once was never ended for good.
    #[test]
    fn rates_that_differ_in_the_same_tasks_are_one_test() {
        let retried = EpisodeValues { retries: 1, ..DONE };
        let lost = EpisodeValues { anomaly: true, recovery: true, timeout: true, ..FAILED };
        let rates = [Rate::Failure, Rate::Anomaly, Rate::Recovery, Rate::Timeout, Rate::Retry];
        let found = compared(&rates, &pairs(&[(lost, DONE, 5), (retried, retried, 20)]));
        assert!(found.differs());
        let p: Vec<f64> = found.rates.iter().map(|rate| rate.p).collect();
        assert_eq!(p[..4], [p[0]; 4]);
        assert!((p[0] - 1.0 / 32.0).abs() < 1e-12 && p[4] == 1.0, "{p:?}");
        let same = compared(&rates, &pairs(&[(lost, lost, 40)]));
        assert!(!same.differs() && same.rates.iter().all(|rate| rate.p == 1.0));
    }

    #[test]
    fn a_tighter_envelope_hides_the_tasks_that_it_makes_slow() {
        let slow = EpisodeValues { time_s: 11.0, ..DONE };
        let mut tasks = pairs(&[(slow, DONE, 10)]);
        assert!(compared(&[Rate::Slow], &tasks).differs());
        for task in &mut tasks {
            task.tightened = true;
        }
        let found = compared(&[Rate::Slow], &tasks);
        assert!(!found.differs() && found.rates[0].tasks.is_empty());
        for task in &mut tasks {
            task.version.success = false;
        }
        assert!(compared(&[Rate::Failure], &tasks).differs(), "a failure does not follow from the envelope");
        assert!(!compared(&[], &tasks).differs(), "without a rate nothing differs");
    }

    #[test]
    fn rates_that_tripped_decide_before_those_that_warned() {
        let of = |finding| Reason::new(Dimension::Monitor, finding);
        let worse = |rate| of(Finding::RateWorse { rate });
        let drifts = |rate| of(Finding::RateDrifts { rate });
        for (reasons, expected) in [
            (vec![worse(Rate::Failure), drifts(Rate::Retry)], vec![Rate::Failure]),
            (vec![of(Finding::RollbackCoupled), drifts(Rate::Retry)], vec![Rate::Retry]),
            (vec![of(Finding::EscalationUnanswered), drifts(Rate::Slow)], vec![Rate::Slow]),
            (vec![worse(Rate::Intervention), drifts(Rate::Failure)], vec![Rate::Failure]),
            (vec![worse(Rate::Intervention)], Vec::new()),
            (vec![of(Finding::EscalationUnanswered), of(Finding::TelemetrySilent)], Vec::new()),
        ] {
            assert_eq!(deciding_rates(&reasons), expected, "{reasons:?}");
        }
    }

    #[test]
    fn a_target_that_is_bad_half_as_often_may_have_the_same_cause() {
        let of = |version, target| RateTally { rate: Rate::Failure, tasks: 40, version, target };
        for (version, target, is_shared) in
            [(4, 0, false), (5, 2, false), (4, 2, true), (0, 0, false), (3, 9, true)]
        {
            assert_eq!(of(version, target).is_shared(), is_shared, "{version} {target}");
        }
    }
}
