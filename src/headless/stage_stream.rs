//! Prints upgrades as they happen, without a screen: the waiting candidates of a store, or the demonstration.
//!
//! Input commands run beside it (`commands`). Owns which versions are followed and when they are settled; their
//! results come from the snapshot. A run that followed no version has no outcome.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::commands::{Commands, InputEvent};
use super::exit_status::{FollowedVersion, outcome_of, worst_outcome};
use super::printer::Printer;
use super::scenario_run::cell;
use crate::error::{CliError, Exit, bootstrap_error, refusal_reason, start_error};
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Refusal, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::MakeSink;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};
use holdpoint_service::bootstrap::{EngineBootstrap, LOOK_PATIENCE};
use holdpoint_service::control_socket::{ControlSocket, SignalHandling};
use holdpoint_service::pump::Pump;
use holdpoint_text::{ErrorReason, Hint as _, Problem};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_trials::site::LoadedSite;
use holdpoint_wording::program::run as sentences;

/// The versions that are taken through the stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlainWork {
    /// Waiting candidates, and those submitted meanwhile; submits nothing itself.
    Waiting,
    /// The first embedded candidate that the store does not know.
    Demonstration,
}

/// Upgrades, printed as they happen.
pub struct RunPlain<'a> {
    pub work: PlainWork,
    pub data: &'a Path,
    pub profile: ChosenProfile,
    pub seeds: EpisodeSeeds,
    pub jobs: usize,
    /// A robot's URDF file, instead of the site's robot.
    pub robot: Option<&'a Path>,
    /// The site file; absent for the built-in site.
    pub site: Option<Arc<LoadedSite>>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Simulated seconds of the live cell in each second; absent to advance with the evaluation.
    pub pace: Option<f64>,
    /// Sinks besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
    /// Whether commands are read from the standard input.
    pub commands: bool,
}

/// The pause while a version waits for approval.
const IDLE_PAUSE: Duration = Duration::from_millis(200);

/// The pause while the live cell has its own pace: its events are read soon.
const PACED_PAUSE: Duration = Duration::from_millis(15);

/// Runs in real time until every followed version is settled. Other programs can use the engine meanwhile.
///
/// # Errors
/// [`CliError`] with exit code 2 for invalid input, 70 for a fault.
pub fn run_plain(run: RunPlain<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let bootstrap = EngineBootstrap::open(
        Config {
            data: run.data,
            profile: run.profile,
            seeds: run.seeds,
            jobs: run.jobs,
            scripted: false,
            cell: cell(run.robot, run.site.as_ref())?,
            cache: EpisodeCache::InStore,
        },
        SignalHandling::Handled,
        Box::new(|_| ()),
    )
    .map_err(bootstrap_error)?;
    let mut printer = Printer::new(out, run.json);
    let Some((engine, socket)) = await_engine(bootstrap, &mut printer)? else {
        return Ok(Exit::NothingJudged);
    };
    let mut pump = Pump::with_socket(engine, socket, run.sinks);
    match (run.pace, pump.frame_sink()) {
        // No viewer shows the camera frames.
        (Some(pace), None) => pump.pace_live_world(Some(pace), Arc::new(|_| ())),
        (Some(pace), Some(sink)) => pump.pace_live_world(Some(pace), sink),
        (None, Some(sink)) => pump.draw_live_world(sink),
        (None, None) => {}
    }
    let commands =
        if run.commands { Some(Commands::start(run.data).map_err(CliError::internal)?) } else { None };
    if commands.as_ref().is_some_and(Commands::is_interactive) {
        printer.note(sentences::TYPE_COMMANDS)?;
    }
    let paced = run.pace.is_some();
    let mut stream = PlainStream { pump, printer, versions: BTreeSet::new(), paced, commands };
    let events = stream.pump.deliver_events();
    stream.print(&events)?;
    match run.work {
        PlainWork::Waiting => stream.follow_pending(),
        PlainWork::Demonstration => stream.submit_demonstration()?,
    }
    stream.work()
}

/// The engine, once it has read its history; `None` if it was ended before. Reports a long reading.
fn await_engine(
    mut bootstrap: EngineBootstrap<'_>,
    printer: &mut Printer<'_>,
) -> Result<Option<(Engine, ControlSocket)>, CliError> {
    let started_at = Instant::now();
    let mut is_reported = false;
    while !bootstrap.turn() {
        if !is_reported && bootstrap.has_records() && started_at.elapsed() >= LOOK_PATIENCE {
            is_reported = true;
            printer.note(&sentences::verifying(bootstrap.snapshot().reading))?;
        }
    }
    if bootstrap.has_ended() {
        printer.note(sentences::ENDED_BEFORE_START)?;
        return Ok(None);
    }
    bootstrap.enter().map(Some).map_err(start_error)
}

/// An engine with printed events, and the followed versions.
struct PlainStream<'a> {
    pump: Pump,
    printer: Printer<'a>,
    versions: BTreeSet<CapabilityId>,
    /// Whether the live cell has a thread of its own.
    paced: bool,
    /// The commands on the input, if it is read.
    commands: Option<Commands>,
}

impl PlainStream<'_> {
    fn follow_pending(&mut self) {
        let candidates = self.pump.engine().snapshot().candidates;
        let open = candidates.into_iter().filter(|view| !is_over(view));
        self.versions = open.map(|view| view.version).collect();
    }

    fn submit_demonstration(&mut self) -> Result<(), CliError> {
        let known = self.pump.engine().snapshot().candidates;
        let known: Vec<CapabilityId> = known.into_iter().map(|view| view.version).collect();
        let Some(name) = embedded::names_beside(&known).next() else {
            return self.printer.note(sentences::NO_DEMONSTRATION_LEFT);
        };
        self.printer.note(&sentences::submits_demonstration(name))?;
        let candidate = embedded::read(Path::new(name)).map_err(CliError::usage)?;
        let package = Package::clone(&candidate.package);
        let command = Command::Register { package, name: name.to_owned(), by: None };
        let reply = self.pump.submit(Request::unsigned("demonstration".to_owned(), command));
        match reply {
            // The demonstration has no identity and signs nothing.
            Reply::Refused { code: Refusal::NotAllowed, text, .. } => {
                let hint = "`holdpoint demo` without --data runs in a temporary store; or run `:demo` in the console";
                return Err(CliError::usage(text).with_hint(hint).with_details(ErrorReason::NotAllowed));
            }
            Reply::Refused { code, text, hint } => {
                let error = CliError::usage(Problem::from((text, hint)));
                return Err(error.with_details(refusal_reason(code)));
            }
            _ => {}
        }
        let events = self.pump.deliver_events();
        self.print_events(&events)
    }

    /// Runs until all followed versions are settled, or the engine gets a signal to end. If the reader is gone, a run with
    /// commands ends at once, another one when it only waits: the exit code is then that of the whole run.
    fn work(mut self) -> Result<Exit, CliError> {
        loop {
            if self.versions.is_empty() && !self.keeps_run_going() {
                return self.finish();
            }
            let (progress, events) = self.pump.turn();
            self.print_events(&events)?;
            let idle = matches!(progress, SliceOutcome::Idle { .. });
            let gone = self.printer.is_gone() && (idle || self.commands.is_some());
            let over = gone || self.pump.engine().has_ended();
            if over || self.take_commands()? || (self.is_settled(idle) && !self.keeps_run_going()) {
                return self.finish();
            }
            if idle {
                self.pump.wait(if self.paced { PACED_PAUSE } else { IDLE_PAUSE });
            }
        }
    }

    /// Whether input keeps the run going, now or possibly later.
    fn keeps_run_going(&self) -> bool {
        self.commands.as_ref().is_some_and(Commands::keeps_run_going)
    }

    /// Reads new input and results. Returns whether the run ends.
    fn take_commands(&mut self) -> Result<bool, CliError> {
        let Some(commands) = &mut self.commands else { return Ok(false) };
        for event in commands.poll() {
            match event {
                InputEvent::Line(line) => self.printer.note(&line)?,
                InputEvent::Quit => return Ok(true),
            }
        }
        Ok(false)
    }

    /// None of the versions changes without a further command.
    fn is_settled(&self, idle: bool) -> bool {
        let snapshot = self.pump.engine().snapshot();
        self.versions.iter().all(|version| {
            let view = snapshot.candidates.iter().find(|view| view.version == *version);
            view.is_none_or(|view| is_over(view) || (idle && self.rests(&snapshot, view)))
        })
    }

    /// An idle engine has nothing to do for it. At its own pace, the live cell may be in use in the middle of a
    /// stage.
    /// of a stage.
    fn rests(&self, snapshot: &Snapshot, view: &CandidateView) -> bool {
        let awaits_approval = snapshot.prompts.iter().any(|prompt| prompt.version == view.version);
        let is_running = self.paced && view.flags.running.is_some();
        !awaits_approval && !is_running && !view.flags.provisional
    }

    /// Prints events, follows new candidates, and fails if the engine halts.
    fn print_events(&mut self, events: &[Event]) -> Result<(), CliError> {
        for event in events {
            if let EventKind::Registered { version, .. } = &event.kind {
                self.versions.insert(version.clone());
            }
        }
        self.print(events)
    }

    fn print(&mut self, events: &[Event]) -> Result<(), CliError> {
        for event in events {
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

    /// Ends the engine and prints the result of each version.
    fn finish(mut self) -> Result<Exit, CliError> {
        // Recent events are printed, too.
        self.take_commands()?;
        let candidates = self.pump.engine().snapshot().candidates;
        let followed: Vec<FollowedVersion> = candidates
            .iter()
            .filter(|view| self.versions.contains(&view.version))
            .map(|view| FollowedVersion { version: view.version.clone(), exit: outcome_of(view) })
            .collect();
        self.pump.submit(Request::unsigned("the-end".to_owned(), Command::Shutdown));
        let mut events = self.pump.deliver_events();
        events.extend(self.pump.finish());
        self.print(&events)?;
        if followed.is_empty() {
            self.printer.note(sentences::NO_VERSION_WAITS)?;
        }
        for one in &followed {
            self.printer.note(&one.to_string())?;
        }
        Ok(worst_outcome(&followed))
    }
}

/// No decision about it is open: it is history, or confirmed and active.
fn is_over(view: &CandidateView) -> bool {
    view.state.is_terminal() || outcome_of(view) == Exit::Confirmed
}
