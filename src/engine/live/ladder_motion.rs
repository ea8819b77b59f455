//! The rungs of the ladder that move the arm, and the one that checks whether the rollback target is ready.
//!
//! The rollback hook comes first where the version passed its rollback drills; the guide's page on statistics compares the
//! orders. After a standstill the runtime's own retreat clears the arm.
//! Joints, contacts and pose show whether a rung passed; the result of a hook does not count. Decides nothing about the
//! versions; the first rung that fails ends the ladder, and the arm stays stopped.

use holdpoint_body::{Body, BodyError, Command, GuardVerdict, Interrupt, Standstill};
use holdpoint_cell::CellError;

use super::instrumented::InstrumentedWorld;
use super::station::Rig;
use super::supervisor::Trip;
use holdpoint_governance::notice::{Notice, RetreatObstacle};
use holdpoint_governance::profile::RuntimeLimits;
use holdpoint_governance::rollback::{Rung, RungFailure, RungRecord, TriggerKind};
use holdpoint_runtime::arm::ActuatorHandle;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::handover;
use holdpoint_runtime::recovery::{AbortRun, RecoveryReport, StoppedBy};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_runtime::watcher::Watcher;

/// The distance from the end of the retreat at which it ends early, m. What counts as clear is the profile's.
const ARRIVED_M: f64 = 0.01;

/// The result of the rungs that move the arm.
#[derive(Clone, Debug)]
pub(crate) struct LadderMotion {
    /// The rungs that were tried.
    pub(crate) rungs: Vec<RungRecord>,
    /// From the trigger until every joint was at rest, ticks.
    pub(crate) ticks_to_safe: Option<u64>,
    /// From the trigger to the end of the last rung, ticks.
    pub(crate) ticks_since_trigger: u64,
    /// Ticks of the live world that these rungs took; the other ticks since the trigger passed in the task.
    pub(crate) rung_ticks: u64,
    /// Motion after the trigger while a task or a hook was stopped, braking included, ticks.
    pub(crate) motion_ticks: u64,
}

impl LadderMotion {
    /// Whether the ladder continues after these rungs.
    pub(crate) fn continues(&self) -> bool {
        self.rungs.iter().all(RungRecord::continues)
    }
}

impl Rig {
    /// Runs the rungs that move the arm: the version's own hooks if the cause permits it, the interrupt that no version can
    /// refuse, and the retreat. `is_rehearsed`: the version passed its rollback drills. If the supervisor stopped a task in flight, hook or interrupt have stopped the
    /// arm already: the ladder continues from there, and time counts from the tick of that stop.
    pub(crate) fn run_motion_rungs(
        &mut self,
        leaving: &Capability,
        terms: &SkillTerms,
        trip: Option<&Trip>,
        (cause, is_rehearsed): (TriggerKind, bool),
    ) -> Result<LadderMotion, CellError> {
        let now = self.world().tick();
        let trigger_tick = trip.map_or(now, |trip| trip.world_tick.min(now));
        self.arm_mut().body_mut().verdict();
        // The body of a stopped cell takes no command: a hook could hand nothing over.
        let is_rollback_hook_first = is_rehearsed && !self.arm_mut().body().is_halted();
        let mut handle = self.arm_mut().handle();
        let mut guard = terms.guard(&leaving.manifest.permissions);
        let stopped = trip.and_then(|trip| Some((trip, trip.stopped?)));
        let (report, by_hook) = match stopped {
            Some((trip, report)) => (Some(report), trip.event.is_none()),
            None if cause.permits_hook() => {
                let mut skill = leaving.start(terms.bundle_seed(now));
                let mut watcher = Watcher::new(leaving.bundle.task(), *terms.watch());
                let secs = leaving.abort_secs();
                let abort = if is_rollback_hook_first {
                    AbortRun::begin_with_rollback_hook(skill.as_mut(), secs)
                } else {
                    AbortRun::begin(skill.as_mut(), secs)
                };
                (Some(abort.finish(&mut handle, skill.as_mut(), &mut guard, &mut watcher)?), true)
            }
            None => (None, false),
        };
        let mut motion = LadderMotion {
            rungs: report.iter().filter(|_| by_hook).flat_map(hook_rungs).collect(),
            ticks_to_safe: None,
            ticks_since_trigger: 0,
            rung_ticks: 0,
            motion_ticks: report.map_or(0, |report| report.motion_ticks),
        };
        let (hold, standstill_tick) = hold(&mut handle, guard.limits())?;
        let is_at_standstill = hold.failure.is_none();
        let hold_ticks = hold.ticks;
        motion.rungs.push(hold);
        if is_at_standstill {
            // The standstill of the abort counts if the arm has been at rest ever since.
            let at_rest_since_abort =
                report.filter(|report| report.stopped_by != StoppedBy::Nothing && standstill_tick == 0);
            let since_trigger = self.world().tick().saturating_sub(trigger_tick);
            motion.ticks_to_safe = Some(match at_rest_since_abort {
                Some(report) => report.ticks_to_standstill,
                None => since_trigger.saturating_sub(hold_ticks) + standstill_tick,
            });
            let retreat = if self.arm_mut().body().is_halted() {
                // A person's stop takes precedence over the retreat: the arm stays where it is.
                RungRecord::new(Rung::Retract, None, 0, Notice::RetreatSkipped { during: false })
            } else {
                // The retreat is the runtime's own motion: no manifest declares it.
                let mut guard = terms.own_guard(leaving.manifest.permissions.authority);
                let tallest_m = self.world().spec().scene.tallest_m();
                let mut handle = self.arm_mut().handle();
                retract(&mut handle, &mut guard, tallest_m, &InstrumentedWorld::is_halted)?
            };
            motion.rungs.push(retreat);
        }
        let end_tick = self.world().tick();
        motion.ticks_since_trigger = end_tick.saturating_sub(trigger_tick);
        motion.rung_ticks = end_tick.saturating_sub(now);
        Ok(motion)
    }

    /// Checks whether the rollback target is ready: it gets the observations of the arm at standstill, and must give
    /// a command that its own guard passes. None of its commands reaches the arm here.
    pub(crate) fn check_target_ready(
        &mut self,
        target: &Capability,
        terms: &SkillTerms,
    ) -> Result<RungRecord, CellError> {
        let task = target.bundle.task();
        self.arm_mut().body_mut().world_mut().begin_task(task);
        let mut guard = terms.guard(&target.manifest.permissions);
        let mut skill = target.start(terms.bundle_seed(self.world().tick()));
        Ok(handover::ready(&mut self.arm_mut().handle(), &mut guard, skill.as_mut())?)
    }
}

/// The rungs of the hooks that were called.
fn hook_rungs(report: &RecoveryReport) -> Vec<RungRecord> {
    let of = |rung, stopped: bool, ticks, otherwise| {
        let failure = (!stopped).then_some(RungFailure::HookFailed);
        RungRecord::new(rung, failure, ticks, if stopped { Notice::HookStopped } else { otherwise })
    };
    let by = report.stopped_by;
    let first = report.rollback_hook.map(|hook| {
        let stopped = by == StoppedBy::RollbackHook;
        of(Rung::RollbackHook, stopped, hook.ticks, Notice::RollbackHookDidNotStop)
    });
    let next = report.rollback_hook.is_none_or(|hook| hook.then_safe_abort).then(|| {
        let before = report.rollback_hook.map_or(0, |hook| hook.ticks);
        let ticks = report.ticks_to_standstill.saturating_sub(before);
        of(Rung::SafeAbort, by == StoppedBy::Hook, ticks, Notice::HookDidNotStop)
    });
    first.into_iter().chain(next).collect()
}

/// Interrupts and waits for the standstill of every joint. Also returns the tick of this rung at which the standstill
/// began.
///
/// # Errors
/// If the body fails.
pub fn hold<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    limits: &RuntimeLimits,
) -> Result<(RungRecord, u64), BodyError> {
    let ticks_max = u64::from(RuntimeLimits::ticks(limits.interrupt_max_s));
    handle.interrupt(Interrupt::Stop);
    let mut standstill = Standstill::default();
    for tick in 1..=ticks_max {
        handle.step(&Command::Hold)?;
        if standstill.observe(&handle.telemetry()) {
            let began_at = tick.saturating_sub(Standstill::TICKS as u64);
            return Ok((RungRecord::new(Rung::Hold, None, tick, Notice::AtStandstill), began_at));
        }
    }
    let failure = Some(RungFailure::NoStandstill);
    Ok((RungRecord::new(Rung::Hold, failure, ticks_max, Notice::StillMoving), ticks_max))
}

/// Raises the tool clear of everything, within the envelope of the version that leaves. The heights are the profile's; in
/// a cell with something taller, both are higher by the difference. `tallest_m` is the height of the tallest thing in the
/// cell. `is_halted` says whether a person has stopped the body meanwhile.
///
/// # Errors
/// If the body fails.
pub fn retract<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    guard: &mut Guard,
    tallest_m: f64,
    is_halted: &dyn Fn(&B) -> bool,
) -> Result<RungRecord, BodyError> {
    let RuntimeLimits { retreat_height_m, retreat_clear_m, retreat_speed_m_s, retreat_max_s, .. } =
        *guard.limits();
    let taller_m = (tallest_m - retreat_clear_m).max(0.0);
    let (retreat_height_m, retreat_clear_m) = (retreat_height_m + taller_m, retreat_clear_m + taller_m);
    handle.interrupt(Interrupt::Release);
    let mut telemetry = handle.telemetry();
    let mut raised = telemetry.tool;
    raised.position[2] = raised.position[2].max(retreat_height_m);
    let retreat = Command::ToolPose { pose: raised, max_speed_m_s: retreat_speed_m_s };
    let checked = guard.check(&retreat, &telemetry);
    handle.step(&checked.command)?;
    let mut standstill = Standstill::default();
    let mut ticks = 1;
    let mut is_at_standstill = false;
    while ticks < u64::from(RuntimeLimits::ticks(retreat_max_s)) {
        handle.step(&Command::Hold)?;
        ticks += 1;
        telemetry = handle.telemetry();
        is_at_standstill = standstill.observe(&telemetry);
        if is_at_standstill && is_halted(handle.body()) {
            let notice = Notice::RetreatSkipped { during: true };
            return Ok(RungRecord::new(Rung::Retract, None, ticks, notice));
        }
        if is_at_standstill && telemetry.tool.distance_m(&raised) < ARRIVED_M {
            break;
        }
    }
    let touches = handover::touches(telemetry.contacts);
    let is_clear = is_at_standstill && !touches && telemetry.tool.position[2] > retreat_clear_m;
    if is_clear {
        return Ok(RungRecord::new(Rung::Retract, None, ticks, Notice::ToolClear));
    }
    // A failed retreat must not continue: the interrupt stops the arm.
    handle.interrupt(Interrupt::Stop);
    let obstacle = match checked.verdict {
        GuardVerdict::Denied => RetreatObstacle::GuardRefused,
        _ if touches => RetreatObstacle::Touching,
        _ if !is_at_standstill => RetreatObstacle::NoStandstill,
        _ => RetreatObstacle::NotRisen,
    };
    #[allow(clippy::cast_possible_truncation, reason = "the height of a tool in a cell")]
    let height_mm = (telemetry.tool.position[2] * 1e3).round() as i64;
    let notice = Notice::RetreatFailed { obstacle, height_mm };
    Ok(RungRecord::new(Rung::Retract, Some(RungFailure::RetreatBlocked), ticks, notice))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use holdpoint_body::TaskKind;
    use holdpoint_cell::EpisodeSetup;
    use holdpoint_governance::mode::Authority;
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_runtime::arm::Arm;
    use holdpoint_sim::SimCells;
    use holdpoint_trials::cell::Cell;

    use super::*;
    use crate::live::fake_cell::StubFactory;

    /// The heights of the shipped profiles suit the shipped scene; a taller thing raises them.
    #[test]
    fn retreat_rises_above_the_tallest_thing_of_the_cell() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let (limits, taller_m) = (profile.runtime.clone(), 0.05);
        assert!(cell.scene.tallest_m() <= limits.retreat_clear_m, "{}", cell.scene.tallest_m());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let setup = EpisodeSetup::sample(TaskKind::Grasp, &cell.scene, &cell.canonical, 100);
        let rise = |tallest_m: f64| {
            let mut world = cell.trial().unwrap();
            world.reset(&setup).unwrap();
            let mut arm = Arm::new(world);
            let mut handle = arm.handle();
            let mut low = handle.telemetry().tool;
            low.position = [0.5, 0.0, 0.1];
            handle.step(&Command::ToolPose { pose: low, max_speed_m_s: 0.4 }).unwrap();
            for _ in 1..480 {
                handle.step(&Command::Hold).unwrap();
            }
            let mut guard = terms.own_guard(Authority::try_from(1_u8).unwrap());
            let rung = retract(&mut handle, &mut guard, tallest_m, &|_| false).unwrap();
            assert_eq!(rung.failure, None, "{rung:?}");
            handle.telemetry().tool.position[2]
        };
        for (tallest_m, expected_m) in [
            (cell.scene.tallest_m(), limits.retreat_height_m),
            (limits.retreat_clear_m + taller_m, limits.retreat_height_m + taller_m),
        ] {
            let risen_m = rise(tallest_m);
            assert!((risen_m - expected_m).abs() <= ARRIVED_M, "{risen_m} of {expected_m}");
        }
    }

    /// Longer than the profile's times neither takes: an arm at rest has not shown it by then.
    #[test]
    fn hold_and_retreat_end_at_the_times_of_the_profile() {
        let cell = StubFactory::new().into_cell();
        let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
        (profile.runtime.interrupt_max_s, profile.runtime.retreat_max_s) = (1.0 / 240.0, 6.0 / 240.0);
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let mut arm = Arm::new(cell.trial().unwrap());
        let mut handle = arm.handle();
        let (held, _) = hold(&mut handle, &profile.runtime).unwrap();
        assert_eq!((held.failure, held.ticks), (Some(RungFailure::NoStandstill), 1));
        let mut guard = terms.own_guard(Authority::try_from(1_u8).unwrap());
        let retreat = retract(&mut handle, &mut guard, cell.scene.tallest_m(), &|_| false).unwrap();
        assert_eq!((retreat.failure, retreat.ticks), (Some(RungFailure::RetreatBlocked), 6));
    }
}
