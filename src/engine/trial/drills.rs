//! Recovery drills: rehearsals in the sandbox, at random points of the work.
//!
//! Passes are read from joint speeds, contacts and poses, never from what a hook returns. What is
//! injected is the simulator's own kind of fault; what the watcher names is the runtime's: the two
//! share no type. Sources: paper section 4.4, `rho = g(rollback, fallback, abort, detect)`; design
//! rule 3.5.

use holdpoint_body::{Command, GuardVerdict, RATE_HZ, Telemetry};
use holdpoint_sim::SimError;
use holdpoint_sim::fault::InjectedFault;
use holdpoint_sim::rng::{Stream, StreamPurpose as StreamOf};
use holdpoint_sim::world::World;
use serde::{Deserialize, Serialize};

use super::undisturbed::{TrialCase, Undisturbed};
use super::worker::Worker;
use crate::cell::{Cell, Conditions};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::{ActuatorHandle, Arm};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::recovery::{AbortRun, Standstill, StoppedBy};
use holdpoint_runtime::skill::{Hook, Skill};
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
pub struct Cast<'a> {
    /// The version that is drilled.
    pub version: &'a Capability,
    /// The version it would be rolled back to; for the active version, itself.
    pub predecessor: &'a Capability,
    /// What its manifest binds as a fallback, if that is in the registry.
    pub fallback: Option<&'a Capability>,
}

/// Earliest and latest point of a drill, ticks: after the first decision, before most work is done.
const POINT_TICKS: (u64, u64) = (48, 480);

/// Longest time a rollback hook may take, ticks.
const HANDOVER_TICKS: u64 = 3 * RATE_HZ as u64;

/// The earliest point that is tried, ticks.
const POINT_MIN: u64 = 12;

/// Tries to find a point at which the version still works.
const POINT_TRIES: u32 = 4;

/// Runs one drill. Equal seeds give equal episodes and equal points for every version.
#[must_use]
pub fn drill(
    worker: &mut Worker,
    cell: &Cell,
    terms: &SkillTerms,
    cast: &Cast<'_>,
    kind: DrillKind,
    seed: u64,
) -> DrillResult {
    let case = DrillCase { cell, terms, cast, kind, seed };
    case.run(worker, &mut None, &[kind])
}

/// One drill of a version, and where it takes place.
#[derive(Clone, Copy)]
pub struct DrillCase<'a> {
    pub cell: &'a Cell,
    pub terms: &'a SkillTerms,
    pub cast: &'a Cast<'a>,
    pub kind: DrillKind,
    pub seed: u64,
}

impl DrillCase<'_> {
    /// Works it. What is undisturbed of it is gone on from if it is given, and left behind for the other kinds of
    /// drill among `kinds`, which begin with the same work. The result is the same either way.
    #[must_use]
    pub fn run(
        &self,
        worker: &mut Worker,
        shared: &mut Option<Undisturbed>,
        kinds: &[DrillKind],
    ) -> DrillResult {
        let trial = self.trial();
        let begun = match shared.take() {
            Some(begun) => Ok(begun),
            None => {
                let points = kinds.iter().map(|kind| first_point(*kind, self.seed).1).collect();
                Undisturbed::begin(worker, &trial, points)
            }
        };
        let Ok(mut work) = begun else { return DrillResult::Infeasible };
        let (stream, mut point) = first_point(self.kind, self.seed);
        for _ in 0..POINT_TRIES {
            match work.reach(worker, &trial, point) {
                Ok(Some(run)) => {
                    let passed = self.at_point(worker, run, stream);
                    *shared = Some(work);
                    return match passed {
                        Ok(true) => DrillResult::Passed,
                        Ok(false) => DrillResult::Failed,
                        Err(_) => DrillResult::Infeasible,
                    };
                }
                Ok(None) => point = (point / 2).max(POINT_MIN),
                Err(_) => return DrillResult::Infeasible,
            }
        }
        *shared = Some(work);
        DrillResult::Infeasible
    }

    /// The work it begins with.
    #[must_use]
    pub fn trial(&self) -> TrialCase<'_> {
        let Self { cell, terms, cast, seed, .. } = *self;
        TrialCase { cell, terms, version: cast.version, conditions: Conditions::Canonical, seed }
    }

    /// The drill itself, from where the worker's arm stands.
    fn at_point(&self, worker: &mut Worker, run: TaskRun, mut stream: Stream) -> Result<bool, SimError> {
        let arm = worker.built_arm()?;
        let (mut skill, guard) = run.into_skill_and_guard();
        let Self { terms, cast, seed, .. } = *self;
        let mut drill = StartedDrill { arm, guard, terms, cast, seed };
        match self.kind {
            DrillKind::Abort => drill.abort(skill.as_mut()),
            DrillKind::Rollback => drill.rollback(skill.as_mut()),
            DrillKind::Fallback => drill.fallback(skill.as_mut()),
            DrillKind::Detect => drill.detect(skill.as_mut(), &mut stream),
        }
    }
}

/// The point that is tried first, ticks, and the stream that the drill draws the rest from.
fn first_point(kind: DrillKind, seed: u64) -> (Stream, u64) {
    let mut stream = Stream::new(seed ^ (kind as u64 + 1).wrapping_mul(0x9e37_79b9), StreamOf::Drill);
    let (from, to) = POINT_TICKS;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    let point = stream.uniform(from as f64, to as f64) as u64;
    (stream, point)
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
    arm: &'a mut Arm<World>,
    guard: Guard,
    terms: &'a SkillTerms,
    cast: &'a Cast<'b>,
    seed: u64,
}

impl StartedDrill<'_, '_> {
    /// Standstill in a safe pose within the declared time, without a violation, by the hook alone.
    fn abort(&mut self, skill: &mut dyn Skill) -> Result<bool, SimError> {
        let held = holds_object(&self.arm.body().telemetry());
        Ok(self.stop(skill, StopRule::HookAlone)? && safe_pose(held, &self.arm.body().telemetry()))
    }

    /// Whether the arm is stopped as it must be. Ends as soon as it is certain that it is not: what follows could
    /// change nothing but a failed drill into one that failed and in which the simulator failed as well.
    fn stop(&mut self, skill: &mut dyn Skill, rule: StopRule) -> Result<bool, SimError> {
        let version = self.cast.version;
        let mut watcher = Watcher::new(version.bundle.task(), *self.terms.watch());
        let mut abort = AbortRun::begin(skill, version.abort_secs());
        let mut handle = self.arm.handle();
        loop {
            let ended = abort.step(&mut handle, skill, &mut self.guard, &mut watcher)?;
            let touched = rule == StopRule::HookAlone && watcher.has(WatcherSignal::UnexpectedContact);
            if abort.violation().is_some() || touched {
                return Ok(false);
            }
            if let Some(report) = ended {
                return Ok(match report.stopped_by {
                    StoppedBy::Hook => true,
                    StoppedBy::Interrupt => rule == StopRule::HookOrInterrupt,
                    StoppedBy::Nothing => false,
                });
            }
            if rule == StopRule::HookAlone && abort.is_past_hook() {
                return Ok(false);
            }
        }
    }

    /// The hook hands over, the predecessor is admitted and goes on from there to its end.
    fn rollback(&mut self, skill: &mut dyn Skill) -> Result<bool, SimError> {
        let held = holds_object(&self.arm.body().telemetry());
        if !self.hand_over(skill)? || !safe_pose(held, &self.arm.body().telemetry()) {
            return Ok(false);
        }
        self.take_over(self.cast.predecessor, true)
    }

    /// The safe-abort hook stops the arm, the bound fallback takes over and ends safely.
    fn fallback(&mut self, skill: &mut dyn Skill) -> Result<bool, SimError> {
        let Some(fallback) = self.cast.fallback else { return Ok(false) };
        let held = holds_object(&self.arm.body().telemetry());
        if !self.stop(skill, StopRule::HookOrInterrupt)? {
            return Ok(false);
        }
        self.arm.body_mut().interrupt(holdpoint_body::Interrupt::Release);
        Ok(self.take_over(fallback, false)? && safe_pose(held, &self.arm.body().telemetry()))
    }

    /// A fault is injected; the watcher, or the skill by a declared signal, names it in time.
    fn detect(&mut self, skill: &mut dyn Skill, stream: &mut Stream) -> Result<bool, SimError> {
        let held = holds_object(&self.arm.body().telemetry());
        let (fault, named_by) = choose_fault(held, stream);
        self.arm.body_mut().inject(fault);
        let task = self.cast.version.bundle.task();
        let mut watcher = Watcher::new(task, *self.terms.watch());
        let declared = &self.cast.version.manifest.recovery.failure_signals;
        let mut verdict = GuardVerdict::Allowed;
        let mut handle = self.arm.handle();
        let mut seen = handle.telemetry();
        for _ in 0..self.terms.detect_ticks {
            let observation = handle.observe(verdict);
            let asked = skill.tick(&observation);
            if let Command::Fail { signal } = &asked {
                return Ok(declared.contains(signal));
            }
            let checked = self.guard.check(&asked, &seen);
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

    /// Lets the rollback hook work until it says it is done and the arm stands.
    fn hand_over(&mut self, skill: &mut dyn Skill) -> Result<bool, SimError> {
        if self.cast.version.manifest.recovery.rollback_hook.is_none() {
            return Ok(false);
        }
        skill.enter(Hook::Rollback);
        let mut verdict = GuardVerdict::Allowed;
        let mut handle = self.arm.handle();
        let mut seen = handle.telemetry();
        for _ in 0..HANDOVER_TICKS {
            let observation = handle.observe(verdict);
            let asked = skill.tick(&observation);
            let checked = self.guard.check(&asked, &seen);
            verdict = checked.verdict;
            handle.step(&checked.command)?;
            seen = handle.telemetry();
            if self.guard.measure(&seen).is_some() {
                return Ok(false);
            }
            if matches!(asked, Command::Done) {
                return settle(&mut handle);
            }
        }
        Ok(false)
    }

    /// Another version takes the arm over where it stands. `succeed` asks for the work to be done,
    /// otherwise a safe end is enough.
    fn take_over(&mut self, next: &Capability, succeed: bool) -> Result<bool, SimError> {
        self.arm.body_mut().begin_task(self.cast.version.bundle.task());
        if admit(&next.manifest, &self.arm.body().telemetry()).is_err() {
            return Ok(false);
        }
        let guard = self.terms.guard(&next.manifest.permissions);
        let terms = self.terms.task(self.cast.version.bundle.task(), self.seed, next.abort_secs());
        let mut run = TaskRun::new(next.start(self.terms.bundle_seed(self.seed)), guard, terms);
        let mut handle = self.arm.handle();
        loop {
            let stage = run.tick(&mut handle, &mut |_, _| Supervision::Continue)?;
            let record = run.record();
            // None of the three is ever taken back, so the rest of the work can change nothing.
            if record.violation || record.recovery || record.hard_stop.is_some() {
                return Ok(false);
            }
            if stage == TaskStage::Over {
                return Ok(record.success || !succeed);
            }
        }
    }
}

/// Stops the arm (a redundant arm may go on turning about a tool that stands) and waits up to half
/// a second for a standstill.
fn settle(handle: &mut ActuatorHandle<'_, World>) -> Result<bool, SimError> {
    handle.step(&Command::Stop)?;
    let mut standstill = Standstill::default();
    for _ in 0..RATE_HZ / 2 {
        handle.step(&Command::Hold)?;
        if standstill.observe(&handle.telemetry()) {
            return Ok(true);
        }
    }
    Ok(false)
}

fn holds_object(seen: &Telemetry) -> bool {
    seen.contacts.pad_object && seen.gripper_force_n > 1.0
}

/// Nothing is touched that should not be, and what was in the hand was not let fall.
fn safe_pose(held_before: bool, seen: &Telemetry) -> bool {
    let contacts = &seen.contacts;
    let touches = contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot;
    // An object may be let go if it stands on something.
    let dropped = held_before && !holds_object(seen) && !contacts.object_fixture;
    let thrown = held_before && !holds_object(seen) && seen.tool.position[2] > 0.06;
    !touches && !dropped && !thrown
}

/// Picks a fault that can be noticed in the present state, and the signals that name it.
fn choose_fault(held: bool, stream: &mut Stream) -> (InjectedFault, &'static [WatcherSignal]) {
    let pick = stream.uniform(0.0, 1.0);
    if held {
        if pick < 0.5 {
            (InjectedFault::GripLost, &[WatcherSignal::ObjectLost, WatcherSignal::ObjectSlip])
        } else {
            (InjectedFault::JointStuck { joint: 3 }, &[WatcherSignal::TrackingError])
        }
    } else if pick < 0.34 {
        (InjectedFault::CameraLost, &[WatcherSignal::StaleInput])
    } else if pick < 0.67 {
        (InjectedFault::JointStuck { joint: 3 }, &[WatcherSignal::TrackingError])
    } else {
        (InjectedFault::ToolDead, &[WatcherSignal::ToolLost, WatcherSignal::GripFault])
    }
}

#[cfg(test)]
mod tests;
