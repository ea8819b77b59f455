//! The recovery manager: brings the arm to a standstill, by the skill's hooks or without them.
//!
//! First the skill's own safe-abort hook; if the arm still moves when the declared time is over, the interrupt that
//! no skill can refuse. In a planned rollback the rollback hook may come before both. After a safety event the interrupt
//! comes at once. Standstill is measured from joint speeds, never from the hook's result.

use holdpoint_body::BodyError;
use holdpoint_body::{Command, GuardVerdict, Interrupt, Pose, RATE_HZ, Standstill};
use serde::{Deserialize, Serialize};

use super::arm::ActuatorHandle;
use super::guard::{Guard, PolicyHit};
use super::skill::{Hook, Skill, next_command};
use super::watcher::{Watcher, WatcherSignal};
use holdpoint_body::Body;
use holdpoint_governance::profile::RuntimeLimits;

/// Ticks that a standstill has lasted when [`Standstill`] reports it.
const STANDSTILL_TICKS: u64 = Standstill::TICKS as u64;

/// After the interrupt the servo takes a quarter of a second at most to brake.
const BRAKING_TICKS: u64 = RATE_HZ as u64 / 4;

/// How a standstill was reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StoppedBy {
    /// The skill's rollback hook.
    RollbackHook,
    /// The skill's safe-abort hook.
    Hook,
    /// The interrupt, after the hook's time was over. A braked arm that is jammed may still tremble
    /// or creep by contact, within the profile's `creep_max_m`.
    Interrupt,
    /// Neither: the arm goes on.
    Nothing,
}

/// What a recovery did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecoveryReport {
    /// How the arm was stopped.
    pub stopped_by: StoppedBy,
    /// Ticks from the demand to the standstill; to the end of the recovery if there was none.
    pub ticks_to_standstill: u64,
    /// Ticks in which the arm moved after the demand, braking included, without the rollback hook's motion.
    pub motion_ticks: u64,
    /// A limit that was passed meanwhile.
    pub violation: Option<PolicyHit>,
    /// What the rollback hook did; absent if it was not called, and in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollback_hook: Option<RollbackHookReport>,
}

/// A rollback hook that was called first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RollbackHookReport {
    /// Ticks until it had stopped the arm, or was given up.
    pub ticks: u64,
    /// Whether the safe-abort hook was called after it.
    pub then_safe_abort: bool,
}

/// Longest time of a rollback hook until it says that it is done, ticks: the same in a drill and in a rollback.
pub const ROLLBACK_HOOK_TICKS: u64 = 3 * RATE_HZ as u64;

/// Time in which the arm must come to a standstill after the rollback hook says that it is done, ticks: as in a drill.
const DONE_TICKS: u64 = RATE_HZ as u64 / 2;

/// The rollback hook while it is the first rung.
#[derive(Clone, Copy, Debug)]
struct RollbackRung {
    /// The tick at which it is given up.
    until: u64,
    /// It says that it is done: its code is not called any more, and the arm has to stand.
    is_done: bool,
}

/// A safe abort, tick by tick: it can be left after any tick, and a copy goes on from where it was taken.
#[derive(Clone, Debug)]
pub struct AbortRun {
    /// Whether the skill's hook commands; otherwise its code is not called.
    by_hook: bool,
    /// The rollback hook; absent if it is not called first, or was given up.
    rollback: Option<RollbackRung>,
    /// The tick at which what follows the rollback hook begins.
    abort_from: u64,
    hook_ticks: u64,
    tick: u64,
    standstill: Standstill,
    /// The tick at which the present standstill began, which is earlier than the one in which it was found.
    stands_from: Option<u64>,
    braked_at: Option<Pose>,
    verdict: GuardVerdict,
    report: RecoveryReport,
}

impl AbortRun {
    /// Turns a running skill to its safe-abort hook. `hook_secs` is the stop time the version declares.
    pub fn begin(skill: &mut dyn Skill, hook_secs: f64) -> Self {
        skill.enter(Hook::SafeAbort);
        Self::new(true, ticks_of(hook_secs))
    }

    /// Turns a running skill to its rollback hook. If the hook does not bring the arm to a standstill in time, the safe-abort
    /// hook follows, and then the interrupt. If its code fails, passes a limit or touches something, the interrupt follows
    /// at once and the code is not called any more.
    pub fn begin_with_rollback_hook(skill: &mut dyn Skill, hook_secs: f64) -> Self {
        skill.enter(Hook::Rollback);
        let until = ROLLBACK_HOOK_TICKS;
        let rollback = Some(RollbackRung { until, is_done: false });
        Self { rollback, abort_from: until, ..Self::new(true, until + ticks_of(hook_secs)) }
    }

    /// Stops the arm by the interrupt alone: the code of the skill is not called any more.
    #[must_use]
    pub fn without_hook() -> Self {
        Self::new(false, 0)
    }

    fn new(by_hook: bool, hook_ticks: u64) -> Self {
        let report = RecoveryReport {
            stopped_by: StoppedBy::Nothing,
            ticks_to_standstill: 0,
            motion_ticks: 0,
            violation: None,
            rollback_hook: None,
        };
        Self {
            by_hook,
            rollback: None,
            abort_from: 0,
            hook_ticks,
            tick: 0,
            standstill: Standstill::default(),
            stands_from: None,
            braked_at: None,
            verdict: GuardVerdict::Allowed,
            report,
        }
    }

    /// Whether the hook's time is over: from here on it has not stopped the arm, whatever follows.
    #[must_use]
    pub const fn is_past_hook(&self) -> bool {
        self.tick >= self.hook_ticks
    }

    /// A limit that was passed so far.
    #[must_use]
    pub const fn violation(&self) -> Option<PolicyHit> {
        self.report.violation
    }

    /// One tick; the report when it was the last.
    ///
    /// # Errors
    /// If the body fails.
    pub fn step<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        skill: &mut dyn Skill,
        guard: &mut Guard,
        watcher: &mut Watcher,
    ) -> Result<Option<RecoveryReport>, BodyError> {
        let tick = self.tick;
        self.leave_rollback_hook(skill);
        if skill.confined().fault.is_some() {
            // A hook whose code has failed is not waited for.
            self.hook_ticks = self.hook_ticks.min(tick);
        }
        let RuntimeLimits { interrupt_max_s, creep_max_m, .. } = *guard.limits();
        let give_up = self.hook_ticks + u64::from(RuntimeLimits::ticks(interrupt_max_s));
        if tick == self.hook_ticks && self.rollback.is_none() {
            handle.interrupt(Interrupt::Stop);
        }
        let seen = handle.observe(self.verdict);
        let before = handle.telemetry();
        let calls_code = self.by_hook && !self.rollback.is_some_and(|rollback| rollback.is_done);
        let command = if calls_code { next_command(skill, &seen)? } else { Command::Hold };
        if let Some(rollback) = self.rollback.as_mut().filter(|_| command == Command::Done) {
            *rollback = RollbackRung { until: tick + 1 + DONE_TICKS, is_done: true };
        }
        // The same stop as in a drill: a redundant arm may keep turning about a tool at rest.
        let is_done = self.rollback.is_some_and(|rollback| rollback.is_done);
        let command = if calls_code && is_done { Command::Stop } else { command };
        let checked = guard.check(&command, &before);
        self.verdict = checked.verdict;
        if let Some(hit) = checked.hit.filter(|hit| hit.hard_stop().is_some()) {
            self.report.violation.get_or_insert(hit);
        }
        watcher.note_command(&checked.command, &before);
        handle.step(&checked.command)?;
        let after = handle.telemetry();
        let touches = watcher.observe(&after).contains(&WatcherSignal::UnexpectedContact);
        let report = &mut self.report;
        if let Some(hit) = guard.measure(&after) {
            report.violation.get_or_insert(hit);
        }
        let began = self.stands_from.unwrap_or_else(|| (tick + 1).saturating_sub(STANDSTILL_TICKS));
        self.stands_from = self.standstill.observe(&after).then_some(began);
        if let Some(rollback) = self.rollback {
            self.tick += 1;
            if touches || report.violation.is_some() {
                self.end_code();
            } else if let Some(ticks) = self.stands_from.filter(|_| rollback.is_done) {
                report.stopped_by = StoppedBy::RollbackHook;
                report.ticks_to_standstill = ticks;
                report.rollback_hook = Some(RollbackHookReport { ticks, then_safe_abort: false });
                return Ok(Some(*report));
            }
            return Ok(None);
        }
        if !self.standstill.is_slow() {
            report.motion_ticks += 1;
        }
        if tick == self.hook_ticks + BRAKING_TICKS {
            self.braked_at = Some(after.tool);
        }
        if tick + 1 == give_up && self.braked_at.is_some_and(|at| at.distance_m(&after.tool) <= creep_max_m) {
            report.stopped_by = StoppedBy::Interrupt;
        }
        self.tick += 1;
        if let Some(ticks) = self.stands_from.filter(|_| tick > self.abort_from + 24) {
            report.stopped_by = if tick < self.hook_ticks { StoppedBy::Hook } else { StoppedBy::Interrupt };
            report.ticks_to_standstill = ticks;
            return Ok(Some(*report));
        }
        // A fault of the code ends the hook's time early, and with it the recovery.
        report.ticks_to_standstill = self.tick;
        Ok((self.tick >= give_up).then_some(*report))
    }

    /// Runs it to its end.
    ///
    /// # Errors
    /// If the body fails.
    pub fn finish<B: Body>(
        mut self,
        handle: &mut ActuatorHandle<'_, B>,
        skill: &mut dyn Skill,
        guard: &mut Guard,
        watcher: &mut Watcher,
    ) -> Result<RecoveryReport, BodyError> {
        loop {
            if let Some(report) = self.step(handle, skill, guard, watcher)? {
                return Ok(report);
            }
        }
    }

    /// Gives up a rollback hook whose time is over, or whose code has failed.
    fn leave_rollback_hook(&mut self, skill: &mut dyn Skill) {
        let Some(rollback) = self.rollback else { return };
        if skill.confined().fault.is_some() {
            self.end_code();
        } else if self.tick >= rollback.until {
            skill.enter(Hook::SafeAbort);
            let abort_ticks = self.hook_ticks.saturating_sub(self.abort_from);
            self.give_up_rollback_hook(abort_ticks, true);
        }
    }

    /// Ends the control of the version's code in a rollback hook: the interrupt is next.
    fn end_code(&mut self) {
        self.by_hook = false;
        self.give_up_rollback_hook(0, false);
    }

    /// Goes on to the next rung, which has `abort_ticks` before the interrupt.
    fn give_up_rollback_hook(&mut self, abort_ticks: u64, then_safe_abort: bool) {
        self.rollback = None;
        self.abort_from = self.tick;
        self.standstill = Standstill::default();
        self.stands_from = None;
        self.hook_ticks = self.tick + abort_ticks;
        self.report.rollback_hook = Some(RollbackHookReport { ticks: self.tick, then_safe_abort });
    }
}

/// The longest stop time that counts, s: twice the longest that a manifest may declare.
const HOOK_SECS_MAX: f64 = 10.0;

/// The ticks of a declared stop time.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number from 0 to 2,400")]
fn ticks_of(hook_secs: f64) -> u64 {
    (hook_secs.clamp(0.0, HOOK_SECS_MAX) * f64::from(RATE_HZ)) as u64
}

/// Aborts a running skill. `hook_secs` is the stop time the version declares.
///
/// # Errors
/// If the body fails.
pub fn abort<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    skill: &mut dyn Skill,
    guard: &mut Guard,
    watcher: &mut Watcher,
    hook_secs: f64,
) -> Result<RecoveryReport, BodyError> {
    AbortRun::begin(skill, hook_secs).finish(handle, skill, guard, watcher)
}
