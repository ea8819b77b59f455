//! Drives an engine step by step: gives commands, waits, and keeps what was said of the last candidate.
//!
//! Owns when a step has ended and what became of the candidate; must not judge it.

use std::collections::BTreeMap;
use std::path::Path;

use super::outcome::{Followed, outcome_of};
use super::printer::Printer;
use super::script::{DriftStep, Expect, LiveWork, Profiles, Say, Step, Wait};
use crate::error::{CliError, Exit};
use holdpoint_engine::embedded;
use holdpoint_engine::pipeline::Progress;
use holdpoint_engine::pump::Pump;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::approval::{Answer, Role};
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::submission::Package;
use holdpoint_lab::approver;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply, Request, StopKept};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_protocol::standing::{Decider, Stands};
use holdpoint_text::{Hint as _, Problem};

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepEnd {
    Done,
    TimedOut,
}

/// A reason that was given for the candidate: at which stage, about what.
#[derive(Clone, Copy)]
struct Given {
    stage: Decider,
    dimension: Dimension,
    code: ReasonCode,
}

/// An engine, and what is known of the candidate that was registered last.
pub(super) struct Driver<'a> {
    pub(super) pump: Pump,
    printer: Printer<'a>,
    requests: u64,
    candidate: Option<CapabilityId>,
    given: Vec<Given>,
    confirmed: bool,
}

impl<'a> Driver<'a> {
    pub(super) fn new(pump: Pump, printer: Printer<'a>) -> Self {
        Self { pump, printer, requests: 0, candidate: None, given: Vec::new(), confirmed: false }
    }

    /// Works a stage that was begun by a call to its end.
    pub(super) fn run_stage(&mut self, id: &CapabilityId, stage: Stage) -> Result<(), CliError> {
        self.candidate = Some(id.clone());
        let reply = self.pump.launch(id, stage);
        self.take_events()?;
        if let Reply::Refused { code, text, hint } = &reply {
            return Err(crate::cli::refused(*code, text, hint.as_deref()));
        }
        while !self.is_over() && self.view().is_some_and(|view| view.flags.running.is_some()) {
            let (_, events) = self.pump.turn();
            self.tell(&events)?;
        }
        Ok(())
    }

    pub(super) fn note(&mut self, text: &str) -> Result<(), CliError> {
        self.printer.note(text)
    }

    /// Nobody reads what is told, or the engine has ended.
    const fn is_over(&self) -> bool {
        self.printer.is_gone() || self.pump.engine().has_ended()
    }

    /// Carries out a step of a scenario; `index` names it in errors.
    pub(super) fn step(&mut self, step: &Step, index: usize) -> Result<StepEnd, CliError> {
        if let Some(candidate) = &step.register {
            self.register(candidate.folder(), candidate.who())
        } else if let Some(wait) = &step.wait {
            self.wait(wait)
        } else if let Some(say) = &step.approve {
            self.say(say, Answer::Approve)
        } else if let Some(say) = &step.reject {
            self.say(say, Answer::Reject)
        } else if let Some(say) = &step.break_glass {
            self.break_glass(say)
        } else if let Some(drift) = &step.drift {
            self.drift(drift)
        } else if let Some(goal) = &step.goal {
            let (by, reason) = ("script".to_owned(), "the script says so".to_owned());
            self.accept(Command::Goal { goal: goal.clone(), by, reason })
        } else if let Some(fault) = &step.fault {
            self.accept(Command::LiveFault { fault: Some(fault.kind) })
        } else if let Some(Say { who, reason, .. }) = &step.stop {
            self.accept(Command::Stop { by: who.clone(), reason: reason.clone() })
        } else if let Some(Say { who, reason, .. }) = &step.go {
            // A script knows what it did.
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

    /// Carries out a step that is an operation on the last candidate.
    fn operate(&mut self, step: &Step) -> Result<StepEnd, CliError> {
        let Some(version) = self.candidate.clone() else {
            return Err(CliError::usage("nothing was registered that the step could be about"));
        };
        let operation = |by: &str, reason: &str| Operation {
            version: version.clone(),
            by: by.to_owned(),
            reason: reason.to_owned(),
        };
        let said = |say: &Say| operation(&say.who, &say.reason);
        let of = |some: &Profiles| (operation(&some.who, &some.reason), some.profiles.clone());
        let command = if let Some(some) = &step.demote {
            let (operation, profiles) = of(some);
            Command::Demote { operation, profiles }
        } else if let Some(some) = &step.release {
            let (operation, profiles) = of(some);
            Command::Release { operation, profiles }
        } else if let Some(again) = &step.repeat {
            self.ended_before();
            Command::Repeat { operation: operation(&again.who, &again.reason), stage: again.stage }
        } else if let Some(say) = &step.restrict {
            Command::Restrict(said(say))
        } else if let Some(say) = &step.rollback {
            Command::Rollback(said(say))
        } else if let Some(say) = &step.pause {
            Command::Pause(said(say))
        } else if let Some(say) = &step.resume {
            Command::Resume(said(say))
        } else if let Some(say) = &step.go_on {
            Command::Continue(said(say))
        } else {
            return Ok(StepEnd::Done);
        };
        self.accept(command)
    }

    /// What became of the candidate before it is evaluated again does not count any more.
    const fn ended_before(&mut self) {
        self.confirmed = false;
    }

    /// Has everybody enrolled whom the steps need, by the store's administrator.
    pub(super) fn enrol(&mut self, steps: &[Step]) -> Result<(), CliError> {
        let said = |step: &Step| [&step.approve, &step.reject, &step.break_glass].map(Option::clone);
        let mut roles: BTreeMap<String, Role> = BTreeMap::new();
        for Say { who, role, .. } in steps.iter().flat_map(said).flatten() {
            let known = roles.entry(who).or_insert(role);
            if role != Role::Engineer && *known == Role::Engineer {
                *known = role;
            }
        }
        let requesters = steps.iter().filter_map(|step| step.register.as_ref()?.who());
        for who in requesters {
            roles.entry(who.to_owned()).or_insert(Role::Engineer);
        }
        for (who, role) in roles {
            let command = approver::enrolment(self.pump.engine(), &who, role).map_err(CliError::usage)?;
            if let Some(command) = command {
                self.accept(command)?;
            }
        }
        Ok(())
    }

    /// Signs an emergency approval of what is held back, as a named person whose key is in the store's folder.
    fn break_glass(&mut self, say: &Say) -> Result<StepEnd, CliError> {
        let snapshot = self.pump.engine().snapshot();
        let ours = |version: &CapabilityId| self.candidate.as_ref().is_none_or(|ours| ours == version);
        let Some(door) = snapshot.emergencies.into_iter().find(|door| ours(&door.version)) else {
            return Err(CliError::usage("nothing is held back that the emergency door is for"));
        };
        let command = approver::answer(&mut self.pump, &door, &say.who, Answer::Approve, &say.reason)
            .map_err(CliError::usage)?;
        self.accept(command)
    }

    /// Takes and prints what the engine tells.
    pub(super) fn take_events(&mut self) -> Result<(), CliError> {
        let events = self.pump.tell();
        self.tell(&events)
    }

    /// Prints events, and holds if the engine does.
    pub(super) fn tell(&mut self, events: &[Event]) -> Result<(), CliError> {
        for event in events {
            self.learn(&event.kind);
            self.printer.event(event)?;
        }
        match self.pump.engine().holding() {
            None => Ok(()),
            Some(why) => Err(CliError::internal(format!("the engine holds: {}", why.sentence()))),
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
        let given =
            reasons.iter().map(|reason| Given { stage, dimension: reason.dimension, code: reason.code });
        self.given.extend(given);
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
        // The id is known before the events are read, so that none of them is missed.
        self.candidate = Some(candidate.id());
        self.given.clear();
        self.confirmed = false;
        match self.submit(command)? {
            Reply::Refused { code: Refusal::Exists, text, .. } => self.go_on_with(&candidate.digest(), text),
            reply => accepted(reply),
        }
    }

    /// A run that was interrupted is repeated on its store: the version goes on from where it stands. One that has
    /// come to its end is not judged again.
    fn go_on_with(&mut self, digest: &Digest, refusal: String) -> Result<StepEnd, CliError> {
        let open = self.view().filter(|view| {
            view.digest == *digest && !view.state.is_terminal() && !view.flags.provisional && !view.confirmed
        });
        let Some(view) = open else {
            let hint = "a scenario begins with versions that its store does not know: leave out --data, and it has a \
                        fresh store, or name an empty folder with --data DIR";
            return Err(CliError::usage(refusal).with_hint(hint));
        };
        let text = format!(
            "{} is registered already, by a run that did not end; it goes on from {}",
            view.version, view.state
        );
        self.note(&text)?;
        Ok(StepEnd::Done)
    }

    pub(super) fn view(&self) -> Option<CandidateView> {
        let candidate = self.candidate.as_ref()?;
        self.pump.engine().snapshot().candidates.into_iter().find(|view| view.version == *candidate)
    }

    /// Works until what is waited for is so, or the time is over.
    fn wait(&mut self, wait: &Wait) -> Result<StepEnd, CliError> {
        self.work_until(wait.timeout_s, &|driver, idle| driver.waited_for(wait, idle))
    }

    /// Lets the live cell work, until an alarm is raised if one is awaited; that it is not is an error.
    fn work(&mut self, work: &LiveWork, index: usize) -> Result<StepEnd, CliError> {
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
            self.tell(&events)?;
        }
        match work.until {
            Some(kind) if !raised(self) => {
                let text = format!(
                    "step {}: no alarm {kind} was raised within {} sequences",
                    index + 1,
                    work.sequences
                );
                Err(CliError::internal(text))
            }
            _ => Ok(StepEnd::Done),
        }
    }

    /// Works until the time is over.
    fn pass(&mut self, secs: f64) -> Result<StepEnd, CliError> {
        let ended = self.work_until(secs, &|_, _| false)?;
        Ok(if self.printer.is_gone() { ended } else { StepEnd::Done })
    }

    fn work_until(&mut self, secs: f64, is_so: &dyn Fn(&Self, bool) -> bool) -> Result<StepEnd, CliError> {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked at the edge")]
        let deadline_ms = self.pump.engine().now_ms().saturating_add((secs * 1000.0) as u64);
        loop {
            if self.printer.is_gone() {
                return Ok(StepEnd::TimedOut);
            }
            if is_so(self, false) {
                return Ok(StepEnd::Done);
            }
            if self.pump.engine().now_ms() >= deadline_ms {
                return Ok(StepEnd::TimedOut);
            }
            let (progress, events) = self.pump.turn();
            self.tell(&events)?;
            if let Progress::Idle { next_ms } = progress {
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

    fn waited_for(&self, wait: &Wait, idle: bool) -> bool {
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
            Some(Stands::Confirmed) => self.confirmed,
            Some(Stands::Settled) => self.is_settled(&view, idle),
            Some(Stands::In(state)) => view.state == state,
            None => false,
        }
    }

    /// Nothing more happens to the candidate by itself.
    fn is_settled(&self, view: &CandidateView, idle: bool) -> bool {
        let ended = view.state.is_terminal() || self.confirmed;
        ended || (idle && self.pump.engine().snapshot().prompts.is_empty() && !view.flags.provisional)
    }

    /// Signs a decision over the open prompt, as a named person whose key is in the store's folder.
    fn say(&mut self, say: &Say, decision: Answer) -> Result<StepEnd, CliError> {
        let snapshot = self.pump.engine().snapshot();
        let ours = |version: &CapabilityId| self.candidate.as_ref().is_none_or(|ours| ours == version);
        let Some(prompt) = snapshot.prompts.into_iter().find(|prompt| ours(&prompt.version)) else {
            return Err(CliError::usage("nothing waits for a decision"));
        };
        let command = approver::answer(&mut self.pump, &prompt, &say.who, decision, &say.reason)
            .map_err(CliError::usage)?;
        self.accept(command)
    }

    fn drift(&mut self, drift: &DriftStep) -> Result<StepEnd, CliError> {
        self.accept(Command::Drift { kind: Some(drift.kind), magnitude: Some(drift.magnitude) })
    }

    fn expect(&mut self, expect: &Expect, index: usize) -> Result<StepEnd, CliError> {
        let fail = |what: String| Err(CliError::internal(format!("step {}: {what}", index + 1)));
        let Some(view) = self.view() else { return fail("nothing was registered".to_owned()) };
        let confirmed = self.confirmed && view.state == State::Active;
        let fits = match expect.state {
            Stands::In(state) => view.state == state,
            Stands::Confirmed => confirmed,
            Stands::Settled => false,
        };
        if !fits {
            let state = if confirmed { Stands::Confirmed } else { Stands::In(view.state) };
            let expected = expect.state.name();
            return fail(format!("{} is {}, {expected} was expected", view.version, state.name()));
        }
        let Some(code) = expect.reason else { return Ok(StepEnd::Done) };
        let fits = |given: &Given| {
            given.code == code
                && expect.stage.is_none_or(|stage| stage == given.stage)
                && expect.dimension.is_none_or(|dimension| dimension == given.dimension)
        };
        // What people said is no stage's decision; it stands with the candidate.
        let said = view.reasons.iter().filter(|reason| reason.code.is_of_people());
        let stage = expect.stage.unwrap_or(Decider::Activation);
        let standing: Vec<Given> =
            said.map(|reason| Given { stage, dimension: reason.dimension, code: reason.code }).collect();
        if self.given.iter().chain(&standing).any(fits) {
            return Ok(StepEnd::Done);
        }
        let known: Vec<String> =
            self.given.iter().map(|g| format!("{}/{}/{}", g.stage, g.dimension, g.code)).collect();
        fail(format!("the reason {:?} was not given; given were {}", code.as_str(), known.join(", ")))
    }

    /// The exit code by what one stage came to: passed, rejected, or held.
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
        let said = if exit == Exit::Confirmed { "passed" } else { exit.word() };
        self.end(&format!("outcome: {said}"))?;
        Ok(exit)
    }

    /// The exit code by what became of the last candidate.
    pub(super) fn finish(mut self) -> Result<Exit, CliError> {
        let followed = self.view().map(|view| Followed { exit: outcome_of(&view), version: view.version });
        let said = followed
            .as_ref()
            .map_or_else(|| "nothing was judged: no version was submitted".to_owned(), ToString::to_string);
        self.end(&said)?;
        Ok(followed.map_or(Exit::NothingJudged, |followed| followed.exit))
    }

    /// Ends the engine and says how it ended.
    fn end(&mut self, said: &str) -> Result<(), CliError> {
        self.requests += 1;
        let id = format!("script-{}", self.requests);
        self.pump.submit(Request::unsigned(id, Command::Shutdown));
        self.take_events()?;
        // Here and not before: a script's records are then in the same places whatever the sink's thread does.
        let events = self.pump.finish();
        self.tell(&events)?;
        self.note(said)
    }
}

fn accepted(reply: Reply) -> Result<StepEnd, CliError> {
    match reply {
        Reply::Accepted { .. }
        | Reply::Question { .. }
        | Reply::Stopped { kept: StopKept::OnRecord, .. }
        | Reply::Snapshot { .. }
        | Reply::Detail { .. }
        | Reply::Film { .. }
        | Reply::Registry { .. }
        | Reply::Audit { .. }
        | Reply::Health { .. }
        | Reply::Verified { .. } => Ok(StepEnd::Done),
        Reply::Refused { text, hint, .. } => Err(CliError::usage(Problem::from((text, hint)))),
        Reply::Stopped { text, kept: StopKept::InMark | StopKept::InMemory } => Err(CliError::usage(text)),
    }
}
