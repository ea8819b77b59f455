//! Drives an engine step by step: sends commands, waits, and keeps the decisions on the last candidate.
//!
//! Owns the end of a step and the result of the candidate; judges nothing.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use super::exit_status::{FollowedVersion, outcome_of};
use super::printer::Printer;
use super::script::{DecisionStep, DriftStep, ExpectStep, LiveStep, ProfileStep, ScriptStep, WaitStep};
use super::scripted_approver;
use crate::error::{CliError, Exit, refusal_reason};
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply, Request, StopPersistence};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_service::pump::Pump;
use holdpoint_text::{ErrorReason, Hint as _, Problem};
use holdpoint_trials::embedded;
use holdpoint_wording::program::run as sentences;

/// The end of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepEnd {
    Done,
    TimedOut,
}

/// The pause while the cell is stopped in the middle of a stage.
const STOPPED_PAUSE: Duration = Duration::from_millis(200);

/// A reason given for the candidate: its stage and dimension.
#[derive(Clone, Copy)]
struct StageReason {
    stage: Decider,
    dimension: Dimension,
    code: ReasonCode,
}

/// An engine, and the last registered candidate.
pub(super) struct Driver<'a> {
    pub(super) pump: Pump,
    printer: Printer<'a>,
    requests: u64,
    candidate: Option<CapabilityId>,
    reasons: Vec<StageReason>,
    confirmed: bool,
}

impl<'a> Driver<'a> {
    pub(super) fn new(pump: Pump, printer: Printer<'a>) -> Self {
        Self { pump, printer, requests: 0, candidate: None, reasons: Vec::new(), confirmed: false }
    }

    /// Runs a stage that a call began to its end.
    pub(super) fn run_stage(&mut self, id: &CapabilityId, stage: Stage) -> Result<(), CliError> {
        self.candidate = Some(id.clone());
        let reply = self.pump.launch(id, stage);
        self.take_events()?;
        if let Reply::Refused { code, text, hint } = &reply {
            return Err(crate::cli::refused(*code, text, hint.as_deref()));
        }
        while !self.is_over() && self.view().is_some_and(|view| view.flags.running.is_some()) {
            let (progress, events) = self.pump.turn();
            self.print_events(&events)?;
            if matches!(progress, SliceOutcome::Idle { .. }) {
                self.pump.wait(STOPPED_PAUSE);
            }
        }
        Ok(())
    }

    pub(super) fn note(&mut self, text: &str) -> Result<(), CliError> {
        self.printer.note(text)
    }

    /// The engine has ended. A reader that is gone ends nothing: the exit code is that of the whole run.
    const fn is_over(&self) -> bool {
        self.pump.engine().has_ended()
    }

    /// Runs a step of a scenario; `index` names it in errors.
    pub(super) fn step(&mut self, step: &ScriptStep, index: usize) -> Result<StepEnd, CliError> {
        if let Some(candidate) = &step.register {
            self.register(candidate.folder(), candidate.requester())
        } else if let Some(wait) = &step.wait {
            self.wait(wait)
        } else if let Some(details) = &step.approve {
            self.sign_decision(details, ApprovalDecision::Approve)
        } else if let Some(details) = &step.reject {
            self.sign_decision(details, ApprovalDecision::Reject)
        } else if let Some(details) = &step.break_glass {
            self.break_glass(details)
        } else if let Some(drift) = &step.drift {
            self.drift(drift)
        } else if let Some(goal) = &step.goal {
            let (by, reason) = ("script".to_owned(), "the script says so".to_owned());
            self.accept(Command::Goal { goal: goal.clone(), by, reason })
        } else if let Some(fault) = &step.fault {
            self.accept(Command::LiveFault { fault: Some(fault.kind) })
        } else if let Some(DecisionStep { who, reason, .. }) = &step.stop {
            self.accept(Command::Stop { by: who.clone(), reason: reason.clone() })
        } else if let Some(DecisionStep { who, reason, .. }) = &step.go {
            // A script knows of its stops.
            let stopped = self.pump.engine().snapshot().stopped;
            let (since_ms, stops) = stopped.map_or((0, 0), |stopped| (stopped.since_ms, stopped.stops));
            self.accept(Command::Go { by: who.clone(), reason: reason.clone(), since_ms, stops })
        } else if let Some(work) = &step.work {
            self.work(work, index)
        } else if let Some(pass) = step.pass {
            self.pass(pass.for_s)
        } else if let Some(expect) = &step.expect {
            self.expect(expect, index)
        } else {
            self.operate(step)
        }
    }

    /// Runs a step that is an operation on the last candidate.
    fn operate(&mut self, step: &ScriptStep) -> Result<StepEnd, CliError> {
        let Some(version) = self.candidate.clone() else {
            return Err(CliError::usage("the step needs a registered candidate"));
        };
        let operation = |by: &str, reason: &str| Operation {
            version: version.clone(),
            by: by.to_owned(),
            reason: reason.to_owned(),
        };
        let operation_of = |details: &DecisionStep| operation(&details.who, &details.reason);
        let of = |some: &ProfileStep| (operation(&some.who, &some.reason), some.profiles.clone());
        let command = if let Some(some) = &step.demote {
            let (operation, profiles) = of(some);
            Command::Demote { operation, profiles }
        } else if let Some(some) = &step.release {
            let (operation, profiles) = of(some);
            Command::Release { operation, profiles }
        } else if let Some(again) = &step.repeat {
            self.ended_before();
            Command::Repeat { operation: operation(&again.who, &again.reason), stage: again.stage }
        } else if let Some(details) = &step.restrict {
            Command::Restrict(operation_of(details))
        } else if let Some(details) = &step.rollback {
            Command::Rollback(operation_of(details))
        } else if let Some(details) = &step.pause {
            Command::Pause(operation_of(details))
        } else if let Some(details) = &step.resume {
            Command::Resume(operation_of(details))
        } else if let Some(details) = &step.go_on {
            Command::Continue(operation_of(details))
        } else if let Some(details) = &step.anchor {
            Command::Anchor(operation_of(details))
        } else {
            return Ok(StepEnd::Done);
        };
        self.accept(command)
    }

    /// A result from before a re-evaluation does not count.
    const fn ended_before(&mut self) {
        self.confirmed = false;
    }

    /// Lets the store's administrator enroll all persons that the steps need.
    pub(super) fn enrol(&mut self, steps: &[ScriptStep]) -> Result<(), CliError> {
        let decisions_of =
            |step: &ScriptStep| [&step.approve, &step.reject, &step.break_glass].map(Option::clone);
        let mut roles: BTreeMap<String, Role> = BTreeMap::new();
        for DecisionStep { who, role, .. } in steps.iter().flat_map(decisions_of).flatten() {
            let known = roles.entry(who).or_insert(role);
            if role != Role::Engineer && *known == Role::Engineer {
                *known = role;
            }
        }
        let requesters = steps.iter().filter_map(|step| step.register.as_ref()?.requester());
        for who in requesters {
            roles.entry(who.to_owned()).or_insert(Role::Engineer);
        }
        for (who, role) in roles {
            let command =
                scripted_approver::enrolment(self.pump.engine(), &who, role).map_err(CliError::usage)?;
            if let Some(command) = command {
                self.accept(command)?;
            }
        }
        Ok(())
    }

    /// Signs a break-glass activation as a named person whose key is in the store's folder.
    fn break_glass(&mut self, details: &DecisionStep) -> Result<StepEnd, CliError> {
        let snapshot = self.pump.engine().snapshot();
        let is_ours = |version: &CapabilityId| self.candidate.as_ref().is_none_or(|ours| ours == version);
        let Some(request) = snapshot.emergencies.into_iter().find(|request| is_ours(&request.version)) else {
            let error = CliError::usage("no version waits for break-glass");
            return Err(error.with_details(ErrorReason::NotNow));
        };
        let command = scripted_approver::answer(
            &mut self.pump,
            &request,
            &details.who,
            ApprovalDecision::Approve,
            &details.reason,
        )
        .map_err(CliError::usage)?;
        self.accept(command)
    }

    /// Receives and prints the engine's events.
    pub(super) fn take_events(&mut self) -> Result<(), CliError> {
        let events = self.pump.deliver_events();
        self.print_events(&events)
    }

    /// Prints events, and fails if the engine halts.
    pub(super) fn print_events(&mut self, events: &[Event]) -> Result<(), CliError> {
        for event in events {
            self.learn(&event.kind);
            self.printer.event(event)?;
        }
        match self.pump.engine().holding() {
            None => Ok(()),
            Some(why) => {
                let error = CliError::internal(format!("the engine halted: {}", why.sentence()));
                Err(error.with_details(ErrorReason::Holding))
            }
        }
    }

    fn learn(&mut self, kind: &EventKind) {
        let is_ours = |version: &CapabilityId| self.candidate.as_ref() == Some(version);
        let (stage, reasons) = match kind {
            EventKind::Decided { version, stage, reasons, .. } if is_ours(version) => {
                (Decider::from(*stage), reasons)
            }
            EventKind::Monitor { version, reasons, .. } if is_ours(version) => (Decider::Monitor, reasons),
            EventKind::Confirmed { version, .. } if is_ours(version) => {
                self.confirmed = true;
                return;
            }
            _ => return,
        };
        let added = reasons.iter().map(|reason| StageReason {
            stage,
            dimension: reason.dimension,
            code: reason.code,
        });
        self.reasons.extend(added);
    }

    fn submit(&mut self, command: Command) -> Result<Reply, CliError> {
        self.requests += 1;
        let request = Request::unsigned(format!("script-{}", self.requests), command);
        let reply = self.pump.submit(request);
        self.take_events()?;
        Ok(reply)
    }

    fn accept(&mut self, command: Command) -> Result<StepEnd, CliError> {
        accepted(self.submit(command)?)
    }

    pub(super) fn register(&mut self, folder: &str, by: Option<&str>) -> Result<StepEnd, CliError> {
        let candidate = embedded::read(Path::new(folder)).map_err(CliError::usage)?;
        let package = Package::clone(&candidate.package);
        let command = Command::Register { package, name: folder.to_owned(), by: by.map(ToOwned::to_owned) };
        // The id is known before the events are read, so none is missed.
        self.candidate = Some(candidate.id());
        self.reasons.clear();
        self.confirmed = false;
        match self.submit(command)? {
            Reply::Refused { code: Refusal::Exists, text, .. } => self.go_on_with(&candidate.digest(), text),
            reply => accepted(reply),
        }
    }

    /// Continues an interrupted run on its store, from the version's state. A finished run is not judged again.
    fn go_on_with(&mut self, digest: &Digest, refusal: String) -> Result<StepEnd, CliError> {
        let open = self.view().filter(|view| {
            view.digest == *digest && !view.state.is_terminal() && !view.flags.provisional && !view.confirmed
        });
        let Some(view) = open else {
            let hint = "a scenario needs a store without its versions: leave out --data for a temporary store, \
                        or name an empty folder with --data DIR";
            return Err(CliError::usage(refusal).with_hint(hint).with_details(ErrorReason::Exists));
        };
        self.note(&sentences::registered_by_interrupted(&view.version, view.state))?;
        Ok(StepEnd::Done)
    }

    pub(super) fn view(&self) -> Option<CandidateView> {
        let candidate = self.candidate.as_ref()?;
        self.pump.engine().snapshot().candidates.into_iter().find(|view| view.version == *candidate)
    }

    /// Runs until the awaited condition holds, or the time is over.
    fn wait(&mut self, wait: &WaitStep) -> Result<StepEnd, CliError> {
        self.work_until(wait.timeout_s, &|driver, idle| driver.waited_for(wait, idle))
    }

    /// Runs the live cell until the awaited alarm is raised; without it the step fails.
    fn work(&mut self, work: &LiveStep, index: usize) -> Result<StepEnd, CliError> {
        let raised = |driver: &Self| {
            let alarms = driver.pump.engine().snapshot().alarms;
            work.until.is_some_and(|kind| {
                alarms.iter().any(|alarm| alarm.alarm.parse().is_ok_and(|key: AlarmKey| key.kind() == kind))
            })
        };
        for _ in 0..work.sequences {
            if self.is_over() || raised(self) {
                return Ok(StepEnd::Done);
            }
            self.pump.work_one();
            let (_, events) = self.pump.turn();
            self.print_events(&events)?;
        }
        match work.until {
            Some(kind) if !raised(self) => {
                let text = format!(
                    "step {}: no alarm {kind} was raised within {} sequences",
                    index + 1,
                    work.sequences
                );
                self.unmet(index, text)
            }
            _ => Ok(StepEnd::Done),
        }
    }

    /// Runs until the time is over.
    fn pass(&mut self, secs: f64) -> Result<StepEnd, CliError> {
        self.work_until(secs, &|_, _| false)?;
        Ok(StepEnd::Done)
    }

    fn work_until(&mut self, secs: f64, is_so: &dyn Fn(&Self, bool) -> bool) -> Result<StepEnd, CliError> {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked at the edge")]
        let deadline_ms = self.pump.engine().now_ms().saturating_add((secs * 1000.0) as u64);
        loop {
            if is_so(self, false) {
                return Ok(StepEnd::Done);
            }
            if self.pump.engine().now_ms() >= deadline_ms {
                return Ok(StepEnd::TimedOut);
            }
            let (progress, events) = self.pump.turn();
            self.print_events(&events)?;
            if let SliceOutcome::Idle { next_ms } = progress {
                if is_so(self, true) {
                    return Ok(StepEnd::Done);
                }
                let next_ms = next_ms.unwrap_or(deadline_ms).min(deadline_ms);
                if !self.pump.jump_to(next_ms) {
                    return Ok(StepEnd::TimedOut);
                }
            }
        }
    }

    fn waited_for(&self, wait: &WaitStep, idle: bool) -> bool {
        if let Some(prompt) = &wait.prompt {
            let prompts = self.pump.engine().snapshot().prompts;
            return prompts.iter().any(|open| prompt.is_about(&open.version));
        }
        if let Some(question) = &wait.question {
            let questions = self.pump.engine().snapshot().questions;
            return questions.iter().any(|open| question.is_about(&open.version));
        }
        let Some(view) = self.view() else { return false };
        match wait.state {
            Some(ScenarioState::Confirmed) => self.confirmed,
            Some(ScenarioState::Settled) => self.is_settled(&view, idle),
            Some(ScenarioState::In(state)) => view.state == state,
            None => false,
        }
    }

    /// The candidate changes no more without a further command.
    fn is_settled(&self, view: &CandidateView, idle: bool) -> bool {
        let ended = view.state.is_terminal() || self.confirmed;
        ended || (idle && self.pump.engine().snapshot().prompts.is_empty() && !view.flags.provisional)
    }

    /// Signs a decision on the open request as a named person whose key is in the store's folder.
    fn sign_decision(
        &mut self,
        details: &DecisionStep,
        decision: ApprovalDecision,
    ) -> Result<StepEnd, CliError> {
        let snapshot = self.pump.engine().snapshot();
        let is_ours = |version: &CapabilityId| self.candidate.as_ref().is_none_or(|ours| ours == version);
        let Some(prompt) = snapshot.prompts.into_iter().find(|prompt| is_ours(&prompt.version)) else {
            let error = CliError::usage("no version waits for a decision");
            return Err(error.with_details(ErrorReason::NotNow));
        };
        let command =
            scripted_approver::answer(&mut self.pump, &prompt, &details.who, decision, &details.reason)
                .map_err(CliError::usage)?;
        self.accept(command)
    }

    fn drift(&mut self, drift: &DriftStep) -> Result<StepEnd, CliError> {
        self.accept(Command::Drift { kind: Some(drift.kind), magnitude: Some(drift.magnitude) })
    }

    fn expect(&mut self, expect: &ExpectStep, index: usize) -> Result<StepEnd, CliError> {
        let Err(unmet) = self.unmet_expectation(expect) else { return Ok(StepEnd::Done) };
        self.unmet(index, format!("step {}: {unmet}", index + 1))
    }

    /// Ends the run: something that the scenario expects does not hold. With `--json` a line of the output says so, too.
    fn unmet(&mut self, index: usize, text: String) -> Result<StepEnd, CliError> {
        self.printer.unmet(index + 1, &text)?;
        Err(CliError::unmet(text))
    }

    /// What of an expectation does not hold.
    fn unmet_expectation(&self, expect: &ExpectStep) -> Result<(), String> {
        let Some(view) = self.view() else { return Err("no candidate was registered".to_owned()) };
        let confirmed = self.confirmed && view.state == State::Active;
        let fits = match expect.state {
            ScenarioState::In(state) => view.state == state,
            ScenarioState::Confirmed => confirmed,
            ScenarioState::Settled => false,
        };
        if !fits {
            let state = if confirmed { ScenarioState::Confirmed } else { ScenarioState::In(view.state) };
            let expected = expect.state.name();
            return Err(format!("{} is {}, expected {expected}", view.version, state.name()));
        }
        let Some(code) = expect.reason else { return Ok(()) };
        let fits = |reason: &StageReason| {
            reason.code == code
                && expect.stage.is_none_or(|stage| stage == reason.stage)
                && expect.dimension.is_none_or(|dimension| dimension == reason.dimension)
        };
        // People's decisions belong to no stage, but to the candidate.
        let decisions = view.reasons.iter().filter(|reason| reason.code.is_from_people());
        let stage = expect.stage.unwrap_or(Decider::Activation);
        let from_people: Vec<StageReason> = decisions
            .map(|reason| StageReason { stage, dimension: reason.dimension, code: reason.code })
            .collect();
        if self.reasons.iter().chain(&from_people).any(fits) {
            return Ok(());
        }
        let known: Vec<String> =
            self.reasons.iter().map(|g| format!("{}/{}/{}", g.stage, g.dimension, g.code)).collect();
        Err(format!("the reason {:?} was not given; the reasons are {}", code.as_str(), known.join(", ")))
    }

    /// The exit code of one stage: passed, rejected, or on hold.
    pub(super) fn finish_stage(mut self, stage: Stage) -> Result<Exit, CliError> {
        let passed = match stage {
            Stage::Validation => State::Validated,
            Stage::Sandbox => State::Sandboxed,
            Stage::Shadow => State::Shadowed,
            Stage::Activation => State::Active,
        };
        let exit = match self.view().map(|view| view.state) {
            Some(state) if state == passed => Exit::Confirmed,
            Some(State::Rejected) => Exit::Rejected,
            Some(_) | None => Exit::Held,
        };
        let outcome = if exit == Exit::Confirmed { "passed" } else { exit.outcome_label() };
        self.end(&format!("outcome: {outcome}"))?;
        Ok(exit)
    }

    /// The exit code of the last candidate's result.
    pub(super) fn finish(mut self) -> Result<Exit, CliError> {
        let followed =
            self.view().map(|view| FollowedVersion { exit: outcome_of(&view), version: view.version });
        let message =
            followed.as_ref().map_or_else(|| sentences::NO_VERSION_SUBMITTED.to_owned(), ToString::to_string);
        self.end(&message)?;
        Ok(followed.map_or(Exit::NothingJudged, |followed| followed.exit))
    }

    /// Ends the engine and prints the outcome.
    fn end(&mut self, message: &str) -> Result<(), CliError> {
        self.requests += 1;
        let id = format!("script-{}", self.requests);
        self.pump.submit(Request::unsigned(id, Command::Shutdown));
        self.take_events()?;
        // Only here: a script's records then have the same places at any speed of the sink's thread.
        let events = self.pump.finish();
        self.print_events(&events)?;
        self.note(message)
    }
}

fn accepted(reply: Reply) -> Result<StepEnd, CliError> {
    match reply {
        Reply::Refused { code, text, hint } => {
            Err(CliError::usage(Problem::from((text, hint))).with_details(refusal_reason(code)))
        }
        Reply::Stopped { text, kept: StopPersistence::InMark | StopPersistence::InMemory } => {
            Err(CliError::usage(text).with_details(ErrorReason::Store))
        }
        // Done, or the data that it asked for.
        _ => Ok(StepEnd::Done),
    }
}
