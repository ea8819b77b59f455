//! The rungs of the ladder that move the arm, and the one that checks whether the rollback target is ready.
//!
//! Whether a rung held is read from joints, contacts and pose, never from what a hook returns. Decides
//! nothing about the versions; the first rung that fails ends the ladder, and the arm stays stopped.

use holdpoint_body::{Command, GuardVerdict, Interrupt, RATE_HZ};
use holdpoint_sim::SimError;

use super::instrumented::InstrumentedWorld;
use super::live::Rig;
use super::supervisor::Trip;
use holdpoint_governance::notice::{Notice, RetreatObstacle};
use holdpoint_governance::rollback::{Rung, RungFailure, RungRecord};
use holdpoint_runtime::arm::ActuatorHandle;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::handover;
use holdpoint_runtime::recovery::{self, RecoveryReport, Standstill, StoppedBy};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_runtime::watcher::Watcher;

/// Time within which the interrupt must bring every joint to a standstill, ticks.
const HOLD_TICKS: u64 = RATE_HZ as u64;

/// How long the retreat may take, ticks.
const RETREAT_TICKS: u64 = 4 * RATE_HZ as u64;

/// Height to which the tool is raised, m: above everything that stands in the cell.
const RETREAT_HEIGHT_M: f64 = 0.2;

/// The lowest height that counts as clear, m.
const CLEAR_HEIGHT_M: f64 = 0.15;

/// Speed of the retreat, m/s.
const RETREAT_SPEED_M_S: f64 = 0.2;

/// What the arm did on the ladder.
#[derive(Clone, Debug)]
pub(crate) struct Descent {
    /// The rungs that were tried.
    pub(crate) rungs: Vec<RungRecord>,
    /// From the trigger until every joint was at rest, ticks.
    pub(crate) safe_ticks: Option<u64>,
    /// From the trigger to the end of the last rung, ticks.
    pub(crate) ticks: u64,
    /// Ticks of the live world that passed here; the rest passed in the task.
    pub(crate) ticks_here: u64,
    /// Motion after the trigger, beyond what braking takes, ticks.
    pub(crate) motion_ticks: u64,
}

impl Descent {
    /// Whether the ladder goes on.
    pub(crate) fn held(&self) -> bool {
        self.rungs.iter().all(RungRecord::continues)
    }
}

impl Rig {
    /// The physical rungs: the version's own safe-abort hook, the interrupt that no version can refuse, and the
    /// retreat. If the supervisor stopped a task in flight, the hook has run already: the ladder continues from there,
    /// and time counts from the tick of that stop.
    pub(crate) fn descend(
        &mut self,
        leaving: &Capability,
        terms: &SkillTerms,
        trip: Option<&Trip>,
    ) -> Result<Descent, SimError> {
        let now = self.world().tick();
        let started = trip.map_or(now, |trip| trip.world_tick.min(now));
        self.arm_mut().body_mut().verdict();
        let mut handle = self.arm_mut().handle();
        let mut guard = terms.guard(&leaving.manifest.permissions);
        let report = match trip.and_then(|trip| trip.stopped) {
            Some(report) => report,
            None => {
                let mut skill = leaving.start(terms.bundle_seed(now));
                let mut watcher = Watcher::new(leaving.bundle.task(), *terms.watch());
                recovery::abort(&mut handle, skill.as_mut(), &mut guard, &mut watcher, leaving.abort_secs())?
            }
        };
        let mut descent = Descent {
            rungs: vec![safe_abort(&report)],
            safe_ticks: None,
            ticks: 0,
            ticks_here: 0,
            motion_ticks: report.motion_ticks,
        };
        let (hold, stood_at) = hold(&mut handle)?;
        let reached = hold.failure.is_none();
        descent.rungs.push(hold);
        if reached {
            // The standstill of the abort counts if the arm has stood ever since.
            let stood = report.stopped_by != StoppedBy::Nothing && stood_at == 0;
            let before = self.world().tick().saturating_sub(started);
            let held_for = descent.rungs.last().map_or(0, |rung| rung.ticks);
            descent.safe_ticks = Some(if stood {
                report.ticks_to_standstill
            } else {
                before.saturating_sub(held_for) + stood_at
            });
            let rung = if self.arm_mut().body().is_halted() {
                // A person's stop outranks the retreat: the arm stays where it is.
                RungRecord::new(Rung::Retract, None, 0, Notice::RetreatSkipped { during: false })
            } else {
                // The retreat is the runtime's own motion: no manifest declares it.
                let mut own = terms.own_guard(leaving.manifest.permissions.authority);
                retract(&mut self.arm_mut().handle(), &mut own)?
            };
            descent.rungs.push(rung);
        }
        let ended = self.world().tick();
        descent.ticks = ended.saturating_sub(started);
        descent.ticks_here = ended.saturating_sub(now);
        Ok(descent)
    }

    /// Checks whether the rollback target is ready: it gets the observations of the arm at standstill, and must give
    /// a command that its own guard passes. None of its commands reaches the arm here.
    pub(crate) fn ready(
        &mut self,
        predecessor: &Capability,
        terms: &SkillTerms,
    ) -> Result<RungRecord, SimError> {
        let task = predecessor.bundle.task();
        self.arm_mut().body_mut().world_mut().begin_task(task);
        let mut guard = terms.guard(&predecessor.manifest.permissions);
        let mut skill = predecessor.start(terms.bundle_seed(self.world().tick()));
        Ok(handover::ready(&mut self.arm_mut().handle(), &mut guard, skill.as_mut())?)
    }
}

fn safe_abort(report: &RecoveryReport) -> RungRecord {
    let (failure, notice) = match report.stopped_by {
        StoppedBy::Hook => (None, Notice::HookStopped),
        StoppedBy::Interrupt | StoppedBy::Nothing => (Some(RungFailure::HookFailed), Notice::HookDidNotStop),
    };
    RungRecord::new(Rung::SafeAbort, failure, report.ticks_to_standstill, notice)
}

/// Interrupts and waits for the standstill of every joint. Also returns the tick of this rung at which it began.
fn hold(handle: &mut ActuatorHandle<'_, InstrumentedWorld>) -> Result<(RungRecord, u64), SimError> {
    handle.interrupt(Interrupt::Stop);
    let mut standstill = Standstill::default();
    for tick in 1..=HOLD_TICKS {
        handle.step(&Command::Hold)?;
        if standstill.observe(&handle.telemetry()) {
            let since = tick.saturating_sub(Standstill::TICKS as u64);
            return Ok((RungRecord::new(Rung::Hold, None, tick, Notice::AtStandstill), since));
        }
    }
    let failure = Some(RungFailure::NoStandstill);
    Ok((RungRecord::new(Rung::Hold, failure, HOLD_TICKS, Notice::StillMoving), HOLD_TICKS))
}

/// Raises the tool clear of everything, within the envelope of the version that leaves.
fn retract(
    handle: &mut ActuatorHandle<'_, InstrumentedWorld>,
    guard: &mut Guard,
) -> Result<RungRecord, SimError> {
    handle.interrupt(Interrupt::Release);
    let mut seen = handle.telemetry();
    let mut up = seen.tool;
    up.position[2] = up.position[2].max(RETREAT_HEIGHT_M);
    let retreat = Command::ToolPose { pose: up, max_speed_m_s: RETREAT_SPEED_M_S };
    let checked = guard.check(&retreat, &seen);
    handle.step(&checked.command)?;
    let mut standstill = Standstill::default();
    let mut ticks = 1;
    let mut stands = false;
    while ticks < RETREAT_TICKS {
        handle.step(&Command::Hold)?;
        ticks += 1;
        seen = handle.telemetry();
        stands = standstill.observe(&seen);
        if stands && handle.body().is_halted() {
            let notice = Notice::RetreatSkipped { during: true };
            return Ok(RungRecord::new(Rung::Retract, None, ticks, notice));
        }
        if stands && seen.tool.distance_m(&up) < 0.01 {
            break;
        }
    }
    let touches = handover::touches(seen.contacts);
    let clear = stands && !touches && seen.tool.position[2] > CLEAR_HEIGHT_M;
    if clear {
        return Ok(RungRecord::new(Rung::Retract, None, ticks, Notice::ToolClear));
    }
    // A failed retreat must not continue: the interrupt stops the arm.
    handle.interrupt(Interrupt::Stop);
    let obstacle = match checked.verdict {
        GuardVerdict::Denied => RetreatObstacle::GuardRefused,
        _ if touches => RetreatObstacle::Touching,
        _ if !stands => RetreatObstacle::NoStandstill,
        _ => RetreatObstacle::NotRisen,
    };
    #[allow(clippy::cast_possible_truncation, reason = "the height of a tool in a cell")]
    let height_mm = (seen.tool.position[2] * 1e3).round() as i64;
    let notice = Notice::RetreatFailed { obstacle, height_mm };
    Ok(RungRecord::new(Rung::Retract, Some(RungFailure::RetreatBlocked), ticks, notice))
}
