//! The work of a version under a seed as nothing disturbs it, worked once and forked where drills begin.
//!
//! It runs to its end once, which shows its phases and their times. The four kinds of drill use the same seeds and
//! the same phase, each at a point of its own, and continue from the beginning of that phase. A skill that cannot be
//! copied is re-run from the start. Judges nothing.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use holdpoint_body::{Body, Command};
use holdpoint_cell::{CellCopy, CellError, EpisodeSetup};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::Skill;
use holdpoint_runtime::task::{Supervision, TaskRecord, TaskRun, TaskStage};
use holdpoint_runtime::terms::SkillTerms;

use super::drills::phases::{POINT_MIN, PhaseWatch, WorkTrace};
use super::worker::{TrialArm, Worker};
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
        self.start_with(|skill| skill)
    }

    /// As [`TrialCase::start`], with something around the skill.
    pub(super) fn start_with(&self, around: impl FnOnce(Box<dyn Skill>) -> Box<dyn Skill>) -> TaskRun {
        let version = self.version;
        let guard = self.terms.guard(&version.manifest.permissions);
        let terms = self.terms.task(version.bundle.task(), self.seed, version.abort_secs());
        TaskRun::new(around(version.start(self.terms.bundle_seed(self.seed))), guard, terms)
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
    world: CellCopy,
    run: TaskRun,
}

/// See the module's head.
pub struct UndisturbedRun {
    /// Absent in a cell that cannot export its state: it is reset to the start again, and nothing is forked.
    start: Option<CellCopy>,
    /// The phase in which drills begin: it is forked where that begins.
    phase: Option<WorkPhase>,
    /// In order of their ticks.
    forks: Vec<ForkPoint>,
    /// The whole work, once it was worked to its end.
    trace: Option<WorkTrace>,
    drilled: Vec<DrillKind>,
}

impl UndisturbedRun {
    /// Sets an episode up, to be forked where a phase begins.
    ///
    /// # Errors
    /// If the episode has no valid start.
    pub fn begin(
        worker: &mut Worker,
        trial: &TrialCase<'_>,
        phase: Option<WorkPhase>,
    ) -> Result<Self, CellError> {
        let arm = worker.arm(trial.cell, &trial.setup())?;
        // Of a call that the dispatcher refuses no tick is reached.
        let trace = (!trial.is_admitted(arm)).then(WorkTrace::default);
        let start = trial.cell.spec.abilities.export_state.then(|| arm.body().copy()).transpose()?;
        Ok(Self { start, phase, forks: Vec::new(), trace, drilled: Vec::new() })
    }

    /// The worker's arm where the work begins.
    fn arm_at_start<'a>(
        &self,
        worker: &'a mut Worker,
        trial: &TrialCase<'_>,
    ) -> Result<&'a mut TrialArm, CellError> {
        match &self.start {
            Some(start) => worker.arm_from(trial.cell, start),
            None => worker.arm(trial.cell, &trial.setup()),
        }
    }

    /// What the whole work shows, worked to its end if it was not yet.
    ///
    /// # Errors
    /// If the world fails.
    pub fn trace(&mut self, worker: &mut Worker, trial: &TrialCase<'_>) -> Result<&WorkTrace, CellError> {
        if self.trace.is_none() {
            let mut trace = WorkTrace::default();
            let mut run = trial.start();
            let arm = self.arm_at_start(worker, trial)?;
            let mut phases = PhaseWatch::new(arm.body().as_ref());
            while run.stage() == TaskStage::Working {
                run.tick(&mut arm.handle(), &mut |handle, passed| {
                    let phase = phases.observe(handle.body().as_ref());
                    if works(passed.command) {
                        trace.note(phase, phases.hangs(), passed.seen);
                    }
                    Supervision::Continue
                })?;
                let at = trace.ticks();
                let begins = at >= POINT_MIN && self.phase.is_some() && trace.phase_at(at) == self.phase;
                if begins
                    && self.start.is_some()
                    && self.forks.is_empty()
                    && run.stage() == TaskStage::Working
                    && let Some(run) = run.fork()
                {
                    self.forks.push(ForkPoint { tick: at, world: arm.body().copy()?, run });
                }
            }
            self.trace = Some(trace);
        }
        self.trace
            .as_ref()
            .ok_or_else(|| CellError::Worker { item: 0, message: "it has no trace".to_owned() })
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
    ) -> Result<Option<TaskRun>, CellError> {
        if self.trace.as_ref().is_some_and(|trace| point > trace.ticks()) {
            return Ok(None);
        }
        let fork = self.forks.iter().rev().find(|fork| fork.tick <= point);
        let forked = fork.and_then(|fork| Some((&fork.world, fork.tick, fork.run.fork()?)));
        let (arm, at, mut run) = match forked {
            Some((world, at, run)) => (worker.arm_from(trial.cell, world)?, at, run),
            None => (self.arm_at_start(worker, trial)?, 0, trial.start()),
        };
        if at == point {
            return Ok(Some(run));
        }
        let mut is_there = false;
        let reached = run.run_until(&mut arm.handle(), &mut |passed| {
            is_there = works(passed.command) && passed.tick >= point;
            is_there || !works(passed.command)
        })?;
        Ok((reached && is_there).then_some(run))
    }

    /// How often it was forked so far.
    #[cfg(test)]
    #[must_use]
    pub const fn forks(&self) -> usize {
        self.forks.len()
    }

    /// Notes that a kind of drill was run on it. Returns whether one is left.
    pub fn note_drilled(&mut self, kind: DrillKind) -> bool {
        self.drilled.push(kind);
        DrillKind::ALL.iter().any(|kind| !self.drilled.contains(kind))
    }
}

/// Whether a skill still works after its command.
const fn works(command: &Command) -> bool {
    !matches!(command, Command::Done | Command::Fail { .. })
}

/// The most works kept at a time: two versions and two slices of seeds, with room to spare.
const RUNS_MAX: usize = 64;

/// Undisturbed works between two drills, the one kept longest given up first.
#[derive(Default)]
pub struct UndisturbedCache {
    runs: Mutex<VecDeque<(Digest, UndisturbedRun)>>,
}

impl UndisturbedCache {
    /// An empty one.
    #[must_use]
    pub const fn new() -> Self {
        Self { runs: Mutex::new(VecDeque::new()) }
    }

    /// Takes out what is kept under a key.
    #[must_use]
    pub fn take(&self, key: &Digest) -> Option<UndisturbedRun> {
        let mut runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        let at = runs.iter().position(|(known, _)| known == key)?;
        runs.remove(at).map(|(_, work)| work)
    }

    /// Keeps a work.
    pub fn put(&self, key: Digest, work: UndisturbedRun) {
        let mut runs = self.runs.lock().unwrap_or_else(PoisonError::into_inner);
        if runs.len() >= RUNS_MAX {
            runs.pop_front();
        }
        runs.push_back((key, work));
    }
}
