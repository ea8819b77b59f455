//! A task that can be left after any tick, gone on with, and copied.
//!
//! Owns everything of a task but the body: the skill, its guard, the watcher, what was counted and what was
//! recorded. Who copies the body too has the same task twice (see [`TaskRun::fork`]).

use holdpoint_body::{Body, BodyError, CodeFault, Command, GuardVerdict, Observation, Telemetry};
use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::profile::RuntimeLimits;

use super::senses::SensesMeter;
use super::{
    AttemptCounter, INSPECT_AFTER_TICKS, Supervision, Supervisor, TaskRecord, TaskTerms, Tick, close,
    measure_tick, note_budget, note_continuation, note_hit, note_path, tick_secs,
};
use crate::agent::dispatcher::is_holding;
use crate::arm::ActuatorHandle;
use crate::guard::{CheckedCommand, Guard, PolicyHit};
use crate::harm::HarmMeter;
use crate::recovery::{AbortRun, RecoveryReport, StoppedBy};
use crate::skill::{Hook, Skill, next_command};
use crate::start_check::StartCheck;
use crate::watcher::{Watcher, WatcherSignal};

/// What a task is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskStage {
    /// The skill commands.
    Working,
    /// The skill is done; the world settles before it is inspected.
    Settling,
    /// The arm is being brought to a standstill.
    Recovering,
    /// The record is complete.
    Over,
}

/// As [`TaskStage`], with what belongs to each.
#[derive(Clone, Debug)]
enum StageState {
    Working,
    /// For how many ticks.
    Settling(u64),
    /// By this hook first. It is entered in its first tick, so that a copy made before has a skill that still works. An
    /// interrupt needs no hook and begins here.
    Recovering(Hook, Option<AbortRun>),
    Over,
}

/// What the skill asked for and what the guard made of it, before it reaches the robot.
#[derive(Clone, Debug)]
struct NextMove {
    observation: Observation,
    requested: Command,
    checked: CheckedCommand,
    /// It has used up its attempts.
    exhausted: bool,
}

/// One task, as far as it was worked.
pub struct TaskRun {
    terms: TaskTerms,
    skill: Box<dyn Skill>,
    guard: Guard,
    progress: TaskProgress,
}

/// All of a run that is plain data.
#[derive(Clone)]
struct TaskProgress {
    record: TaskRecord,
    watcher: Watcher,
    attempts: AttemptCounter,
    senses: SensesMeter,
    harm: HarmMeter,
    /// The comparison with the domain of the evidence, in the live cell.
    start: Option<StartCheck>,
    verdict: GuardVerdict,
    denials: u32,
    /// What the sensors told last; absent before the first tick.
    seen: Option<Telemetry>,
    /// Ticks the skill has commanded.
    tick: u64,
    /// What was asked for in this tick and has not reached the body yet.
    decision: Option<NextMove>,
    /// What was observed when it began to settle.
    settling_from: Option<Observation>,
    stage: StageState,
}

/// Takes the place of a skill that is not given its task: the arm comes to a standstill.
struct StandingSkill;

impl Skill for StandingSkill {
    fn tick(&mut self, _: &Observation) -> Command {
        Command::Stop
    }
    fn enter(&mut self, _: Hook) {}
}

impl TaskRun {
    /// A task before its first tick.
    #[must_use]
    pub fn new(skill: Box<dyn Skill>, guard: Guard, terms: TaskTerms) -> Self {
        let record = TaskRecord { invalid: false, ..TaskRecord::invalid(terms.task, terms.seed) };
        let progress = TaskProgress {
            record,
            watcher: Watcher::new(terms.task, terms.watch),
            attempts: AttemptCounter::new(terms.task, terms.watch.width_step_m),
            senses: SensesMeter::default(),
            harm: HarmMeter::default(),
            start: None,
            verdict: GuardVerdict::Allowed,
            denials: 0,
            seen: None,
            tick: 0,
            decision: None,
            settling_from: None,
            stage: StageState::Working,
        };
        let mut run = Self { terms, skill, guard, progress };
        if terms.limit_ticks == 0 {
            run.leave(false, false, Supervision::Continue);
        }
        run
    }

    /// The same task, whose start is compared with a domain before the skill sees it.
    #[must_use]
    pub fn with_start_check(mut self, check: Option<StartCheck>) -> Self {
        self.progress.start = check;
        self
    }

    /// The comparison of its start, if there is one.
    #[must_use]
    pub const fn start_check(&self) -> Option<&StartCheck> {
        self.progress.start.as_ref()
    }

    /// The same task once more, as it stands: skill and hook, guard, watcher, recovery, record. With a copy of the
    /// body it comes to the same, bit for bit. `None` if the skill cannot be copied.
    #[must_use]
    pub fn fork(&self) -> Option<Self> {
        let skill = self.skill.fork()?;
        Some(Self { terms: self.terms, skill, guard: self.guard.clone(), progress: self.progress.clone() })
    }

    /// Puts another skill in the place of its own.
    #[cfg(test)]
    pub(super) fn replace_skill(&mut self, with: impl FnOnce(Box<dyn Skill>) -> Box<dyn Skill>) {
        let own = std::mem::replace(&mut self.skill, Box::new(StandingSkill));
        self.skill = with(own);
    }

    /// Its phase.
    #[must_use]
    pub const fn stage(&self) -> TaskStage {
        match self.progress.stage {
            StageState::Working => TaskStage::Working,
            StageState::Settling(_) => TaskStage::Settling,
            StageState::Recovering(..) => TaskStage::Recovering,
            StageState::Over => TaskStage::Over,
        }
    }

    /// What is measured so far: complete when the task is over.
    #[must_use]
    pub const fn record(&self) -> &TaskRecord {
        &self.progress.record
    }

    /// Leaves the task here: the skill as it stands, with the guard and the watcher that have seen it so far.
    #[must_use]
    pub fn into_parts(self) -> (Box<dyn Skill>, Guard, Watcher) {
        (self.skill, self.guard, self.progress.watcher)
    }

    /// Works it to its end.
    ///
    /// # Errors
    /// As [`TaskRun::tick`].
    pub fn finish<B: Body>(
        mut self,
        handle: &mut ActuatorHandle<'_, B>,
        supervise: &mut Supervisor<'_, B>,
    ) -> Result<TaskRecord, BodyError> {
        self.run_to_end(handle, supervise)?;
        Ok(self.into_record())
    }

    /// Runs it to its end.
    ///
    /// # Errors
    /// As [`TaskRun::tick`].
    pub fn run_to_end<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        supervise: &mut Supervisor<'_, B>,
    ) -> Result<(), BodyError> {
        while self.tick(handle, supervise)? != TaskStage::Over {}
        Ok(())
    }

    /// What was measured.
    #[must_use]
    pub fn into_record(self) -> TaskRecord {
        self.progress.record
    }

    /// Works two tasks on one body for as long as both ask the same of it. Each then goes on alone, one with the
    /// body and one with a copy of it, to what it would have come to by itself; or both are over.
    ///
    /// # Errors
    /// As [`TaskRun::tick`]: both episodes are invalid.
    pub fn run_together<B: Body>(
        handle: &mut ActuatorHandle<'_, B>,
        first: &mut Self,
        second: &mut Self,
    ) -> Result<(), BodyError> {
        while let (Some(one), Some(other)) = (first.next_command(handle)?, second.next_command(handle)?) {
            if !is_same(&one, &other) {
                break;
            }
            handle.step(&one)?;
            first.take_in(handle, &mut |_, _| Supervision::Continue);
            second.take_in(handle, &mut |_, _| Supervision::Continue);
        }
        Ok(())
    }

    /// Lets the skill work until `reached` says so after a tick, or until it has had its last word. Returns whether
    /// it was reached. The task then stands where it can be copied, left, or gone on with.
    ///
    /// # Errors
    /// As [`TaskRun::tick`].
    pub fn run_until<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        reached: &mut dyn FnMut(&Tick<'_>) -> bool,
    ) -> Result<bool, BodyError> {
        let mut is_reached = false;
        while self.stage() == TaskStage::Working && !is_reached {
            self.tick(handle, &mut |_, passed| {
                is_reached = reached(passed);
                Supervision::Continue
            })?;
        }
        Ok(is_reached)
    }

    /// One tick. Tells what the task is at after it.
    ///
    /// # Errors
    /// If the body fails: the episode is invalid, and the run is of no further use.
    pub fn tick<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        supervise: &mut Supervisor<'_, B>,
    ) -> Result<TaskStage, BodyError> {
        if let Some(command) = self.next_command(handle)? {
            handle.step(&command)?;
            self.take_in(handle, supervise);
        } else if let StageState::Recovering(first, abort) = &mut self.progress.stage {
            let (skill, first, secs) = (self.skill.as_mut(), *first, self.terms.abort_secs);
            let abort = abort.get_or_insert_with(|| match first {
                Hook::Rollback => AbortRun::begin_with_rollback_hook(skill, secs),
                Hook::SafeAbort => AbortRun::begin(skill, secs),
            });
            let watcher = &mut self.progress.watcher;
            let report = abort.step(handle, self.skill.as_mut(), &mut self.guard, watcher)?;
            // What happens after a person's stop is not the version's conduct: that person may reach into the cell.
            if !self.progress.record.intervention {
                let seen = handle.telemetry();
                let near = self.guard.is_near(&seen);
                self.progress.harm.note(&seen, &self.guard, near);
            }
            if let Some(report) = report {
                self.recovered(report);
            }
        }
        Ok(self.stage())
    }

    /// What it wants of the body in this tick, asked once: until [`TaskRun::take_in`] the answer stays the same.
    /// `None` while it recovers, which it does by itself in [`TaskRun::tick`], and when it is over.
    fn next_command<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
    ) -> Result<Option<Command>, BodyError> {
        Ok(match self.progress.stage {
            StageState::Working => {
                if self.progress.decision.is_none() {
                    self.progress.decision = self.decide(handle)?;
                }
                self.progress.decision.as_ref().map(|decision| decision.checked.command.clone())
            }
            StageState::Settling(_) => {
                let verdict = self.progress.verdict;
                self.progress.settling_from.get_or_insert_with(|| handle.observe(verdict));
                Some(Command::Hold)
            }
            StageState::Recovering(..) | StageState::Over => None,
        })
    }

    /// What came of the tick that was asked for.
    fn take_in<B: Body>(&mut self, handle: &mut ActuatorHandle<'_, B>, supervise: &mut Supervisor<'_, B>) {
        match self.progress.stage {
            StageState::Working => {
                if let Some(decision) = self.progress.decision.take() {
                    self.after_command(handle, decision, supervise);
                }
            }
            StageState::Settling(ticks) => {
                if let Some(observation) = self.progress.settling_from.take() {
                    self.settled(handle, ticks, &observation, supervise);
                    self.progress.settling_from = Some(observation);
                }
            }
            StageState::Recovering(..) | StageState::Over => {}
        }
    }

    /// After a tick in which the skill commanded.
    fn after_command<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        decision: NextMove,
        supervise: &mut Supervisor<'_, B>,
    ) {
        let NextMove { observation, requested, checked, exhausted } = decision;
        let Self { terms, skill, guard, progress: p } = self;
        let seen = handle.telemetry();
        p.tick += 1;
        let denials_max = RuntimeLimits::ticks(guard.limits().denied_max_s);
        let (raised, measured) =
            measure_tick(&mut p.record, &mut p.watcher, (guard, &mut p.harm), &seen, p.tick);
        let measured = measured.or_else(|| note_budget(&mut p.record, guard, p.tick));
        note_path(&mut p.record, &seen, p.tick);
        p.senses.note(&observation);
        let passed = Tick {
            tick: p.tick,
            observation: &observation,
            command: &checked.command,
            seen: &seen,
            raised: &raised,
            checked: checked.hit,
            measured,
            settling: false,
        };
        let called = supervise(handle, &passed);
        p.record.intervention |= called == Supervision::StepIn;
        let stopped = called.stops();
        p.seen = Some(seen);
        let done = requested == Command::Done;
        p.record.fault = skill.confined().fault;
        let mut wants_recovery = exhausted || stopped || measured.is_some() || p.record.fault.is_some();
        if let Command::Fail { signal } = requested {
            p.record.declared = Some(signal);
            wants_recovery = true;
        }
        wants_recovery |= raised.iter().any(|signal| signal.needs_recovery());
        wants_recovery |= p.denials >= denials_max || p.record.hard_stop.is_some();
        if done || wants_recovery || p.tick >= terms.limit_ticks {
            self.leave(done, wants_recovery, called);
        }
    }

    /// What the skill wants in this tick, as the guard lets it pass. `None`: the skill is not given this start.
    fn decide<B: Body>(&mut self, handle: &mut ActuatorHandle<'_, B>) -> Result<Option<NextMove>, BodyError> {
        let Self { skill, guard, progress: p, .. } = self;
        let seen = p.seen.take().unwrap_or_else(|| handle.telemetry());
        let observation = handle.observe(p.verdict);
        if p.start.as_mut().is_some_and(|start| start.observe(&observation, is_holding(&seen))) {
            self.refuse();
            return Ok(None);
        }
        let mut requested = next_command(skill.as_mut(), &observation)?;
        let fault = skill.confined().fault;
        if fault.is_some() {
            // What stands there is no word of the skill's.
            requested = Command::Stop;
        }
        let collides = p.tick.is_multiple_of(4) && guard.predicts_collision(&seen);
        let checked = if collides {
            CheckedCommand {
                command: Command::Stop,
                verdict: GuardVerdict::Denied,
                hit: Some(PolicyHit::PredictedCollision),
            }
        } else {
            guard.check(&requested, &seen)
        };
        p.harm.note_command(&requested, &checked, guard, (&observation.tau, &observation.dq));
        p.verdict = checked.verdict;
        if let Some(hit) = checked.hit {
            note_hit(&mut p.record, p.tick, hit);
        }
        if matches!(fault, Some(CodeFault::Fuel | CodeFault::Memory)) {
            note_hit(&mut p.record, p.tick, PolicyHit::BudgetExceeded);
        }
        p.denials = if checked.verdict == GuardVerdict::Denied { p.denials + 1 } else { 0 };
        p.attempts.note(&checked.command, &seen);
        let exhausted = p.attempts.retries() > guard.envelope().retries_max;
        if exhausted {
            note_hit(&mut p.record, p.tick, PolicyHit::RetriesExceeded);
        }
        p.watcher.note_command(&checked.command, &seen);
        Ok(Some(NextMove { observation, requested, checked, exhausted }))
    }

    /// Takes the task from the skill, which gets no further observation, not even in its hook.
    fn refuse(&mut self) {
        self.skill = Box::new(StandingSkill);
        self.progress.record.refused = true;
        self.recover(Supervision::Abort);
    }

    /// The skill has had its last word.
    fn leave(&mut self, done: bool, wants_recovery: bool, called: Supervision) {
        let p = &mut self.progress;
        p.record.timeout = !done && !wants_recovery;
        p.record.time_secs = tick_secs(p.tick);
        if done && !wants_recovery {
            p.stage = StageState::Settling(0);
        } else {
            self.recover(called);
        }
    }

    fn recover(&mut self, called: Supervision) {
        let p = &mut self.progress;
        p.record.recovery = true;
        let at_once = (called == Supervision::Interrupt).then(AbortRun::without_hook);
        // Where the link is down, the supervisor does not know of a limit passed or a contact.
        let is_safe = !p.record.violation && !p.watcher.has(WatcherSignal::UnexpectedContact);
        let by_rollback_hook = called == Supervision::RollBack && is_safe;
        let first = if by_rollback_hook { Hook::Rollback } else { Hook::SafeAbort };
        p.stage = StageState::Recovering(first, at_once);
    }

    /// A tick between a skill's report that it is done and the inspection: no command is sent, and everything is
    /// measured and supervised as before.
    fn settled<B: Body>(
        &mut self,
        handle: &mut ActuatorHandle<'_, B>,
        ticks: u64,
        observation: &Observation,
        supervise: &mut Supervisor<'_, B>,
    ) {
        let Self { guard, progress: p, .. } = self;
        let seen = handle.telemetry();
        let tick = p.tick + ticks + 1;
        let (raised, measured) =
            measure_tick(&mut p.record, &mut p.watcher, (guard, &mut p.harm), &seen, tick);
        let passed = Tick {
            tick,
            observation,
            command: &Command::Hold,
            seen: &seen,
            raised: &raised,
            checked: None,
            measured,
            settling: true,
        };
        // A signal of the watcher is kept; whether the work came out is what the inspection says.
        let called = supervise(handle, &passed);
        p.record.intervention |= called == Supervision::StepIn;
        if called.stops() || measured.is_some() {
            self.recover(called);
        } else if ticks + 1 < INSPECT_AFTER_TICKS {
            p.stage = StageState::Settling(ticks + 1);
        } else {
            p.record.success = handle.inspect();
            self.end();
        }
    }

    fn recovered(&mut self, report: RecoveryReport) {
        let p = &mut self.progress;
        if let Some(hit) = report.violation {
            note_hit(&mut p.record, p.tick, hit);
        }
        note_continuation(&mut p.record, &self.guard, report.motion_ticks, p.tick);
        if report.stopped_by == StoppedBy::Nothing {
            p.record.hard_stop = Some(HardStop::MotionAfterStop);
        }
        p.record.recovered = Some(report);
        self.end();
    }

    fn end(&mut self) {
        let p = &mut self.progress;
        let confined = self.skill.confined();
        // Also where it failed in its hook, after its last word.
        p.record.fault = confined.fault;
        close(&mut p.record, &p.watcher, &p.attempts, (&self.guard, confined), p.tick);
        p.record.sensed = p.senses.values();
        p.record.uncovered = p.start.as_ref().and_then(StartCheck::uncovered);
        p.record.harm = Some(p.harm.measures());
        p.stage = StageState::Over;
    }
}

/// Whether two commands are the same to the bit; the zeros of either sign are equal and not the same.
#[must_use]
pub fn is_same(one: &Command, other: &Command) -> bool {
    one == other && sign_bits(one) == sign_bits(other)
}

/// The signs of a command's numbers. Equal numbers are the same to the bit if their signs are.
fn sign_bits(command: &Command) -> u32 {
    let bits = |start: u32, numbers: &[f64]| {
        numbers.iter().fold(start, |bits, number| bits << 1 | u32::from(number.is_sign_negative()))
    };
    match command {
        Command::ToolPose { pose, max_speed_m_s } => {
            bits(bits(bits(0, &pose.position), &pose.rotation), &[*max_speed_m_s])
        }
        Command::Joints { q, max_speed_rad_s } => bits(bits(0, q), &[*max_speed_rad_s]),
        Command::Gripper { width_m, speed_m_s, force_n } => bits(0, &[*width_m, *speed_m_s, *force_n]),
        Command::Hold | Command::Stop | Command::Done | Command::Fail { .. } => 0,
    }
}
