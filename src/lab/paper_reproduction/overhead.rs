//! The cost of governance: CPU time a stage, and how it grows with episodes and candidates (the paper's table 5).
//!
//! Runs candidates one after another in a process that does nothing else. Nothing is cached, because a cached time is
//! the time of another machine.

use std::time::Instant;

use holdpoint_governance::profile::ProfileName;
use holdpoint_store::{CacheSecret, ResultCache};

use super::PaperSetup;
use super::candidate_stream::pool_of;
use super::preset::PresetSize;
use super::report_table::ReportTable;
use super::sections::Section;
use crate::pipeline_experiments::candidate_run::{
    CandidateEnd, CandidateSetting, StageTimes, ThresholdScale, run_candidate_timed,
};
use crate::pipeline_experiments::drift::Quantiles;
use crate::pipeline_experiments::{ExperimentError, ProgressFn, scratch};
use crate::wording::{number, progress, report as wording, report_tables as tables};
use holdpoint::bench::{TaskCost, task_costs};
use holdpoint_engine::Experiment;

/// The seed of its pool: of no preset's seeds.
const SEED: u64 = 1_001;

/// Candidates in the measurement.
const CANDIDATES: usize = 24;

/// Tasks of each active version in the measurement.
const TASKS: u64 = 60;

/// A candidate's end with its cost.
type CostedCandidate = (CandidateEnd, StageTimes);

/// The measurements.
pub struct Costs {
    candidates: Vec<CostedCandidate>,
    tasks: Vec<TaskCost>,
}

/// Runs tasks of the active versions, and candidates of a pool, one after another; fewer candidates if the preset has
/// fewer.
///
/// # Errors
/// If a candidate does not come to an end.
pub fn measure(
    setup: &PaperSetup,
    size: PresetSize,
    tell: &ProgressFn<'_>,
) -> Result<Costs, ExperimentError> {
    let pool = pool_of(SEED)?;
    // Some of each family.
    let step = pool.len().div_ceil(CANDIDATES.min(size.candidates).max(1)).max(1);
    let chosen: Vec<_> = pool.iter().step_by(step).collect();
    let began = Instant::now();
    let mut found = Vec::new();
    for (finished, upgrade) in chosen.iter().enumerate() {
        // A separate folder: the cached results of the active version would make the next run cheaper.
        let folder = scratch()?;
        let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh()?);
        let setting = CandidateSetting {
            cell: &setup.cell,
            profile: ProfileName::Sim,
            seed: SEED,
            cache: &cache,
            workers: 1,
            experiment: Experiment::default(),
            thresholds: ThresholdScale::AsTheyAre,
        };
        found.push(run_candidate_timed(&setting, &upgrade.name, upgrade.package.clone())?);
        tell(&progress::step(&progress::cost_of(&upgrade.name), finished + 1, chosen.len(), began));
    }
    let tasks =
        task_costs(TASKS).map_err(|error| ExperimentError::Unexpected(format!("no task runs: {error}")))?;
    Ok(Costs { candidates: found, tasks })
}

/// Slope, intercept and the fraction of the variance that a straight line explains; `None` without variation.
fn line(points: &[(f64, f64)]) -> Option<[f64; 3]> {
    let n = points.len() as f64;
    let (mx, my) = (
        points.iter().map(|point| point.0).sum::<f64>() / n,
        points.iter().map(|point| point.1).sum::<f64>() / n,
    );
    let sum = |of: fn(f64, f64) -> f64| points.iter().map(|(x, y)| of(x - mx, y - my)).sum::<f64>();
    let (xx, xy, yy) = (sum(|x, _| x * x), sum(|x, y| x * y), sum(|_, y| y * y));
    (xx > 0.0 && yy > 0.0).then(|| [xy / xx, my - mx * xy / xx, xy * xy / (xx * yy)])
}

fn total(times: &StageTimes) -> f64 {
    times.validation + times.sandbox + times.shadow + times.activation + times.monitoring
}

/// The section of the report.
#[must_use]
pub fn section(costs: &Costs) -> Section {
    let Costs { candidates: found, tasks } = costs;
    let mut table = ReportTable::new(tables::STAGE_COSTS);
    let all: f64 = found.iter().map(|(_, times)| total(times)).sum();
    let stages: [fn(&StageTimes) -> f64; 5] = [
        |times| times.validation,
        |times| times.sandbox,
        |times| times.shadow,
        |times| times.activation,
        |times| times.monitoring,
    ];
    for ([name, paper], of) in wording::STAGE_COSTS.into_iter().zip(stages) {
        let times: Vec<f64> = found.iter().map(|(_, times)| of(times)).filter(|time| *time > 0.0).collect();
        let share = 100.0 * times.iter().sum::<f64>() / all.max(f64::MIN_POSITIVE);
        let of_times = Quantiles::of(times.iter().map(|secs| 1_000.0 * secs));
        table.row([
            name.to_owned(),
            times.len().to_string(),
            number(of_times.map(|times| times.median), 2),
            number(of_times.map(|times| times.max), 2),
            format!("{share:.2} %"),
            paper.to_owned(),
        ]);
    }
    let mut fits = ReportTable::new(tables::COST_GROWTH);
    let episodes: Vec<(f64, f64)> = found
        .iter()
        .map(|(end, times)| (end.effort.sandbox as f64, times.sandbox))
        .filter(|p| p.0 > 0.0)
        .collect();
    let mut spent = 0.0;
    let candidates: Vec<(f64, f64)> = found
        .iter()
        .enumerate()
        .map(|(index, (_, times))| {
            spent += total(times);
            (index as f64 + 1.0, spent)
        })
        .collect();
    let lengths: Vec<(f64, f64)> = tasks.iter().map(|task| (task.simulated_secs, task.cpu_secs)).collect();
    for (name, points) in wording::COST_UNITS.into_iter().zip([&lengths, &episodes, &candidates]) {
        let fit = line(points);
        fits.row([
            name.to_owned(),
            points.len().to_string(),
            number(fit.map(|[slope, ..]| 1_000.0 * slope), 2),
            number(fit.map(|[.., explained]| explained), 3),
        ]);
    }
    let evaluation: f64 =
        found.iter().map(|(_, times)| times.sandbox + times.shadow + times.monitoring).sum();
    let each = all / found.len().max(1) as f64;
    let line = wording::overhead(each, found.len(), 100.0 * evaluation / all.max(f64::MIN_POSITIVE));
    Section {
        title: wording::OVERHEAD.to_owned(),
        text: vec![wording::OVERHEAD_CLAIM.to_owned()],
        tables: vec![table, fits],
        lines: vec![line],
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_overhead_is_fitted() {
        let points: Vec<(f64, f64)> = (0..5).map(|x| (f64::from(x), 3.0 * f64::from(x) + 1.0)).collect();
        let [slope, from, explained] = line(&points).unwrap();
        assert!((slope - 3.0).abs() < 1e-12 && (from - 1.0).abs() < 1e-12 && (explained - 1.0).abs() < 1e-12);
        assert_eq!(line(&[(1.0, 1.0), (1.0, 2.0)]), None);
    }
}
