//! Single episodes and batches of them, on a pool of worlds, results in the order they were asked for.
//!
//! Says what determines an episode ([`cache_key`]); what is kept under it, and which versions meet on which
//! seeds, is for [`super::lab`] and [`super::evaluation`].

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use holdpoint_sim::SimError;
use holdpoint_sim::episode::EpisodeSetup;
use holdpoint_sim::pool::run_ordered;
use holdpoint_sim::world::World;

use crate::cell::{Cell, Conditions};
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::{self, Supervision, TaskRecord};
use holdpoint_runtime::terms::SkillTerms;

/// A worker of the pool: one world, used again for every episode.
pub struct Worker {
    world: Option<Arm<World>>,
}

impl Worker {
    /// A worker that builds its world at its first episode.
    #[must_use]
    pub const fn new() -> Self {
        Self { world: None }
    }

    /// The worker's arm, reset to an episode.
    ///
    /// # Errors
    /// If the world cannot be built or the episode has no valid start.
    pub fn arm(&mut self, cell: &Cell, setup: &EpisodeSetup) -> Result<&mut Arm<World>, SimError> {
        let mut arm = match self.world.take() {
            Some(arm) => arm,
            None => Arm::new(cell.world()?),
        };
        arm.body_mut().reset(setup)?;
        Ok(self.world.insert(arm))
    }
}

impl Default for Worker {
    fn default() -> Self {
        Self::new()
    }
}

/// Runs one episode of one version.
#[must_use]
pub fn episode(
    worker: &mut Worker,
    cell: &Cell,
    terms: &SkillTerms,
    capability: &Capability,
    conditions: Conditions,
    seed: u64,
) -> TaskRecord {
    let task = capability.bundle.task();
    let setup = EpisodeSetup::sample(task, &cell.scene, cell.distribution(conditions), seed);
    let mut run = || -> Result<TaskRecord, SimError> {
        let arm = worker.arm(cell, &setup)?;
        let mut guard = terms.guard(capability.manifest.permissions.authority);
        let mut skill = capability.bundle.start(seed);
        let task_terms = terms.task(task, seed, capability.abort_secs());
        let ended = task::run(&mut arm.handle(), skill.as_mut(), &mut guard, &task_terms, &mut |_, _| {
            Supervision::Continue
        });
        Ok(ended?)
    };
    run().unwrap_or_else(|_| {
        // A world that diverged is not used again.
        worker.world = None;
        TaskRecord::invalid(task, seed)
    })
}

/// Which episode, of which version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeJob {
    /// Index into the list of versions.
    pub version: usize,
    pub seed: u64,
}

/// Runs a list of episodes on `jobs` workers; the records come back in the list's order.
///
/// # Errors
/// If a worker panicked; the error names the episode. Nothing is concluded from the batch then.
pub fn batch(
    jobs: usize,
    cancel: &AtomicBool,
    cell: &Cell,
    versions: &[(&Capability, &SkillTerms)],
    conditions: Conditions,
    list: &[EpisodeJob],
) -> Result<Vec<TaskRecord>, SimError> {
    let mut records = Vec::with_capacity(list.len());
    run_ordered(
        jobs,
        list.len() as u64,
        cancel,
        || Ok(Worker::new()),
        |worker, index| {
            // The pool hands out indices below the list's length.
            let job = usize::try_from(index).ok().and_then(|index| list.get(index));
            job.and_then(|job| {
                let (capability, terms) = versions.get(job.version)?;
                Some(episode(worker, cell, terms, capability, conditions, job.seed))
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
