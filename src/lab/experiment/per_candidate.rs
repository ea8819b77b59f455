//! Every candidate of a pool through the seven stages, and what the truth file says of it afterwards.
//!
//! The engine decides first, about all of them; the truth is read then. Each candidate gets a store of its own.
//! They are spread over a few run seeds: candidates that share one share the episodes of the active version (and
//! their luck with them), so that a pool does not pay for a baseline per candidate.

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::candidate::{CandidateEnd, Setting, Thresholds, take};
use super::verdict::{Claim, Judged, Summary};
use super::{ExperimentError, Tell, kept, scratch};
use crate::pool::{Pool, PoolCandidate, PoolTruth};
use holdpoint_engine::Experiment;
use holdpoint_engine::cell::{Cell, DECIDED_BY};
use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_registry::{KeptCells, KeptSecret};
use holdpoint_runtime::capability;
use holdpoint_text::Hint;

/// What is to be run.
#[derive(Clone, Debug)]
pub struct RunPlan {
    pub pool: PathBuf,
    /// The profiles, from the loosest to the strictest.
    pub profiles: Vec<ProfileName>,
    /// The first run seed.
    pub seed: u64,
    /// Run seeds that the candidates are spread over.
    pub blocks: u64,
    pub jobs: usize,
    /// Finished candidates and active versions' episodes are kept here and not run again; nowhere beyond this run if
    /// absent.
    pub kept: Option<KeptCells>,
}

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PerCandidateReport {
    /// Each candidate under each profile, in the pool's order.
    pub candidates: Vec<Judged>,
    pub summaries: Vec<Summary>,
    /// What was to be shown, and whether it was.
    pub claims: Vec<Claim>,
}

/// One candidate to be taken through one profile.
pub(crate) struct Task<'a> {
    pub(crate) name: &'a str,
    pub(crate) package: &'a Package,
    pub(crate) profile: ProfileName,
    pub(crate) seed: u64,
    /// What is left out, and which versions are active at first.
    pub(crate) experiment: Experiment,
    pub(crate) thresholds: Thresholds,
    /// How many work at it at once.
    pub(crate) workers: usize,
}

/// Runs the plan. `tell` is given one line per finished candidate.
///
/// # Errors
/// If the pool cannot be read, a candidate does not come to an end, or the truth is not the sealed one.
pub fn run(plan: &RunPlan, tell: &Tell<'_>) -> Result<PerCandidateReport, ExperimentError> {
    let pool = Pool::read(&plan.pool)?;
    let packages = packages(&pool)?;
    let scratch = scratch()?;
    let cells = match &plan.kept {
        Some(cells) => cells.clone(),
        None => KeptCells::in_folder(scratch.path().to_owned(), KeptSecret::fresh()?),
    };
    let cell = Cell::builtin()?;
    let mut tasks = Vec::new();
    for profile in &plan.profiles {
        for (index, (name, package)) in packages.iter().enumerate() {
            let seed = plan.seed + index as u64 % plan.blocks.max(1);
            tasks.push(Task {
                name,
                package,
                profile: *profile,
                seed,
                experiment: Experiment::default(),
                thresholds: Thresholds::AsTheyAre,
                workers: 1,
            });
        }
    }
    let ends = work(plan.jobs, &cell, &cells, &tasks, tell)?;
    // Everything is decided: only now is the truth looked at.
    let truth = pool.truth()?;
    judge(&truth, ends, &plan.profiles)
}

/// The packages of a pool, in its order.
pub(crate) fn packages(pool: &Pool) -> Result<Vec<(String, Package)>, ExperimentError> {
    let read = |candidate: &PoolCandidate| {
        let package = capability::read(&pool.folder(candidate))
            .map_err(|error| ExperimentError::candidate(&candidate.name, error.sentence()))?;
        Ok((candidate.name.clone(), package))
    };
    pool.index.candidates.iter().map(read).collect()
}

/// Takes the tasks through, some at once; the ends come back in the tasks' order.
fn work(
    jobs: usize,
    cell: &Cell,
    cells: &KeptCells,
    tasks: &[Task<'_>],
    tell: &Tell<'_>,
) -> Result<Vec<CandidateEnd>, ExperimentError> {
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let began = Instant::now();
    let ends: Mutex<Vec<Option<CandidateEnd>>> = Mutex::new(vec![None; tasks.len()]);
    let failed: Mutex<Option<ExperimentError>> = Mutex::new(None);
    let worker = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(task) = tasks.get(index) else { return };
            if failed.lock().is_ok_and(|failed| failed.is_some()) {
                return;
            }
            match one(cell, cells, task) {
                Ok(end) => {
                    let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
                    tell(&progress(&end, finished, tasks.len(), began));
                    if let Ok(mut ends) = ends.lock() {
                        ends[index] = Some(end);
                    }
                }
                Err(error) => {
                    if let Ok(mut failed) = failed.lock() {
                        failed.get_or_insert(error);
                    }
                }
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, tasks.len().max(1)) {
            scope.spawn(worker);
        }
    });
    if let Some(error) = failed.into_inner().ok().flatten() {
        return Err(error);
    }
    let ends =
        ends.into_inner().map(|ends| ends.into_iter().flatten().collect::<Vec<_>>()).unwrap_or_default();
    if ends.len() == tasks.len() {
        Ok(ends)
    } else {
        Err(ExperimentError::Unexpected("a worker ended without a result".to_owned()))
    }
}

/// One candidate, or what is kept of it from an earlier run of the same build.
pub(crate) fn one(cell: &Cell, cells: &KeptCells, task: &Task<'_>) -> Result<CandidateEnd, ExperimentError> {
    let (profile, _) = task
        .thresholds
        .of(task.profile)?
        .rules()
        .map_err(|error| ExperimentError::candidate(task.name, error.sentence()))?;
    let Experiment { omitted, first } = &task.experiment;
    let first: Vec<u8> = first.iter().flat_map(|version| *version.digest().bytes()).collect();
    let omitted = serde_json::to_vec(omitted)?;
    let parts = [
        task.package.manifest.as_bytes(),
        task.package.submission.as_bytes(),
        task.package.params.as_bytes(),
        task.package.component.as_ref().map_or(&[], ComponentBytes::bytes),
        &task.seed.to_le_bytes(),
        profile.digest()?.bytes().as_slice(),
        cell.digest().bytes().as_slice(),
        DECIDED_BY.as_bytes(),
        &omitted,
        &first,
    ]
    .map(<[u8]>::to_vec);
    let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    let key = Digest::of_parts("holdpoint.end.v5", &parts);
    if let Some(kept) = kept::<CandidateEnd>(cells, &key).filter(|kept| kept.name == task.name) {
        return Ok(kept);
    }
    let experiment = task.experiment.clone();
    let Task { profile, seed, thresholds, workers, .. } = *task;
    let setting = Setting { cell, profile, seed, cells, workers, experiment, thresholds };
    let end = take(&setting, task.name, task.package.clone())?;
    cells.put(&key, &serde_json::to_vec(&end)?)?;
    Ok(end)
}

fn progress(end: &CandidateEnd, finished: usize, all: usize, began: Instant) -> String {
    let spent = began.elapsed().as_secs_f64();
    let left = spent / finished as f64 * (all - finished) as f64;
    format!(
        "[{finished}/{all}] {} {}: {} after {} episodes; about {:.0} min left",
        end.profile.name(),
        end.name,
        end.state,
        end.effort.sandbox,
        left / 60.0
    )
}

fn judge(
    truth: &PoolTruth,
    ends: Vec<CandidateEnd>,
    profiles: &[ProfileName],
) -> Result<PerCandidateReport, ExperimentError> {
    let candidates: Vec<Judged> =
        ends.into_iter().map(|end| Judged::of(end, truth)).collect::<Result<_, _>>()?;
    let summaries: Vec<Summary> =
        profiles.iter().map(|profile| Summary::of(*profile, &candidates)).collect::<Result<_, _>>()?;
    let claims = super::verdict::claims(&summaries);
    Ok(PerCandidateReport { candidates, summaries, claims })
}
