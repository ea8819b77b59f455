//! Drives an engine from a scenario, or through the demonstration, and prints what it tells.

use std::io::{self, Write};
use std::path::Path;

use holdpoint_sim::robot::RobotModel;

use super::script::{DriftStep, Expect, Say, Script, Wait};
use crate::error::{CliError, Exit};
use holdpoint_engine::cell::Cell;
use holdpoint_engine::door::Signals;
use holdpoint_engine::embedded;
use holdpoint_engine::pipeline::Progress;
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_lab::approver;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::MakeSink;
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_protocol::words;
use holdpoint_text::{Hint, Problem};

/// A scripted run.
pub struct RunScript<'a> {
    /// The scenario file.
    pub script: &'a Path,
    /// The store's folder; a fresh one that is removed afterwards where none is given.
    pub data: Option<&'a Path>,
    /// A folder of cached episodes that runs share.
    pub cache: Option<&'a Path>,
    /// The run's seed in place of the script's.
    pub seed: Option<u64>,
    /// Workers for evaluation.
    pub jobs: usize,
    /// A robot's URDF file in place of the built-in arm.
    pub robot: Option<&'a Path>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Who listens besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
}

/// The demonstration, printed as it happens.
pub struct RunPlain<'a> {
    /// The store's folder.
    pub data: &'a Path,
    /// The profile.
    pub profile: ProfileName,
    /// The run's seed.
    pub seed: u64,
    /// Workers for evaluation.
    pub jobs: usize,
    /// A robot's URDF file in place of the built-in arm.
    pub robot: Option<&'a Path>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Simulated seconds of the live cell in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Who listens besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
}

/// The pause of the demonstration while it waits for people.
const IDLE_PAUSE: std::time::Duration = std::time::Duration::from_millis(200);

/// The pause while the live cell works at a pace of its own: what it did is taken in soon.
const PACED_PAUSE: std::time::Duration = std::time::Duration::from_millis(15);

/// The seed where neither script nor command line name one.
const DEFAULT_SEED: u64 = 1;

/// Runs a scenario to its end.
///
/// # Errors
/// [`CliError`] with exit code 2 for what is wrong with the input, 70 for what is wrong inside and
/// for an expectation that does not hold.
pub fn run_script(run: RunScript<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let shown = holdpoint_text::Untrusted::new(run.script.display().to_string()).line().into_string();
    let text = std::fs::read_to_string(run.script)
        .map_err(|error| CliError::usage(format!("cannot read {shown}: {error}")))?;
    let script = Script::parse(&shown, &text).map_err(CliError::usage)?;
    let fresh;
    let data = match run.data {
        Some(data) => data,
        None => {
            fresh = tempfile::tempdir()
                .map_err(|error| CliError::usage(format!("cannot make a temporary folder: {error}")))?;
            fresh.path()
        }
    };
    let engine = Engine::start(Config {
        data,
        profile: script.profile,
        seed: run.seed.or(script.seed).unwrap_or(DEFAULT_SEED),
        jobs: run.jobs,
        scripted: true,
        cell: cell(run.robot)?,
        cache: run.cache.map_or(EpisodeCache::InStore, |folder| EpisodeCache::Shared(folder.to_owned())),
    })
    .map_err(start_error)?;
    let mut pump = Pump::new(engine, run.sinks);
    if let Some(pictures) = pump.pictures() {
        pump.engine.draw_live_world(pictures);
    }
    let mut driver = Driver::new(pump, Printer { out, json: run.json, gone: false });
    driver.take_events()?;
    for (index, step) in script.steps.iter().enumerate() {
        let done = if let Some(folder) = &step.register {
            driver.register(folder)
        } else if let Some(wait) = &step.wait {
            driver.wait(wait)
        } else if let Some(say) = &step.approve {
            driver.say(say, Answer::Approve)
        } else if let Some(say) = &step.reject {
            driver.say(say, Answer::Reject)
        } else if let Some(drift) = &step.drift {
            driver.drift(drift)
        } else if let Some(fault) = &step.fault {
            driver.accept(Command::LiveFault { fault: Some(fault.kind.name().to_owned()) })
        } else if let Some(expect) = &step.expect {
            driver.expect(expect, index)
        } else {
            Ok(Step::Done)
        }?;
        if done == Step::TimedOut {
            driver.note(&format!("step {} timed out", index + 1))?;
            break;
        }
    }
    driver.finish()
}

/// Runs the demonstration in real time: the first embedded candidate that is not registered yet, to
/// its end. Other programs can talk to the engine meanwhile.
///
/// # Errors
/// As [`run_script`].
pub fn run_plain(run: RunPlain<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let engine = Engine::start(Config {
        data: run.data,
        profile: run.profile,
        seed: run.seed,
        jobs: run.jobs,
        scripted: false,
        cell: cell(run.robot)?,
        cache: EpisodeCache::InStore,
    })
    .map_err(start_error)?;
    let mut pump = Pump::new(engine, run.sinks);
    match (run.pace, pump.pictures()) {
        // Nobody looks at the pictures.
        (Some(pace), None) => pump.engine.pace_live_world(Some(pace), std::sync::Arc::new(|_| ())),
        (Some(pace), Some(pictures)) => pump.engine.pace_live_world(Some(pace), pictures),
        (None, Some(pictures)) => pump.engine.draw_live_world(pictures),
        (None, None) => {}
    }
    pump.open_door(Signals::Taken).map_err(CliError::usage)?;
    let mut driver = Driver::new(pump, Printer { out, json: run.json, gone: false });
    driver.take_events()?;
    let known: Vec<CapabilityId> =
        driver.pump.engine.snapshot().candidates.into_iter().map(|candidate| candidate.version).collect();
    let Some(name) = embedded::names_beside(&known).next() else {
        driver
            .note("every demonstration candidate is registered; see `holdpoint candidate register <dir>`")?;
        return driver.finish();
    };
    driver.note(&format!("submitting the demonstration candidate {name}"))?;
    driver.register(name)?;
    loop {
        let (progress, events) = driver.pump.turn();
        driver.tell(&events)?;
        let idle = matches!(progress, Progress::Idle { .. });
        // With a pace an idle engine may wait for the live cell in the middle of a stage.
        let works = |view: &CandidateView| run.pace.is_some() && view.flags.running.is_some();
        let settled = driver.view().is_some_and(|view| driver.is_settled(&view, idle) && !works(&view));
        if settled || driver.printer.gone || driver.pump.engine.has_ended() {
            return driver.finish();
        }
        if idle {
            driver.pump.wait(if run.pace.is_some() { PACED_PAUSE } else { IDLE_PAUSE });
        }
    }
}

fn cell(robot: Option<&Path>) -> Result<Cell, CliError> {
    let model = match robot {
        None => RobotModel::builtin("arm7"),
        Some(path) => RobotModel::load(path),
    };
    model.and_then(Cell::new).map_err(|error| CliError::usage(error.to_string()))
}

/// What cannot be opened or read is the caller's to mend; a fault of the engine is not.
fn start_error(error: holdpoint_engine::StartError) -> CliError {
    match &error {
        holdpoint_engine::StartError::Fault(_) => CliError::internal(error.sentence()),
        _ => CliError::usage(error),
    }
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Done,
    TimedOut,
}

/// Prints events; a reader that goes away is a clean end.
struct Printer<'a> {
    out: &'a mut dyn Write,
    json: bool,
    gone: bool,
}

impl Printer<'_> {
    fn line(&mut self, line: &str) -> Result<(), CliError> {
        if self.gone {
            return Ok(());
        }
        match writeln!(self.out, "{line}").and_then(|()| self.out.flush()) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                self.gone = true;
                Ok(())
            }
            Err(error) => Err(CliError::internal(format!("cannot print: {error}"))),
        }
    }

    fn event(&mut self, event: &Event) -> Result<(), CliError> {
        if self.json {
            let line = serde_json::to_string(event).map_err(CliError::internal)?;
            return self.line(&holdpoint_text::escape_json(&line));
        }
        self.line(&words::line(event))
    }
}

/// A reason that was given for the candidate: at which stage, about what.
struct Given {
    stage: String,
    dimension: String,
    code: String,
}

struct Driver<'a> {
    pump: Pump,
    printer: Printer<'a>,
    requests: u64,
    candidate: Option<CapabilityId>,
    given: Vec<Given>,
    confirmed: bool,
    rolled_back: bool,
}

impl<'a> Driver<'a> {
    fn new(pump: Pump, printer: Printer<'a>) -> Self {
        Self {
            pump,
            printer,
            requests: 0,
            candidate: None,
            given: Vec::new(),
            confirmed: false,
            rolled_back: false,
        }
    }

    fn note(&mut self, text: &str) -> Result<(), CliError> {
        if self.printer.json {
            let line = serde_json::json!({ "event": "note", "text": text }).to_string();
            return self.printer.line(&line);
        }
        self.printer.line(&format!("         {text}"))
    }

    /// Takes and prints what the engine tells.
    fn take_events(&mut self) -> Result<(), CliError> {
        let events = self.pump.tell();
        self.tell(&events)
    }

    /// Prints events, and holds where the engine does.
    fn tell(&mut self, events: &[Event]) -> Result<(), CliError> {
        for event in events {
            self.learn(&event.kind);
            self.printer.event(event)?;
        }
        match self.pump.engine.holding() {
            None => Ok(()),
            Some(why) => Err(CliError::internal(format!("the engine holds: {why}"))),
        }
    }

    fn learn(&mut self, kind: &EventKind) {
        let is_ours = |version: &CapabilityId| self.candidate.as_ref() == Some(version);
        let (stage, reasons) = match kind {
            EventKind::Decided { version, stage, reasons, .. } if is_ours(version) => (stage.name(), reasons),
            EventKind::Monitor { version, reasons, .. } if is_ours(version) => ("monitor", reasons),
            EventKind::Confirmed { version, .. } if is_ours(version) => {
                self.confirmed = true;
                return;
            }
            EventKind::RolledBack { version, .. } if is_ours(version) => {
                self.rolled_back = true;
                return;
            }
            _ => return,
        };
        let given = reasons.iter().map(|reason| Given {
            stage: stage.to_owned(),
            dimension: holdpoint_engine::word(&reason.dimension),
            code: reason.code.to_string(),
        });
        self.given.extend(given);
    }

    fn submit(&mut self, command: Command) -> Result<Reply, CliError> {
        self.requests += 1;
        let request = Request { id: format!("script-{}", self.requests), command };
        let reply = self.pump.engine.submit(request);
        self.take_events()?;
        Ok(reply)
    }

    fn accept(&mut self, command: Command) -> Result<Step, CliError> {
        match self.submit(command)? {
            Reply::Accepted { .. }
            | Reply::Snapshot { .. }
            | Reply::Detail { .. }
            | Reply::Registry { .. }
            | Reply::Audit { .. }
            | Reply::Verified { .. } => Ok(Step::Done),
            Reply::Refused { text, hint, .. } => Err(CliError::usage(Problem::from((text, hint)))),
        }
    }

    fn register(&mut self, folder: &str) -> Result<Step, CliError> {
        let candidate = embedded::read(Path::new(folder)).map_err(CliError::usage)?;
        let package = Package::clone(&candidate.package);
        let command = Command::Register { package, name: folder.to_owned() };
        // The id is known before the events are read, so that none of them is missed.
        self.candidate = Some(candidate.id());
        self.given.clear();
        self.confirmed = false;
        self.rolled_back = false;
        self.accept(command)
    }

    fn view(&self) -> Option<CandidateView> {
        let candidate = self.candidate.as_ref()?;
        self.pump.engine.snapshot().candidates.into_iter().find(|view| view.version == *candidate)
    }

    /// Works until what is waited for is so, or the time is over.
    fn wait(&mut self, wait: &Wait) -> Result<Step, CliError> {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked at the edge")]
        let deadline_ms = self.pump.engine.now_ms().saturating_add((wait.timeout_s * 1000.0) as u64);
        loop {
            if self.printer.gone {
                return Ok(Step::TimedOut);
            }
            if self.waited_for(wait, false) {
                return Ok(Step::Done);
            }
            if self.pump.engine.now_ms() >= deadline_ms {
                return Ok(Step::TimedOut);
            }
            let progress = self.pump.engine.advance();
            self.take_events()?;
            if let Progress::Idle { next_ms } = progress {
                if self.waited_for(wait, true) {
                    return Ok(Step::Done);
                }
                let next_ms = next_ms.unwrap_or(deadline_ms).min(deadline_ms);
                if !self.pump.engine.jump_to(next_ms) {
                    return Ok(Step::TimedOut);
                }
            }
        }
    }

    fn waited_for(&self, wait: &Wait, idle: bool) -> bool {
        if let Some(prompt) = &wait.prompt {
            let prompts = self.pump.engine.snapshot().prompts;
            return prompts.iter().any(|open| prompt == "any" || open.version.to_string() == *prompt);
        }
        let Some(view) = self.view() else { return false };
        match wait.state.as_deref() {
            Some("confirmed") => self.confirmed,
            Some("settled") => self.is_settled(&view, idle),
            Some(state) => view.state.name() == state,
            None => false,
        }
    }

    /// Nothing more happens to the candidate by itself.
    fn is_settled(&self, view: &CandidateView, idle: bool) -> bool {
        let ended = view.state.is_terminal() || self.confirmed;
        ended || (idle && self.pump.engine.snapshot().prompts.is_empty() && !view.flags.provisional)
    }

    /// Signs a decision over the open prompt, as a named person whose key is in the store's folder.
    fn say(&mut self, say: &Say, decision: Answer) -> Result<Step, CliError> {
        let snapshot = self.pump.engine.snapshot();
        let ours = |version: &CapabilityId| self.candidate.as_ref().is_none_or(|ours| ours == version);
        let Some(prompt) = snapshot.prompts.into_iter().find(|prompt| ours(&prompt.version)) else {
            return Err(CliError::usage("nothing waits for a decision"));
        };
        let command = approver::answer(&self.pump.engine, &prompt, &say.who, decision, &say.reason)
            .map_err(CliError::usage)?;
        self.accept(command)
    }

    fn drift(&mut self, drift: &DriftStep) -> Result<Step, CliError> {
        let word = |value: serde_json::Result<serde_json::Value>| {
            value.ok().and_then(|value| value.as_str().map(ToOwned::to_owned)).unwrap_or_default()
        };
        let kind = word(serde_json::to_value(drift.kind));
        let magnitude = word(serde_json::to_value(drift.magnitude));
        self.accept(Command::Drift { kind: Some(kind), magnitude })
    }

    fn expect(&mut self, expect: &Expect, index: usize) -> Result<Step, CliError> {
        let fail = |what: String| Err(CliError::internal(format!("step {}: {what}", index + 1)));
        let Some(view) = self.view() else { return fail("nothing was registered".to_owned()) };
        let state =
            if self.confirmed && view.state == State::Active { "confirmed" } else { view.state.name() };
        if state != expect.state && view.state.name() != expect.state {
            return fail(format!("{} is {state}, {} was expected", view.version, expect.state));
        }
        let Some(code) = &expect.reason else { return Ok(Step::Done) };
        let fits = |given: &Given| {
            given.code == *code
                && expect.stage.as_ref().is_none_or(|stage| *stage == given.stage)
                && expect.dimension.as_ref().is_none_or(|dimension| *dimension == given.dimension)
        };
        let standing = view.reasons.iter().map(|reason| Given {
            stage: expect.stage.clone().unwrap_or_default(),
            dimension: holdpoint_engine::word(&reason.dimension),
            code: reason.code.to_string(),
        });
        // What people said is no stage's decision; it stands with the candidate.
        let standing: Vec<Given> = standing.filter(|given| given.code.starts_with("approval-")).collect();
        if self.given.iter().chain(&standing).any(fits) {
            return Ok(Step::Done);
        }
        let known: Vec<String> =
            self.given.iter().map(|g| format!("{}/{}/{}", g.stage, g.dimension, g.code)).collect();
        fail(format!("the reason {code:?} was not given; given were {}", known.join(", ")))
    }

    /// The exit code by what became of the last candidate.
    fn finish(mut self) -> Result<Exit, CliError> {
        let exit = match self.view() {
            None => Exit::Confirmed,
            Some(view) => match view.state {
                State::Active if self.confirmed => Exit::Confirmed,
                State::Rejected => Exit::Rejected,
                State::RolledBack => Exit::RolledBack,
                State::Demoted if self.rolled_back => Exit::RolledBack,
                State::Registered
                | State::Validated
                | State::Sandboxed
                | State::Shadowed
                | State::Active
                | State::Demoted
                | State::Superseded => Exit::Held,
            },
        };
        self.requests += 1;
        let id = format!("script-{}", self.requests);
        self.pump.engine.submit(Request { id, command: Command::Shutdown });
        self.take_events()?;
        // Here and not before: a script's records are then in the same places whatever the sink's thread does.
        let events = self.pump.finish();
        self.tell(&events)?;
        self.note(&format!("outcome: {}", outcome(exit)))?;
        Ok(exit)
    }
}

const fn outcome(exit: Exit) -> &'static str {
    match exit {
        Exit::Confirmed => "confirmed",
        Exit::Rejected => "rejected",
        Exit::Usage => "usage",
        Exit::Held => "held",
        Exit::RolledBack => "rolled back",
        Exit::Internal => "internal error",
    }
}
