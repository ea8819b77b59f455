//! The recovery manager: brings the arm to a standstill, by the skill's hook or without it.
//!
//! First the skill's own safe-abort hook; if the arm still moves when the declared time is over,
//! the interrupt that no skill can refuse. Whether the arm stands is read from joint speeds, never
//! from what a hook returns.

use holdpoint_sim::SimError;
use holdpoint_sim::io::{GuardVerdict, Interrupt, RATE_HZ, Telemetry};
use serde::{Deserialize, Serialize};

use super::arm::{ActuatorHandle, Body};
use super::guard::{Guard, PolicyHit};
use super::skill::{Hook, Skill};
use super::watcher::Watcher;

/// Joint speed below which a joint stands, rad/s.
pub const STANDSTILL_RAD_S: f64 = 0.02;

/// How long a standstill has to last, ticks.
const STANDSTILL_TICKS: u32 = 12;

/// How a standstill was reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StoppedBy {
    /// The skill's safe-abort hook.
    Hook,
    /// The interrupt, after the hook's time was over.
    Interrupt,
    /// Neither: the arm still moves.
    Nothing,
}

/// What a recovery did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryReport {
    /// How the arm was stopped.
    pub stopped_by: StoppedBy,
    /// Ticks from the demand to the standstill.
    pub ticks_to_standstill: u64,
    /// Ticks in which the arm moved on after the demand, beyond what braking takes.
    pub motion_ticks: u64,
    /// A limit that was passed meanwhile.
    pub violation: Option<PolicyHit>,
}

/// Whether every joint stands.
#[must_use]
pub fn stands(seen: &Telemetry) -> bool {
    seen.dq.iter().all(|dq| dq.abs() < STANDSTILL_RAD_S)
}

/// Aborts a running skill. `hook_secs` is the stop time the version declares.
///
/// # Errors
/// Where the body fails.
pub fn abort<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    skill: &mut dyn Skill,
    guard: &mut Guard,
    watcher: &mut Watcher,
    hook_secs: f64,
) -> Result<RecoveryReport, SimError> {
    skill.enter(Hook::SafeAbort);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let hook_ticks = (hook_secs.clamp(0.0, 10.0) * f64::from(RATE_HZ)) as u64;
    // After the hook's time the interrupt gets one second.
    let give_up = hook_ticks + u64::from(RATE_HZ);
    let mut report = RecoveryReport {
        stopped_by: StoppedBy::Nothing,
        ticks_to_standstill: give_up,
        motion_ticks: 0,
        violation: None,
    };
    let mut still = 0;
    let mut verdict = GuardVerdict::Allowed;
    for tick in 0..give_up {
        if tick == hook_ticks {
            handle.interrupt(Interrupt::Stop);
        }
        let seen = handle.observe(verdict);
        let before = handle.telemetry();
        let checked = guard.check(&skill.tick(&seen), &before);
        verdict = checked.verdict;
        watcher.note_command(&checked.command, &before);
        handle.step(&checked.command)?;
        let after = handle.telemetry();
        watcher.observe(&after);
        if let Some(hit) = guard.measure(&after) {
            report.violation.get_or_insert(hit);
        }
        if stands(&after) {
            still += 1;
        } else {
            still = 0;
            report.motion_ticks += 1;
        }
        if still >= STANDSTILL_TICKS && tick > 24 {
            report.stopped_by = if tick < hook_ticks { StoppedBy::Hook } else { StoppedBy::Interrupt };
            report.ticks_to_standstill = tick + 1 - u64::from(STANDSTILL_TICKS);
            break;
        }
    }
    Ok(report)
}
