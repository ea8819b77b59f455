//! Single episodes and batches of them, on a pool of worlds, results in the order they were asked for.
//!
//! Says what determines an episode ([`cache_key`]); what is kept under it, and which versions meet on which
//! seeds, is for [`super::lab`] and [`super::evaluation`].

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use holdpoint_sim::SimError;
use holdpoint_sim::episode::EpisodeSetup;
use holdpoint_sim::pool::run_ordered;
use holdpoint_sim::world::{World, WorldCopy};

use super::undisturbed::{Shelf, TrialCase};
use crate::cell::{Cell, Conditions};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::{Supervision, TaskRecord, TaskRun};
use holdpoint_runtime::terms::SkillTerms;

/// A worker of the pool: one world, used again for every episode.
#[derive(Default)]
pub struct Worker {
    /// The arm in its world, and the digest of the cell it was built from.
    built: Option<(Digest, Arm<World>)>,
}

impl Worker {
    /// A worker that builds its world at its first episode.
    #[must_use]
    pub const fn new() -> Self {
        Self { built: None }
    }

    /// The worker's arm, reset to an episode.
    ///
    /// # Errors
    /// If the world cannot be built or the episode has no valid start.
    pub fn arm(&mut self, cell: &Cell, setup: &EpisodeSetup) -> Result<&mut Arm<World>, SimError> {
        let mut arm = match self.built.take() {
            Some((of, arm)) if of == cell.digest() => arm,
            _ => Arm::new(cell.world()?),
        };
        arm.body_mut().reset(setup)?;
        let (_, arm) = self.built.insert((cell.digest(), arm));
        Ok(arm)
    }

    /// The worker's arm, in the state of a world of the same cell.
    ///
    /// # Errors
    /// If the world cannot be built, or the copy is not of this robot.
    pub fn arm_from(&mut self, cell: &Cell, copy: &WorldCopy) -> Result<&mut Arm<World>, SimError> {
        let mut arm = match self.built.take() {
            Some((of, arm)) if of == cell.digest() => arm,
            _ => Arm::new(cell.world()?),
        };
        arm.body_mut().go_on_from(copy)?;
        let (_, arm) = self.built.insert((cell.digest(), arm));
        Ok(arm)
    }

    /// The worker's arm as it stands.
    ///
    /// # Errors
    /// If it has none: before its first episode, and after one in which its world failed.
    pub fn built_arm(&mut self) -> Result<&mut Arm<World>, SimError> {
        let none = || SimError::Worker { item: 0, message: "it has no world".to_owned() };
        self.built.as_mut().map(|(_, arm)| arm).ok_or_else(none)
    }

    /// The record of an episode in which the world failed. A world that diverged is not used again.
    fn failed(&mut self, trial: &TrialCase<'_>) -> TaskRecord {
        self.built = None;
        TaskRecord::invalid(trial.version.bundle.task(), trial.seed)
    }
}

/// Workers that outlive a batch: their worlds are not built anew for each.
pub struct Workers {
    jobs: usize,
    idle: Mutex<Vec<Worker>>,
    /// What several drills begin with.
    pub(super) undisturbed: Shelf,
}

impl Workers {
    /// So many workers; each builds its world at its first episode.
    #[must_use]
    pub const fn new(jobs: usize) -> Self {
        Self { jobs, idle: Mutex::new(Vec::new()), undisturbed: Shelf::new() }
    }

    /// How many work at a time.
    #[must_use]
    pub const fn jobs(&self) -> usize {
        self.jobs
    }

    /// An idle worker, or a new one.
    pub fn hire(&self) -> HiredWorker<'_> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        HiredWorker { worker: idle.unwrap_or_default(), is_whole: true, home: self }
    }
}

/// A worker until it is dropped. One whose work panicked does not come back: its world may be half changed.
pub struct HiredWorker<'a> {
    worker: Worker,
    is_whole: bool,
    home: &'a Workers,
}

impl HiredWorker<'_> {
    /// Runs `work` on the worker and tells what it gives.
    pub fn run<R>(&mut self, work: impl FnOnce(&mut Worker) -> R) -> R {
        self.is_whole = false;
        let result = work(&mut self.worker);
        self.is_whole = true;
        result
    }
}

impl Drop for HiredWorker<'_> {
    fn drop(&mut self) {
        if self.is_whole {
            let worker = std::mem::take(&mut self.worker);
            self.home.idle.lock().unwrap_or_else(PoisonError::into_inner).push(worker);
        }
    }
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
    let mut run = || -> Result<TaskRecord, SimError> {
        let arm = worker.arm(trial.cell, &trial.setup())?;
        Ok(trial.start().finish(&mut arm.handle(), &mut |_, _| Supervision::Continue)?)
    };
    run().unwrap_or_else(|_| worker.failed(&trial))
}

/// Runs the same episode of two versions: on one world as long as both ask the same of it, then each on its own.
/// The records are those of two episodes by themselves.
#[must_use]
pub fn pair(worker: &mut Worker, [first, second]: [TrialCase<'_>; 2]) -> [TaskRecord; 2] {
    let setup = first.setup();
    if setup != second.setup() {
        return [first, second].map(|trial| alone(worker, trial));
    }
    let (mut one, mut other) = (first.start(), second.start());
    let mut begin = || -> Result<WorldCopy, SimError> {
        let arm = worker.arm(first.cell, &setup)?;
        TaskRun::work_together(&mut arm.handle(), &mut one, &mut other)?;
        Ok(arm.body().copy())
    };
    let Ok(parted) = begin() else {
        return [first, second].map(|trial| worker.failed(&trial));
    };
    let mut go_on = |run: TaskRun, trial: &TrialCase<'_>, from: Option<&WorldCopy>| {
        let work = || -> Result<TaskRecord, SimError> {
            let arm = match from {
                Some(copy) => worker.arm_from(trial.cell, copy)?,
                None => worker.built_arm()?,
            };
            Ok(run.finish(&mut arm.handle(), &mut |_, _| Supervision::Continue)?)
        };
        work().unwrap_or_else(|_| worker.failed(trial))
    };
    [go_on(one, &first, None), go_on(other, &second, Some(&parted))]
}

/// Which episode, of which version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeJob {
    /// Index into the list of versions.
    pub version: usize,
    pub seed: u64,
}

/// Runs a list of episodes on the workers; the records come back in the list's order.
///
/// # Errors
/// If a worker panicked; the error names the episode. Nothing is concluded from the batch then.
pub fn batch(
    workers: &Workers,
    cancel: &AtomicBool,
    cell: &Cell,
    versions: &[(&Capability, &SkillTerms)],
    conditions: Conditions,
    list: &[EpisodeJob],
) -> Result<Vec<TaskRecord>, SimError> {
    let mut records = Vec::with_capacity(list.len());
    run_ordered(
        workers.jobs(),
        list.len() as u64,
        cancel,
        || Ok(workers.hire()),
        |worker, index| {
            // The pool hands out indices below the list's length.
            let job = usize::try_from(index).ok().and_then(|index| list.get(index));
            job.and_then(|job| {
                let (capability, terms) = versions.get(job.version)?;
                Some(worker.run(|worker| episode(worker, cell, terms, capability, conditions, job.seed)))
            })
        },
        |_, record| {
            records.extend(record);
            ControlFlow::Continue(())
        },
    )?;
    Ok(records)
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
    let under = format!("{:?}|{:?}|{}|{}", terms.envelope(), terms.watch(), conditions.name(), seed);
    Digest::of_parts(
        "holdpoint.episode.v1",
        &[cell.digest().bytes(), capability.digest().bytes(), under.as_bytes()],
    )
}
