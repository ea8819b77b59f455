//! Recovery drills: fault-injection tests in the sandbox, at random points of every phase.
//!
//! Passes are read from joint speeds, contacts, poses and the object's fate, never from what a hook returns. What is
//! injected is the cell's own kind of fault; what the watcher names is the runtime's: the two
//! share no type. Sources: paper section 4.4, `rho = g(rollback, fallback, abort, detect)`; design
//! rule 3.5.

pub mod fate;
mod faults;
pub mod phases;

use holdpoint_body::{Body, Command, GuardVerdict, Interrupt, RATE_HZ, Standstill};
use holdpoint_cell::CellError;
use holdpoint_cell::rng::{Stream, StreamPurpose as StreamOf};
use serde::{Deserialize, Serialize};

use self::fate::{ObjectWatch, WATCH_TICKS};
use self::faults::{DetectionWindow, NamedFault};
use super::undisturbed_run::{TrialCase, UndisturbedRun};
use super::worker::{TrialArm, Worker};
use crate::cell::{Cell, Conditions};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::handover;
use holdpoint_runtime::recovery::{AbortRun, ROLLBACK_HOOK_TICKS, StoppedBy};
use holdpoint_runtime::skill::{Hook, Skill, next_command};
use holdpoint_runtime::task::{Supervision, TaskRun, TaskStage};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_runtime::watcher::{Watcher, WatcherSignal};

/// How a drill ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DrillResult {
    Passed,
    /// Not as it should.
    Failed,
    /// It could not be set up; says nothing.
    Infeasible,
}

/// Who takes part in a drill.
#[derive(Clone, Copy)]
pub struct DrillVersions<'a> {
    /// The version that is drilled.
    pub version: &'a Capability,
    /// The version it would be rolled back to; for the active version, itself.
    pub predecessor: &'a Capability,
    /// What its manifest binds as a fallback, if that is in the registry.
    pub fallback: Option<&'a Capability>,
}

/// Time for which the drill watches an arm after its hook reports done, before it stops the arm, ticks: 100 ms.
const DONE_TICKS: u64 = RATE_HZ as u64 / 10;

/// Runs one drill at a point of the whole work. Equal seeds give equal episodes and equal points for every version.
#[must_use]
pub fn drill(
    worker: &mut Worker,
    cell: &Cell,
    terms: &SkillTerms,
    cast: &DrillVersions<'_>,
    kind: DrillKind,
    seed: u64,
) -> DrillResult {
    DrillCase { cell, terms, cast, kind, phase: None, seed }.run(worker, &mut None)
}

/// One drill of a version, and where it takes place.
#[derive(Clone, Copy)]
pub struct DrillCase<'a> {
    pub cell: &'a Cell,
    pub terms: &'a SkillTerms,
    pub cast: &'a DrillVersions<'a>,
    pub kind: DrillKind,
    /// The phase of the work in which it begins; any, if none is named.
    pub phase: Option<WorkPhase>,
    pub seed: u64,
}

impl DrillCase<'_> {
    /// Works it. What is undisturbed of it is gone on from if it is given, and left behind for the other kinds of
    /// drill in the same phase. The result is the same either way. Infeasible where the version never comes to the
    /// phase under this seed.
    #[must_use]
    pub fn run(&self, worker: &mut Worker, shared: &mut Option<UndisturbedRun>) -> DrillResult {
        self.run_from(worker, shared).0
    }

    /// As [`DrillCase::run`], and the tick of the episode at which the drill began; absent if it did not begin.
    #[must_use]
    pub fn run_from(
        &self,
        worker: &mut Worker,
        shared: &mut Option<UndisturbedRun>,
    ) -> (DrillResult, Option<u64>) {
        let (mut from, is_begun) = (None, shared.is_some());
        let mut worked = self.work(worker, shared, &mut from);
        if is_begun && matches!(worked, Err(CellError::Snapshot(_))) {
            // A restarted cell has lost the states of the shared run.
            (*shared, from) = (None, None);
            worked = self.work(worker, shared, &mut from);
        }
        let result = match worked {
            Ok(Some(true)) => DrillResult::Passed,
            Ok(Some(false)) => DrillResult::Failed,
            Ok(None) => DrillResult::Infeasible,
            Err(error) => {
                worker.note_failure(error);
                DrillResult::Infeasible
            }
        };
        (result, from)
    }

    fn work(
        &self,
        worker: &mut Worker,
        shared: &mut Option<UndisturbedRun>,
        from: &mut Option<u64>,
    ) -> Result<Option<bool>, CellError> {
        let trial = self.trial();
        let work = match shared.take() {
            Some(begun) => begun,
            None => UndisturbedRun::begin(worker, &trial, self.phase)?,
        };
        let work = shared.insert(work);
        let trace = work.trace(worker, &trial)?;
        let mut stream = self.stream();
        let Some(point) = self.point(&trace.points(self.phase), &mut stream) else { return Ok(None) };
        let fault = match self.kind {
            DrillKind::Detect => {
                let (within, limits) = (self.terms.detect_ticks, self.terms.watch());
                let held = trace.is_held(point);
                DetectionWindow { trace, point, within, limits, held }.sample(&mut stream)
            }
            DrillKind::Rollback | DrillKind::Fallback | DrillKind::Abort => None,
        };
        match work.reach(worker, &trial, point)? {
            Some(run) => {
                *from = Some(point);
                self.at_point(worker, run, fault)
            }
            None => Ok(None),
        }
    }

    /// The work it begins with.
    #[must_use]
    pub fn trial(&self) -> TrialCase<'_> {
        let Self { cell, terms, cast, seed, .. } = *self;
        TrialCase { cell, terms, version: cast.version, conditions: Conditions::Canonical, seed }
    }

    /// What the point, then the rest of the drill, is drawn from.
    fn stream(&self) -> Stream {
        Stream::new(self.seed ^ (self.kind as u64 + 1).wrapping_mul(0x9e37_79b9), StreamOf::Drill)
    }

    /// One of the ticks at which it may begin, drawn evenly. None if the work shows the phase too shortly.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    fn point(&self, points: &[u64], stream: &mut Stream) -> Option<u64> {
        let at = stream.uniform(0.0, points.len() as f64) as usize;
        let shown = self.phase.is_none() || points.len() >= WorkPhase::SHOWN_TICKS;
        points.get(at.min(points.len().saturating_sub(1))).copied().filter(|_| shown)
    }

    /// The drill itself, from the worker's present arm state. `None`: there is nothing to test.
    fn at_point(
        &self,
        worker: &mut Worker,
        run: TaskRun,
        fault: Option<NamedFault>,
    ) -> Result<Option<bool>, CellError> {
        let arm = worker.built_arm()?;
        let (mut skill, guard, watcher) = run.into_parts();
        let Self { terms, cast, seed, .. } = *self;
        let grip_max_n = guard.envelope().grip_force_max_n;
        let object = ObjectWatch::new(arm.body().as_ref(), grip_max_n, terms.profile());
        let mut drill = StartedDrill { arm, guard, terms, cast, seed, object };
        match (self.kind, fault) {
            (DrillKind::Abort, _) => drill.abort(skill.as_mut()).map(Some),
            (DrillKind::Rollback, _) => drill.rollback(skill.as_mut()).map(Some),
            (DrillKind::Fallback, _) => drill.fallback(skill.as_mut()).map(Some),
            // What was named before the fault is not named again, and an error that is there is none of the fault's.
            (DrillKind::Detect, Some((_, named_by))) if named_by.iter().any(|by| watcher.has(*by)) => {
                Ok(None)
            }
            (DrillKind::Detect, Some(fault)) => drill.detect(skill.as_mut(), watcher, fault).map(Some),
            (DrillKind::Detect, None) => Ok(None),
        }
    }
}

/// What counts as a stop of the arm; without a violation either way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StopRule {
    /// By the version's hook, in its declared time and without unexpected contact.
    HookAlone,
    HookOrInterrupt,
}

/// A drill from the chosen point on.
struct StartedDrill<'a, 'b> {
    arm: &'a mut TrialArm,
    guard: Guard,
    terms: &'a SkillTerms,
    cast: &'a DrillVersions<'b>,
    seed: u64,
    object: ObjectWatch,
}

impl StartedDrill<'_, '_> {
    /// Standstill in a safe pose within the declared time, without a violation, by the hook alone, and nothing done
    /// to the object then or in the time after it.
    fn abort(&mut self, skill: &mut dyn Skill) -> Result<bool, CellError> {
        Ok(self.stop(skill, StopRule::HookAlone)? && self.ends_safely()?)
    }

    /// Whether the arm is stopped as it must be. Ends as soon as it is certain that it is not: what follows could
    /// change nothing but a failed drill into one that failed and in which the cell failed as well.
    fn stop(&mut self, skill: &mut dyn Skill, rule: StopRule) -> Result<bool, CellError> {
        let version = self.cast.version;
        let mut watcher = Watcher::new(version.bundle.task(), *self.terms.watch());
        let mut abort = AbortRun::begin(skill, version.abort_secs());
        let mut handle = self.arm.handle();
        loop {
            let ended = abort.step(&mut handle, skill, &mut self.guard, &mut watcher)?;
            self.object.observe(handle.body().as_ref());
            let touched = rule == StopRule::HookAlone && watcher.has(WatcherSignal::UnexpectedContact);
            if abort.violation().is_some() || touched || self.object.harm().is_some() {
                return Ok(false);
            }
            if let Some(report) = ended {
                return Ok(match report.stopped_by {
                    StoppedBy::Hook => true,
                    StoppedBy::Interrupt => rule == StopRule::HookOrInterrupt,
                    // An abort calls no rollback hook.
                    StoppedBy::RollbackHook | StoppedBy::Nothing => false,
                });
            }
            if rule == StopRule::HookAlone && abort.is_past_hook() {
                return Ok(false);
            }
        }
    }

    /// Holds the arm in place, as the live ladder does, and checks the fate of the object.
    fn ends_safely(&mut self) -> Result<bool, CellError> {
        let mut handle = self.arm.handle();
        handle.interrupt(Interrupt::Stop);
        for _ in 0..WATCH_TICKS {
            handle.step(&Command::Hold)?;
            self.object.observe(handle.body().as_ref());
            if self.object.harm().is_some() {
                return Ok(false);
            }
        }
        let world = handle.body().as_ref();
        Ok(self.object.fate(world).is_safe() && !handover::touches(world.true_state().forces.contacts))
    }

    /// The hook hands over in a pose that is safe, and from where it left arm and object the predecessor goes on to its
    /// end; where nothing is left to do, it is ready.
    fn rollback(&mut self, skill: &mut dyn Skill) -> Result<bool, CellError> {
        if !self.hand_over(skill)? || handover::touches(self.arm.body().true_state().forces.contacts) {
            return Ok(false);
        }
        let passed = if self.arm.body().inspect() {
            let task = self.cast.version.bundle.task();
            self.arm.body_mut().begin_task(task);
            let mut next = self.cast.predecessor.start(self.terms.bundle_seed(self.seed));
            let mut guard = self.terms.guard(&self.cast.predecessor.manifest.permissions);
            handover::ready(&mut self.arm.handle(), &mut guard, next.as_mut())?.failure.is_none()
        } else {
            self.take_over(self.cast.predecessor, true)?
        };
        Ok(passed && self.ends_safely()?)
    }

    /// The safe-abort hook stops the arm, the bound fallback takes over and ends safely.
    fn fallback(&mut self, skill: &mut dyn Skill) -> Result<bool, CellError> {
        let Some(fallback) = self.cast.fallback else { return Ok(false) };
        if !self.stop(skill, StopRule::HookOrInterrupt)? {
            return Ok(false);
        }
        self.arm.body_mut().interrupt(Interrupt::Release);
        Ok(self.take_over(fallback, false)? && self.ends_safely()?)
    }

    /// A fault is injected; the watcher that has seen the work so far, or the skill by a declared signal, names it in
    /// time.
    fn detect(
        &mut self,
        skill: &mut dyn Skill,
        mut watcher: Watcher,
        (fault, named_by): NamedFault,
    ) -> Result<bool, CellError> {
        self.arm.body_mut().inject(fault);
        let declared = &self.cast.version.manifest.recovery.failure_signals;
        let mut verdict = GuardVerdict::Allowed;
        let mut handle = self.arm.handle();
        let mut seen = handle.telemetry();
        for _ in 0..self.terms.detect_ticks {
            let observation = handle.observe(verdict);
            let command = next_command(skill, &observation)?;
            if let Command::Fail { signal } = &command {
                return Ok(declared.contains(signal));
            }
            let checked = self.guard.check(&command, &seen);
            verdict = checked.verdict;
            watcher.note_command(&checked.command, &seen);
            handle.step(&checked.command)?;
            seen = handle.telemetry();
            if watcher.observe(&seen).iter().any(|signal| named_by.contains(signal)) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Lets the rollback hook work until it says it is done. The arm has to stand by then: who takes over a live arm
    /// that moves meets it where it is not.
    fn hand_over(&mut self, skill: &mut dyn Skill) -> Result<bool, CellError> {
        if !self.cast.version.has_rollback_hook() {
            return Ok(false);
        }
        skill.enter(Hook::Rollback);
        let mut verdict = GuardVerdict::Allowed;
        let mut seen = self.arm.body().telemetry();
        for _ in 0..ROLLBACK_HOOK_TICKS {
            let mut handle = self.arm.handle();
            let observation = handle.observe(verdict);
            let command = next_command(skill, &observation)?;
            let checked = self.guard.check(&command, &seen);
            verdict = checked.verdict;
            handle.step(&checked.command)?;
            seen = handle.telemetry();
            self.object.observe(handle.body().as_ref());
            if self.guard.measure(&seen).is_some() || self.object.harm().is_some() {
                return Ok(false);
            }
            if matches!(command, Command::Done) {
                return self.stops_in_place();
            }
        }
        Ok(false)
    }

    /// Whether the arm comes to a standstill by itself, and within half a second once stopped. A redundant arm may
    /// keep turning about a tool at rest.
    fn stops_in_place(&mut self) -> Result<bool, CellError> {
        let mut handle = self.arm.handle();
        let from = handle.telemetry().tool;
        let standing_m = self.terms.profile().recovery.drill_done_max_m;
        for _ in 0..DONE_TICKS {
            handle.step(&Command::Hold)?;
            self.object.observe(handle.body().as_ref());
        }
        if !(from.distance_m(&handle.telemetry().tool) <= standing_m) {
            return Ok(false);
        }
        handle.step(&Command::Stop)?;
        let mut standstill = Standstill::default();
        for _ in 0..RATE_HZ / 2 {
            handle.step(&Command::Hold)?;
            self.object.observe(handle.body().as_ref());
            if standstill.observe(&handle.telemetry()) {
                return Ok(self.object.harm().is_none());
            }
        }
        Ok(false)
    }

    /// Another version takes over the arm in place. `succeed` requires that the task succeeds; otherwise a safe end
    /// is enough.
    fn take_over(&mut self, next: &Capability, succeed: bool) -> Result<bool, CellError> {
        self.arm.body_mut().begin_task(self.cast.version.bundle.task());
        if admit(&next.manifest, &self.arm.body().telemetry()).is_err() {
            return Ok(false);
        }
        let guard = self.terms.guard(&next.manifest.permissions);
        let terms = self.terms.task(self.cast.version.bundle.task(), self.seed, next.abort_secs());
        let mut run = TaskRun::new(next.start(self.terms.bundle_seed(self.seed)), guard, terms);
        let object = &mut self.object;
        let mut handle = self.arm.handle();
        loop {
            let stage = run.tick(&mut handle, &mut |handle, _| {
                object.observe(handle.body().as_ref());
                Supervision::Continue
            })?;
            let record = run.record();
            // None of them is ever taken back, so the rest of the work can change nothing.
            let lost = record.violation || record.recovery || record.hard_stop.is_some();
            if lost || object.harm().is_some() {
                return Ok(false);
            }
            if stage == TaskStage::Over {
                return Ok(record.success || !succeed);
            }
        }
    }
}

#[cfg(test)]
mod tests;
