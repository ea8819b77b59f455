//! What a rollback asks of the arm and of the version that takes over: the same on the live arm and in a drill.
//!
//! Reads the arm and the predecessor's first command; moves nothing but time.

use holdpoint_body::{Body, BodyError, Command, Contacts, GuardVerdict, RATE_HZ};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::rollback::{Rung, RungFailure, RungRecord};

use super::arm::ActuatorHandle;
use super::guard::{Guard, PolicyHit};
use super::skill::{Skill, next_command};

/// How long a predecessor may take to its first command, ticks.
const READY_TICKS: u64 = RATE_HZ as u64;

/// Whether the arm touches what it should stand clear of.
#[must_use]
pub const fn touches(contacts: Contacts) -> bool {
    contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot
}

/// Whether a predecessor is ready: beside the standing arm it sees what the arm sees, and has to give a command that
/// its own guard passes. None of its commands reaches the arm here.
///
/// # Errors
/// If the body fails.
pub fn ready<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    guard: &mut Guard,
    skill: &mut dyn Skill,
) -> Result<RungRecord, BodyError> {
    let mut verdict = GuardVerdict::Allowed;
    let mut denied = None;
    for tick in 1..=READY_TICKS {
        let observation = handle.observe(verdict);
        let seen = handle.telemetry();
        let command = next_command(skill, &observation)?;
        handle.step(&Command::Hold)?;
        if command == Command::Hold {
            continue;
        }
        let checked = guard.check(&command, &seen);
        verdict = checked.verdict;
        match checked.hit {
            Some(hit @ (PolicyHit::NotFinite | PolicyHit::ModeForbidden)) => {
                let notice = Notice::TargetCommandForbidden { hit };
                let failure = Some(RungFailure::PredecessorFailed);
                return Ok(RungRecord::new(Rung::ReadyPredecessor, failure, tick, notice));
            }
            Some(hit) if checked.verdict == GuardVerdict::Denied => denied = Some(hit),
            _ => {
                return Ok(RungRecord::new(Rung::ReadyPredecessor, None, tick, Notice::TargetReady));
            }
        }
    }
    let notice = denied.map_or(Notice::TargetSilent, |hit| Notice::TargetCommandsDenied { hit });
    let failure = Some(RungFailure::PredecessorFailed);
    Ok(RungRecord::new(Rung::ReadyPredecessor, failure, READY_TICKS, notice))
}
