//! E4, rollback under drift: the rate at which versions that a drift worsens are rolled back, and the state of the
//! family later, by kind of drift and magnitude.
//!
//! Runs cells on several threads, caches each finished one in a file and skips it the next time. Sources: paper section
//! 7 (recovery 79.6 %); design rules 3.12 and 5.5. One cell: `drift_run.rs`; the files: `drift_report.rs`.

use std::path::PathBuf;

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::drift_run::{CellResult, CellRun, DriftSetting, activate, candidate_of, drifts};
use super::{ExperimentError, ProgressFn, cached_result, drift_report};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::stats::StatsError;
use holdpoint_store::ResultCache;

use crate::side_by_side::side_by_side;
use crate::wording::progress;

/// The most runs of one experiment.
pub const RUNS_MAX: u64 = 10_000;

/// The most sequences of a run, and of its twins: live episodes of one run must not repeat.
pub const SEQUENCES_MAX: u32 = 2_000;

/// The settings of the experiment.
#[derive(Clone, Debug)]
pub struct DriftOptions {
    /// Independent runs, each with a seed of its own.
    pub runs: u64,
    /// Seed of the first run; the others follow it.
    pub seed: u64,
    pub jobs: usize,
    /// Where the report goes.
    pub out: PathBuf,
    /// Where finished cells are cached.
    pub cache: ResultCache,
    /// The most live sequences of a version that is not rolled back.
    pub horizon: u32,
    /// Sequences of the twins, which show whether a drift worsens a version.
    pub pairs: u32,
}

/// The median, the ninetieth percentile and the largest of some values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantiles {
    pub n: u64,
    pub median: f64,
    /// Ninetieth percentile, nearest rank.
    pub p90: f64,
    pub max: f64,
}

impl Quantiles {
    /// Of at least one value.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let n = values.len();
        let upper = values.get(n / 2)?;
        let lower = values.get((n - 1) / 2)?;
        let p90 = values.get((n * 9).div_ceil(10).max(1) - 1)?;
        let max = values.last()?;
        Some(Self { n: n as u64, median: 0.5 * (lower + upper), p90: *p90, max: *max })
    }
}

/// The result of one drift in one magnitude. Rates have Wilson intervals at 95 %.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftCell {
    pub kind: DriftKind,
    pub magnitude: Magnitude,
    /// Runs whose candidate was activated.
    pub runs: u64,
    /// Runs in which the drift worsened the version / runs.
    pub needed: Proportion,
    /// Rolled back within the horizon / runs that needed it.
    pub trigger_recall: Proportion,
    /// Rolled back within the horizon / runs that did not need it: early or needless, and safe either way.
    pub triggered_unneeded: Proportion,
    /// Recovered / rolled back (needed or not).
    pub recovery_given_trigger: Proportion,
    /// Recovered / needed it.
    pub end_to_end: Proportion,
    /// Ladders that ended in a safe-stopped family / rolled back.
    pub safe_stopped: Proportion,
    /// First response was `restrict` (the early warning) / rolled back or warned.
    pub warned_first: Proportion,
    /// Tasks under the drift until the first response.
    pub episodes_to_response: Option<Quantiles>,
    /// Tasks under the drift until the rollback.
    pub episodes_to_rollback: Option<Quantiles>,
    /// Trigger to standstill, ms, in flight.
    pub time_to_safe_ms: Option<Quantiles>,
    /// Trigger to the rollback target bound and ready, ms.
    pub time_to_restored_ms: Option<Quantiles>,
    /// Motion after the trigger beyond braking, ms.
    pub unsafe_continuation_ms: Option<Quantiles>,
    /// The version's tasks that were not bad, without the drift (twins).
    pub good_before: Proportion,
    /// The version's tasks that were not bad, under the drift and unwatched (twins).
    pub good_under: Proportion,
    /// The rollback target's tasks done under the drift.
    pub success_after: Proportion,
    /// The rollback target's tasks with something unsafe by ground truth.
    pub unsafe_after: Proportion,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftReport {
    /// Digest of profile, cell, versions and sizes.
    pub setting: Digest,
    /// Seed of the first run.
    pub seed: u64,
    pub runs: u64,
    /// Runs whose candidate the pipeline did not activate; they count in no cell.
    pub not_activated: u64,
    /// Longest watched run, sequences.
    pub horizon: u32,
    /// Sequences of the twins.
    pub pairs: u32,
    /// By kind and magnitude.
    pub cells: Vec<DriftCell>,
}

/// Runs what is missing and writes the report files.
///
/// # Errors
/// Options that are not allowed, files that cannot be written, faults of the pipeline.
pub fn run(options: &DriftOptions, tell: &ProgressFn<'_>) -> Result<DriftReport, ExperimentError> {
    check(options)?;
    std::fs::create_dir_all(&options.out).map_err(ExperimentError::file(&options.out))?;
    let setting = DriftSetting::new(options)?;
    let digest = setting.digest()?;
    let seed_of = |at: usize| options.seed + at as u64;
    side_by_side(
        options.jobs,
        usize::try_from(options.runs).unwrap_or(usize::MAX),
        |_, at| one_run(&setting, digest, seed_of(at), tell),
        |at, ()| progress::run(seed_of(at)),
        tell,
    )?;
    let report = summarize(options, digest)?;
    drift_report::write(&report, &options.out)?;
    Ok(report)
}

fn check(options: &DriftOptions) -> Result<(), ExperimentError> {
    let wrong = |option, value: u64, allowed| {
        Err(ExperimentError::Option { option, value: value.to_string(), allowed })
    };
    if !(1..=RUNS_MAX).contains(&options.runs) {
        return wrong("--runs", options.runs, "1 to 10000 are");
    }
    for (option, value) in [("--horizon", options.horizon), ("--pairs", options.pairs)] {
        if !(1..=SEQUENCES_MAX).contains(&value) {
            return wrong(option, u64::from(value), "1 to 2000 are");
        }
    }
    Ok(())
}

/// The key of a cached cell.
fn key_of(setting: &Digest, seed: u64, drift: Drift) -> Digest {
    let (kind, magnitude) = (drift.kind.to_string(), drift.magnitude.to_string());
    let parts = [setting.bytes().as_slice(), &seed.to_le_bytes(), kind.as_bytes(), magnitude.as_bytes()];
    Digest::of_parts("holdpoint.drift-cell.v1", &parts)
}

pub(super) fn cached_run(cache: &ResultCache, setting: &Digest, seed: u64, drift: Drift) -> Option<CellRun> {
    let run: CellRun = cached_result(cache, &key_of(setting, seed, drift))?;
    (run.setting == *setting).then_some(run)
}

/// A proportion of counts.
pub(crate) fn counted(good: u64, all: u64) -> Result<Proportion, StatsError> {
    Proportion::of((0..all).map(|i| i < good))
}

/// All cells of a run that are not there yet.
fn one_run(
    setting: &DriftSetting,
    digest: Digest,
    seed: u64,
    tell: &ProgressFn<'_>,
) -> Result<(), ExperimentError> {
    let cache = &setting.cache;
    let missing: Vec<Drift> =
        drifts().filter(|drift| cached_run(cache, &digest, seed, *drift).is_none()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let activated = activate(setting, seed)?;
    let candidate = candidate_of(seed);
    let one = |_: &mut Worker, at: usize| -> Result<CellRun, ExperimentError> {
        let drift = missing[at];
        let run = CellRun {
            setting: digest,
            seed,
            candidate: candidate.to_owned(),
            kind: drift.kind,
            magnitude: drift.magnitude,
            result: activated.as_ref().map(|run| run.cell(setting, drift)).transpose()?,
        };
        cache.put(&key_of(&digest, seed, drift), &serde_json::to_vec(&run)?)?;
        Ok(run)
    };
    side_by_side(setting.workers, missing.len(), one, |_, run| progress::drift(run), tell)?;
    Ok(())
}

fn summarize(options: &DriftOptions, digest: Digest) -> Result<DriftReport, ExperimentError> {
    let mut not_activated = 0;
    let mut summed = Vec::new();
    for drift in drifts() {
        let mut results = Vec::new();
        let mut missing = 0;
        for seed in options.seed..options.seed + options.runs {
            let run = cached_run(&options.cache, &digest, seed, drift)
                .ok_or_else(|| ExperimentError::Unexpected(format!("the cell of run {seed} is gone")))?;
            match run.result {
                Some(result) => results.push(result),
                None => missing += 1,
            }
        }
        not_activated = missing;
        summed.push(sum(drift, &results)?);
    }
    Ok(DriftReport {
        setting: digest,
        seed: options.seed,
        runs: options.runs,
        not_activated,
        horizon: options.horizon,
        pairs: options.pairs,
        cells: summed,
    })
}

fn sum(drift: Drift, results: &[CellResult]) -> Result<DriftCell, ExperimentError> {
    let needed = || results.iter().filter(|result| result.effect.needs_trigger);
    let off = || results.iter().filter_map(|result| Some((result, result.rollback.as_ref()?)));
    let total = |count: &dyn Fn(&CellResult) -> u64| results.iter().map(count).sum::<u64>();
    let pairs = total(&|result| result.effect.pairs);
    let after = total(&|result| u64::from(result.after.tasks));
    Ok(DriftCell {
        kind: drift.kind,
        magnitude: drift.magnitude,
        runs: results.len() as u64,
        needed: Proportion::of(results.iter().map(|result| result.effect.needs_trigger))?,
        trigger_recall: Proportion::of(needed().map(|result| result.rollback.is_some()))?,
        triggered_unneeded: Proportion::of(
            results
                .iter()
                .filter(|result| !result.effect.needs_trigger)
                .map(|result| result.rollback.is_some()),
        )?,
        recovery_given_trigger: Proportion::of(off().map(|(result, _)| result.recovered))?,
        end_to_end: Proportion::of(needed().map(|result| result.recovered))?,
        safe_stopped: Proportion::of(off().map(|(_, record)| record.predecessor.is_none()))?,
        warned_first: Proportion::of(
            results
                .iter()
                .filter_map(|result| result.first.as_ref())
                .map(|first| first.decision == MonitorOutcome::Restrict),
        )?,
        episodes_to_response: Quantiles::of(
            results.iter().filter_map(|result| result.first.as_ref()).map(|first| f64::from(first.episodes)),
        ),
        episodes_to_rollback: Quantiles::of(off().map(|(result, _)| f64::from(result.under.tasks))),
        time_to_safe_ms: Quantiles::of(
            off()
                .filter(|(_, record)| record.in_flight)
                .filter_map(|(_, record)| record.time_to_safe_ms)
                .map(|ms| ms as f64),
        ),
        time_to_restored_ms: Quantiles::of(
            off().filter_map(|(_, record)| record.time_to_restored_ms).map(|ms| ms as f64),
        ),
        unsafe_continuation_ms: Quantiles::of(off().map(|(_, record)| record.unsafe_continuation_ms as f64)),
        good_before: counted(pairs - total(&|result| result.effect.bad_calm), pairs)?,
        good_under: counted(pairs - total(&|result| result.effect.bad_under), pairs)?,
        success_after: counted(total(&|result| u64::from(result.after.done)), after)?,
        unsafe_after: counted(total(&|result| u64::from(result.after.unsafe_tasks)), after)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_store::CacheSecret;

    #[test]
    fn quantiles_of_few_values_are_computed() {
        assert_eq!(Quantiles::of([]), None);
        let spread = Quantiles::of([3.0, 1.0, 2.0, 10.0]).unwrap();
        assert_eq!((spread.n, spread.median, spread.p90, spread.max), (4, 2.5, 10.0, 10.0));
        assert_eq!(Quantiles::of([7.0]).unwrap().p90, 7.0);
    }

    #[test]
    fn options_have_limits() {
        let good = DriftOptions {
            runs: 1,
            seed: 100,
            jobs: 1,
            out: PathBuf::from("unused"),
            cache: ResultCache::in_folder(PathBuf::from("unused"), CacheSecret::fresh().unwrap()),
            horizon: 200,
            pairs: 60,
        };
        assert!(check(&good).is_ok());
        for (bad, names) in [
            (DriftOptions { runs: 0, ..good.clone() }, "--runs 0"),
            (DriftOptions { horizon: 0, ..good.clone() }, "--horizon 0"),
            (DriftOptions { pairs: 2_001, ..good.clone() }, "--pairs 2001"),
        ] {
            assert!(check(&bad).unwrap_err().to_string().starts_with(names));
        }
    }
}
