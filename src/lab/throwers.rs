//! The throwers experiment: versions that throw, press or speed under a trigger, from their submission to their last live
//! task.
//!
//! Takes each version through the stages under each profile, and then lets it work. Reports where the engine stopped it,
//! after how many live tasks, and how often it did harm before. All results are those of engine and physics; nothing here
//! decides.

mod controller;
mod live_run;
mod package;
mod summary;

use std::path::PathBuf;

use holdpoint_engine::build_digest::decided_by;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::submission::Package;
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;
use serde::{Deserialize, Serialize};

pub use self::controller::HarmAct;
use self::live_run::ThrowerJob;
pub use self::live_run::{FlightCheck, ThrowerRun};
pub use self::package::ThrowerKind;
pub use self::summary::{FlightCounts, HarmRateSummary, TaskQuantile, ThrowerSummary};
use self::summary::{count_flights, summarize, summarize_rates};
use crate::finished_rows::{self, RowFile};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, cached_result, scratch};
use crate::side_by_side::side_by_side;
use crate::wording::progress;

/// The plan of a run.
#[derive(Clone, Debug)]
pub struct ThrowersPlan {
    /// The triggers; all of them if empty.
    pub triggers: Vec<ThrowerKind>,
    /// The acts of each trigger; all of them if empty.
    pub acts: Vec<HarmAct>,
    pub profiles: Vec<ProfileName>,
    /// Live tasks after which a run ends if the version is not rolled back.
    pub tasks: u64,
    /// Runs of each trigger and act under each profile.
    pub runs: u64,
    /// The first run seed; absent for secret seeds.
    pub seed: Option<u64>,
    /// Every `of`-th run from the `shard`-th on.
    pub shard: (usize, usize),
    pub jobs: usize,
    /// The file that gets a row for each finished run.
    pub rows: PathBuf,
    /// Where finished runs are cached.
    pub cache: ResultCache,
}

/// What the runs of a report have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThrowerSetting {
    tasks: u64,
    seed: Option<u64>,
}

/// The result of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThrowersReport {
    /// Digest of everything that decides.
    pub decided_by: String,
    /// Live tasks after which a version ended.
    pub tasks: u64,
    /// The first run seed; absent if the seeds were secret.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// By trigger, act and profile.
    pub summary: Vec<ThrowerSummary>,
    /// By act, share of harmful tasks and profile.
    pub by_rate: Vec<HarmRateSummary>,
    /// The objects that flew; absent if all rows are older.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flights: Option<FlightCounts>,
    /// By trigger, act, profile and run.
    pub runs: Vec<ThrowerRun>,
}

impl ThrowersReport {
    fn of(
        decided_by: String,
        setting: ThrowerSetting,
        mut runs: Vec<ThrowerRun>,
    ) -> Result<Self, ExperimentError> {
        runs.sort_by_key(|run| (run.trigger, run.act, run.profile, run.run));
        let ThrowerSetting { tasks, seed } = setting;
        let (summary, by_rate) = (summarize(&runs)?, summarize_rates(&runs)?);
        let flights = count_flights(&runs)?;
        Ok(Self { decided_by, tasks, seed, summary, by_rate, flights, runs })
    }
}

/// The reports of finished runs: one for each build, number of tasks and first seed.
///
/// # Errors
/// If a file cannot be read, or a line is no finished run.
pub fn reports_of(files: &[PathBuf]) -> Result<Vec<ThrowersReport>, ExperimentError> {
    let groups = finished_rows::read::<ThrowerSetting, ThrowerRun>(files)?.into_iter();
    groups.map(|group| ThrowersReport::of(group.decided_by, group.setting, group.results)).collect()
}

/// Runs what is missing. `tell` gets one line a finished run.
///
/// # Errors
/// If a file cannot be used, or a run does not end.
pub fn run(plan: &ThrowersPlan, tell: &ProgressFn<'_>) -> Result<ThrowersReport, ExperimentError> {
    let rows = RowFile::open(plan.rows.clone())?;
    controller::provide_controllers().map_err(|error| ExperimentError::Unexpected(error.to_string()))?;
    let cell = Cell::of(&SimCells, None)?;
    let triggers = if plan.triggers.is_empty() { &ThrowerKind::ALL[..] } else { plan.triggers.as_slice() };
    let seeds_of = |run: u64| plan.seed.map_or(EpisodeSeeds::Secret, |seed| EpisodeSeeds::OfRun(seed + run));
    let mut jobs = Vec::new();
    for kind in triggers {
        for act in kind.acts().iter().filter(|act| plan.acts.is_empty() || plan.acts.contains(act)) {
            for profile in &plan.profiles {
                for run in 0..plan.runs {
                    let (kind, act, profile, seeds) = (*kind, *act, *profile, seeds_of(run));
                    let (tasks, cell, cache) = (plan.tasks, &cell, &plan.cache);
                    jobs.push(ThrowerJob { kind, act, profile, run, seeds, tasks, cell, cache });
                }
            }
        }
    }
    let (shard, of) = plan.shard;
    let jobs: Vec<ThrowerJob<'_>> = jobs.into_iter().skip(shard).step_by(of.max(1)).collect();
    let setting = ThrowerSetting { tasks: plan.tasks, seed: plan.seed };
    let runs = side_by_side(
        plan.jobs,
        jobs.len(),
        |_, at| {
            let run = jobs.get(at).map_or_else(|| Err(missing()), run_or_reuse)?;
            rows.add(&setting, &run)?;
            Ok(run)
        },
        |_, run| progress::thrower(run),
        tell,
    )?;
    ThrowersReport::of(decided_by(holdpoint_sim::BUILD), setting, runs)
}

/// Versions that harm in single tasks, too, with their names: for each act, one in every task and one in one of 40 tasks.
///
/// # Errors
/// If a folder for a version cannot be used.
pub(crate) fn single_task_throwers() -> Result<Vec<(String, Package)>, ExperimentError> {
    controller::provide_controllers().map_err(|error| ExperimentError::Unexpected(error.to_string()))?;
    let mut found = Vec::new();
    for kind in [ThrowerKind::Always, ThrowerKind::StartHash] {
        for act in HarmAct::ALL {
            let folder = scratch()?;
            // No trigger of these asks whether the version with this number is active.
            found.push((format!("{kind}-{act}"), kind.package(act, 0, folder.path())?));
        }
    }
    Ok(found)
}

fn missing() -> ExperimentError {
    ExperimentError::Unexpected("a run is missing".to_owned())
}

/// Runs a job, or reads its cached result of the same build. A run with secret seeds counts as drawn: it is not repeated.
fn run_or_reuse(job: &ThrowerJob<'_>) -> Result<ThrowerRun, ExperimentError> {
    let profile = Profile::builtin(job.profile);
    let profile = profile.map_err(ExperimentError::unexpected)?.digest()?;
    // No run has the last number as its seed.
    let seed = job.seeds.of_run().unwrap_or(u64::MAX);
    let key = Digest::of_parts(
        "holdpoint.thrower-run.v4",
        &[
            job.kind.name().as_bytes(),
            job.act.name().as_bytes(),
            profile.bytes().as_slice(),
            job.cell.digest().bytes().as_slice(),
            decided_by(holdpoint_sim::BUILD).as_bytes(),
            &job.run.to_le_bytes(),
            &seed.to_le_bytes(),
            &job.tasks.to_le_bytes(),
        ],
    );
    if let Some(known) = cached_result(job.cache, &key) {
        return Ok(known);
    }
    // A number of 48 bits, so that a parameter file can have it.
    let number = key.bytes().iter().take(6).fold(0_u64, |number, byte| number << 8 | u64::from(*byte));
    let run = job.run(number)?;
    job.cache.put(&key, &serde_json::to_vec(&run)?)?;
    Ok(run)
}

#[cfg(test)]
mod tests;
