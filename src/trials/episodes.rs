//! Single episodes, and pairs of them, each on the world of its worker.
//!
//! Says what determines an episode ([`cache_key`]); what is kept under it, and which versions meet on which
//! seeds, is for [`super::trial_lab`] and [`super::evaluation`].

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_cell::CellCopy;
use holdpoint_cell::CellError;

use super::undisturbed_run::TrialCase;
use super::worker::Worker;
use super::worker_pool::{PoolJob, WorkerPool};
use crate::cell::{Cell, Conditions};
use crate::fault::TrialFault;
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::Skill;
use holdpoint_runtime::task::{Supervision, TaskRecord, TaskRun};
use holdpoint_runtime::terms::SkillTerms;

fn failed(worker: &mut Worker, error: CellError, trial: &TrialCase<'_>) -> TaskRecord {
    worker.failed(error, trial.version.bundle.task(), trial.seed)
}

/// Runs one episode of one version.
#[must_use]
pub fn episode(
    worker: &mut Worker,
    cell: &Cell,
    terms: &SkillTerms,
    version: &Capability,
    conditions: Conditions,
    seed: u64,
) -> TaskRecord {
    alone(worker, TrialCase { cell, terms, version, conditions, seed })
}

/// As [`episode`].
#[must_use]
pub fn alone(worker: &mut Worker, trial: TrialCase<'_>) -> TaskRecord {
    alone_with(worker, trial, |skill| skill)
}

/// As [`alone`], with something around the skill.
#[must_use]
pub fn alone_with(
    worker: &mut Worker,
    trial: TrialCase<'_>,
    around: impl FnOnce(Box<dyn Skill>) -> Box<dyn Skill>,
) -> TaskRecord {
    match worker.arm(trial.cell, &trial.setup()).map(|_| ()) {
        Ok(()) => alone_from_here(worker, &trial, around),
        Err(error) => failed(worker, error, &trial),
    }
}

/// As [`alone`], from the present state of the worker's arm.
pub(super) fn alone_here(worker: &mut Worker, trial: &TrialCase<'_>) -> TaskRecord {
    alone_from_here(worker, trial, |skill| skill)
}

fn alone_from_here(
    worker: &mut Worker,
    trial: &TrialCase<'_>,
    around: impl FnOnce(Box<dyn Skill>) -> Box<dyn Skill>,
) -> TaskRecord {
    let run = || -> Result<TaskRecord, CellError> {
        let arm = worker.built_arm()?;
        if !trial.is_admitted(arm) {
            return Ok(trial.refused());
        }
        Ok(trial.start_with(around).finish(&mut arm.handle(), &mut |_, _| Supervision::Continue)?)
    };
    run().unwrap_or_else(|error| failed(worker, error, trial))
}

/// Runs the same episode of two versions: on one world as long as both ask the same of it, then each on its own. In a cell
/// that cannot export its state each is on its own from the start. The records are those of two episodes by themselves.
#[must_use]
pub fn pair(worker: &mut Worker, both: [TrialCase<'_>; 2]) -> [TaskRecord; 2] {
    let [first, second] = both;
    let setup = first.setup();
    if setup != second.setup() || !first.cell.spec.abilities.export_state {
        return both.map(|trial| alone(worker, trial));
    }
    match worker.arm(first.cell, &setup).map(|_| ()) {
        Ok(()) => pair_here(worker, both),
        Err(error) => both.map(|trial| failed(worker, error.clone(), &trial)),
    }
}

/// As [`pair`], from the present state of the worker's arm.
pub(super) fn pair_here(worker: &mut Worker, both: [TrialCase<'_>; 2]) -> [TaskRecord; 2] {
    let [first, second] = both;
    let start = worker.built_arm().and_then(|arm| {
        let are_admitted = first.is_admitted(arm) && second.is_admitted(arm);
        (!are_admitted).then(|| arm.body().copy()).transpose()
    });
    match start {
        Ok(None) => {}
        // Who is not admitted works nothing, and the other works alone.
        Ok(Some(start)) => {
            return both.map(|trial| match worker.arm_from(trial.cell, &start).map(|_| ()) {
                Ok(()) => alone_here(worker, &trial),
                Err(error) => failed(worker, error, &trial),
            });
        }
        Err(error) => return both.map(|trial| failed(worker, error.clone(), &trial)),
    }
    let (mut one, mut other) = (first.start(), second.start());
    let mut begin = || -> Result<CellCopy, CellError> {
        let arm = worker.built_arm()?;
        TaskRun::run_together(&mut arm.handle(), &mut one, &mut other)?;
        arm.body().copy()
    };
    let parted = match begin() {
        Ok(parted) => parted,
        Err(error) => return both.map(|trial| failed(worker, error.clone(), &trial)),
    };
    let mut go_on = |run: TaskRun, trial: &TrialCase<'_>, from: Option<&CellCopy>| {
        let work = || -> Result<TaskRecord, CellError> {
            let arm = match from {
                Some(copy) => worker.arm_from(trial.cell, copy)?,
                None => worker.built_arm()?,
            };
            Ok(run.finish(&mut arm.handle(), &mut |_, _| Supervision::Continue)?)
        };
        work().unwrap_or_else(|error| failed(worker, error, trial))
    };
    [go_on(one, &first, None), go_on(other, &second, Some(&parted))]
}

/// Runs a version's episodes of these seeds by a worker pool; the records come back in the seeds' order.
///
/// # Errors
/// If a worker panicked, or if `cancel` was raised. Nothing is concluded from the batch then.
pub fn batch(
    worker_pool: &WorkerPool<TaskRecord>,
    cancel: &AtomicBool,
    cell: &Cell,
    (version, terms): (&Capability, &SkillTerms),
    conditions: Conditions,
    seeds: impl IntoIterator<Item = u64>,
) -> Result<Vec<TaskRecord>, TrialFault> {
    let shared = Arc::new((cell.clone(), terms.clone(), version.clone()));
    let job = |seed| {
        let shared = Arc::clone(&shared);
        let work = move |worker: &mut Worker| {
            let (cell, terms, version) = &*shared;
            episode(worker, cell, terms, version, conditions, seed)
        };
        PoolJob { key: cache_key(cell, terms, version, conditions, seed), work: Box::new(work) }
    };
    worker_pool.run_jobs(seeds.into_iter().map(job).collect(), cancel)
}

/// What a cached episode is stored under.
#[must_use]
pub fn cache_key(
    cell: &Cell,
    terms: &SkillTerms,
    capability: &Capability,
    conditions: Conditions,
    seed: u64,
) -> Digest {
    let under = format!("{}|{}|{seed}", terms.in_full(), conditions.name());
    Digest::of_parts(
        "holdpoint.episode.v3",
        &[cell.digest().bytes(), capability.digest().bytes(), under.as_bytes()],
    )
}
