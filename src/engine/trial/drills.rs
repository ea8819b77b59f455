//! Recovery drills: rehearsals in the sandbox, at random points of the work.
//!
//! Passes are read from joint speeds, contacts and poses, never from what a hook returns. What is
//! injected is the simulator's own kind of fault; what the watcher names is the runtime's: the two
//! share no type. Sources: paper section 4.4, `rho = g(rollback, fallback, abort, detect)`; design
//! rule 3.5.

use holdpoint_body::{Command, GuardVerdict, RATE_HZ, Telemetry};
use holdpoint_sim::SimError;
use holdpoint_sim::episode::EpisodeSetup;
use holdpoint_sim::fault::InjectedFault;
use holdpoint_sim::rng::{Stream, StreamPurpose as StreamOf};
use holdpoint_sim::world::World;
use serde::{Deserialize, Serialize};

use super::episodes::Worker;
use crate::cell::{Cell, Conditions};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::{ActuatorHandle, Arm};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::recovery::{self, Standstill, StoppedBy};
use holdpoint_runtime::skill::{Hook, Skill};
use holdpoint_runtime::task::{self, Supervision};
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
    let (stream, mut point) = first_point(kind, seed);
    // The last tick of the work, once it is known: a later point is not reached, and not tried.
    let mut worked = u64::MAX;
    for _ in 0..POINT_TRIES {
        if point <= worked {
            match attempt(worker, cell, terms, cast, kind, seed, point, &mut stream.clone()) {
                Ok(Attempt::Drilled(true)) => return DrillResult::Passed,
                Ok(Attempt::Drilled(false)) => return DrillResult::Failed,
                Ok(Attempt::OverBefore { worked: last }) => worked = last,
                Err(_) => return DrillResult::Infeasible,
            }
        }
        point = (point / 2).max(POINT_MIN);
    }
    DrillResult::Infeasible
}

/// The point that is tried first, ticks, and the stream that the drill draws the rest from.
fn first_point(kind: DrillKind, seed: u64) -> (Stream, u64) {
    let mut stream = Stream::new(seed ^ (kind as u64 + 1).wrapping_mul(0x9e37_79b9), StreamOf::Drill);
    let (from, to) = POINT_TICKS;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_precision_loss)]
    let point = stream.uniform(from as f64, to as f64) as u64;
    (stream, point)
}

/// What became of a drill at one point.
enum Attempt {
    /// It was worked, and passed or not.
    Drilled(bool),
    /// The work was over before the point.
    OverBefore {
        /// Its last tick.
        worked: u64,
    },
}

#[allow(clippy::too_many_arguments, reason = "one call site, all of them needed")]
fn attempt(
    worker: &mut Worker,
    cell: &Cell,
    terms: &SkillTerms,
    cast: &Cast<'_>,
    kind: DrillKind,
    seed: u64,
    point: u64,
    stream: &mut Stream,
) -> Result<Attempt, SimError> {
    let version = cast.version;
    let task = version.bundle.task();
    let setup = EpisodeSetup::sample(task, &cell.scene, cell.distribution(Conditions::Canonical), seed);
    let arm = worker.arm(cell, &setup)?;
    let mut guard = terms.guard(version.manifest.permissions.authority);
    let mut skill = version.bundle.start(seed);
    let (mut reached, mut worked) = (false, 0);
    let task_terms = terms.task(task, seed, version.abort_secs());
    task::run(&mut arm.handle(), skill.as_mut(), &mut guard, &task_terms, &mut |_, passed| {
        if !passed.settling && !matches!(passed.command, Command::Done | Command::Fail { .. }) {
            worked = passed.tick;
            reached = passed.tick >= point;
        }
        if reached { Supervision::Release } else { Supervision::Continue }
    })?;
    if !reached {
        return Ok(Attempt::OverBefore { worked });
    }
    let mut rehearsal = StartedDrill { arm, guard, terms, cast, seed };
    match kind {
        DrillKind::Abort => rehearsal.abort(skill.as_mut()),
        DrillKind::Rollback => rehearsal.rollback(skill.as_mut()),
        DrillKind::Fallback => rehearsal.fallback(skill.as_mut()),
        DrillKind::Detect => rehearsal.detect(skill.as_mut(), stream),
    }
    .map(Attempt::Drilled)
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
        let task = self.cast.version.bundle.task();
        let mut watcher = Watcher::new(task, *self.terms.watch());
        let report = recovery::abort(
            &mut self.arm.handle(),
            skill,
            &mut self.guard,
            &mut watcher,
            self.cast.version.abort_secs(),
        )?;
        let after = self.arm.body().telemetry();
        Ok(report.stopped_by == StoppedBy::Hook
            && report.violation.is_none()
            && !watcher.has(WatcherSignal::UnexpectedContact)
            && safe_pose(held, &after))
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
        let mut watcher = Watcher::new(self.cast.version.bundle.task(), *self.terms.watch());
        let secs = self.cast.version.abort_secs();
        let report = recovery::abort(&mut self.arm.handle(), skill, &mut self.guard, &mut watcher, secs)?;
        self.arm.body_mut().interrupt(holdpoint_body::Interrupt::Release);
        let stopped = report.stopped_by != StoppedBy::Nothing && report.violation.is_none();
        Ok(stopped && self.take_over(fallback, false)? && safe_pose(held, &self.arm.body().telemetry()))
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
        let mut guard = self.terms.guard(next.manifest.permissions.authority);
        let mut skill = next.bundle.start(self.seed);
        let terms = self.terms.task(self.cast.version.bundle.task(), self.seed, next.abort_secs());
        let record = task::run(&mut self.arm.handle(), skill.as_mut(), &mut guard, &terms, &mut |_, _| {
            Supervision::Continue
        })?;
        let safe = !record.violation && record.hard_stop.is_none();
        Ok(safe && if succeed { record.success } else { !record.recovery })
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
mod tests {
    use super::*;
    use crate::embedded::baselines;
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use std::sync::Arc;

    /// As [`drill`], but every point is tried from the start, as if nothing were known of the work's length.
    fn every_point(
        worker: &mut Worker,
        cell: &Cell,
        terms: &SkillTerms,
        cast: &Cast<'_>,
        kind: DrillKind,
        seed: u64,
    ) -> (DrillResult, u32) {
        let (stream, mut point) = first_point(kind, seed);
        for over in 0..POINT_TRIES {
            match attempt(worker, cell, terms, cast, kind, seed, point, &mut stream.clone()) {
                Ok(Attempt::Drilled(true)) => return (DrillResult::Passed, over),
                Ok(Attempt::Drilled(false)) => return (DrillResult::Failed, over),
                Ok(Attempt::OverBefore { .. }) => point = (point / 2).max(POINT_MIN),
                Err(_) => return (DrillResult::Infeasible, over),
            }
        }
        (DrillResult::Infeasible, POINT_TRIES)
    }

    #[test]
    fn a_point_that_cannot_be_reached_is_passed_over_without_another_result() {
        let cell = Cell::builtin().unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let versions = baselines().unwrap();
        let of =
            |family: &str| versions.iter().find(|version| version.id().family.as_str() == family).unwrap();
        let (place, park) = (of("place"), of("park"));
        let cast = Cast { version: place, predecessor: place, fallback: Some(park) };
        let mut worker = Worker::new();
        let mut over = 0;
        for seed in 1_200_000..1_200_012 {
            for kind in DrillKind::ALL {
                let (expected, tries) = every_point(&mut worker, &cell, &terms, &cast, kind, seed);
                assert_eq!(drill(&mut worker, &cell, &terms, &cast, kind, seed), expected, "{kind:?} {seed}");
                over += u32::from(tries > 0);
            }
        }
        assert!(over > 0, "no drill had a point behind the work's end: nothing was tried");
    }
}
