//! The work of a version under a seed as nothing disturbs it, worked once and forked where drills begin.
//!
//! The four kinds of drill rehearse on the same seeds, each at a point of its own; up to its point each sees the same
//! work. A skill that cannot be copied is worked again from the start. Judges nothing.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use holdpoint_body::{Body, Command};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::{TaskRecord, TaskRun};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimError;
use holdpoint_sim::episode::EpisodeSetup;
use holdpoint_sim::world::WorldCopy;

use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// Whose work it is, and where.
#[derive(Clone, Copy)]
pub struct TrialCase<'a> {
    pub cell: &'a Cell,
    pub terms: &'a SkillTerms,
    pub version: &'a Capability,
    pub conditions: Conditions,
    pub seed: u64,
}

impl TrialCase<'_> {
    /// The task before its first tick.
    #[must_use]
    pub fn start(&self) -> TaskRun {
        let version = self.version;
        let guard = self.terms.guard(&version.manifest.permissions);
        let terms = self.terms.task(version.bundle.task(), self.seed, version.abort_secs());
        TaskRun::new(version.start(self.terms.bundle_seed(self.seed)), guard, terms)
    }

    /// Whether the dispatcher would make this call, as the body stands.
    #[must_use]
    pub fn is_admitted<B: Body>(&self, arm: &Arm<B>) -> bool {
        admit(&self.version.manifest, &arm.body().telemetry()).is_ok()
    }

    /// The record of a call that the dispatcher refused.
    #[must_use]
    pub fn refused(&self) -> TaskRecord {
        TaskRecord::refused(self.version.bundle.task(), self.seed)
    }

    /// What is drawn for the episode.
    #[must_use]
    pub fn setup(&self) -> EpisodeSetup {
        let (cell, task) = (self.cell, self.version.bundle.task());
        EpisodeSetup::sample(task, &cell.scene, cell.distribution(self.conditions), self.seed)
    }
}

/// The work at one tick, to go on from more than once.
struct ForkPoint {
    tick: u64,
    world: WorldCopy,
    run: TaskRun,
}

/// See the module's head.
pub struct Undisturbed {
    start: WorldCopy,
    /// Where it is forked, ticks, ascending.
    points: Vec<u64>,
    /// In order of their ticks.
    forks: Vec<ForkPoint>,
    /// The last tick of the work, once it is known: no later point is ever reached.
    worked: Option<u64>,
    drilled: Vec<DrillKind>,
}

impl Undisturbed {
    /// Sets an episode up, to be worked as far as it is asked for and forked at some of `points` (ticks). Of a call
    /// that the dispatcher refuses no tick is reached.
    ///
    /// # Errors
    /// If the episode has no valid start.
    pub fn begin(worker: &mut Worker, trial: &TrialCase<'_>, mut points: Vec<u64>) -> Result<Self, SimError> {
        points.sort_unstable();
        // Nothing goes on from the last one but what begins there.
        points.pop();
        let arm = worker.arm(trial.cell, &trial.setup())?;
        let worked = (!trial.is_admitted(arm)).then_some(0);
        Ok(Self { start: arm.body().copy(), points, forks: Vec::new(), worked, drilled: Vec::new() })
    }

    /// Brings the worker's arm and the task to a point, ticks. `None` if the work is over before.
    ///
    /// # Errors
    /// If the world fails.
    pub fn reach(
        &mut self,
        worker: &mut Worker,
        trial: &TrialCase<'_>,
        point: u64,
    ) -> Result<Option<TaskRun>, SimError> {
        if self.worked.is_some_and(|worked| point > worked) {
            return Ok(None);
        }
        let fork = self.forks.iter().rev().find(|fork| fork.tick <= point);
        let forked = fork.and_then(|fork| Some((fork.tick, &fork.world, fork.run.fork()?)));
        let (mut at, world, mut run) = forked.unwrap_or_else(|| (0, &self.start, trial.start()));
        let arm = worker.arm_from(trial.cell, world)?;
        while at < point {
            let next = self.points.iter().copied().find(|next| (at + 1..point).contains(next));
            let stop = next.unwrap_or(point);
            let reached = run.work_until(&mut arm.handle(), &mut |passed| {
                let works = !matches!(passed.command, Command::Done | Command::Fail { .. });
                if works {
                    at = passed.tick;
                }
                works && passed.tick >= stop
            })?;
            if !reached {
                self.worked = Some(at);
                return Ok(None);
            }
            if self.points.contains(&at)
                && self.forks.iter().all(|fork| fork.tick != at)
                && let Some(run) = run.fork()
            {
                self.forks.push(ForkPoint { tick: at, world: arm.body().copy(), run });
                self.forks.sort_by_key(|fork| fork.tick);
            }
        }
        Ok(Some(run))
    }

    /// How often it was forked so far.
    #[cfg(test)]
    pub const fn forks(&self) -> usize {
        self.forks.len()
    }

    /// Notes that a kind of drill was worked on it. Tells whether there is one left.
    pub fn note_drilled(&mut self, kind: DrillKind) -> bool {
        self.drilled.push(kind);
        DrillKind::ALL.iter().any(|kind| !self.drilled.contains(kind))
    }
}

/// The most works kept at a time: two versions and two slices of seeds, with room to spare.
const KEPT_MAX: usize = 64;

/// Undisturbed works between two drills, the one kept longest given up first.
#[derive(Default)]
pub struct Shelf {
    kept: Mutex<VecDeque<(Digest, Undisturbed)>>,
}

impl Shelf {
    /// An empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self { kept: Mutex::new(VecDeque::new()) }
    }

    /// Takes out what is kept under a key.
    #[must_use]
    pub fn take(&self, key: &Digest) -> Option<Undisturbed> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let at = kept.iter().position(|(known, _)| known == key)?;
        kept.remove(at).map(|(_, work)| work)
    }

    /// Keeps a work.
    pub fn put(&self, key: Digest, work: Undisturbed) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT_MAX {
            kept.pop_front();
        }
        kept.push_back((key, work));
    }
}
