//! Upgrades printed as they happen, without a screen: what waits in a store, or the demonstration.
//!
//! What is typed meanwhile is carried out beside it (`commands`). Owns which versions are followed and when they are settled; what became of each is read from the snapshot. A
//! run that followed no version says so and has no outcome.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::commands::{Commands, Said};
use super::outcome::{Followed, outcome_of, worst};
use super::printer::Printer;
use super::runs::cell;
use crate::error::{CliError, Exit, start_error};
use holdpoint_engine::anteroom::{Anteroom, LOOK_PATIENCE};
use holdpoint_engine::door::{Door, Signals};
use holdpoint_engine::embedded;
use holdpoint_engine::pipeline::Progress;
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Refusal, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::MakeSink;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};
use holdpoint_text::{Hint as _, Problem};

/// Which versions are taken through the stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlainWork {
    /// Those that wait in the store, and those that are submitted meanwhile. Nothing of its own.
    Waiting,
    /// The first embedded candidate that the store does not know.
    Demonstration,
}

/// Upgrades, printed as they happen.
pub struct RunPlain<'a> {
    pub work: PlainWork,
    pub data: &'a Path,
    pub profile: ChosenProfile,
    pub seed: u64,
    pub jobs: usize,
    /// A robot's URDF file in place of the built-in arm.
    pub robot: Option<&'a Path>,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Simulated seconds of the live cell in a second; absent to work in step with the evaluation.
    pub pace: Option<f64>,
    /// Who listens besides the printer: recordings, a live viewer.
    pub sinks: Vec<MakeSink>,
    /// Whether commands are read from the standard input.
    pub commands: bool,
}

/// The pause while it waits for people.
const IDLE_PAUSE: Duration = Duration::from_millis(200);

/// The pause while the live cell works at a pace of its own: what it did is taken in soon.
const PACED_PAUSE: Duration = Duration::from_millis(15);

/// Works in real time until every version that is followed is settled. Other programs can talk to the engine
/// meanwhile.
///
/// # Errors
/// [`CliError`] with exit code 2 for what is wrong with the input, 70 for what is wrong inside.
pub fn run_plain(run: RunPlain<'_>, out: &mut dyn Write) -> Result<Exit, CliError> {
    let anteroom = Anteroom::open(
        Config {
            data: run.data,
            profile: run.profile,
            seed: run.seed,
            jobs: run.jobs,
            scripted: false,
            cell: cell(run.robot)?,
            cache: EpisodeCache::InStore,
        },
        Signals::Taken,
        Box::new(|_| ()),
    )
    .map_err(start_error)?;
    let mut printer = Printer::new(out, run.json);
    let Some((engine, door)) = entered(anteroom, &mut printer)? else { return Ok(Exit::NothingJudged) };
    let mut pump = Pump::with_door(engine, door, run.sinks);
    match (run.pace, pump.pictures()) {
        // Nobody looks at the pictures.
        (Some(pace), None) => pump.pace_live_world(Some(pace), Arc::new(|_| ())),
        (Some(pace), Some(pictures)) => pump.pace_live_world(Some(pace), pictures),
        (None, Some(pictures)) => pump.draw_live_world(pictures),
        (None, None) => {}
    }
    let commands =
        if run.commands { Some(Commands::start(run.data).map_err(CliError::internal)?) } else { None };
    if commands.as_ref().is_some_and(Commands::stays) {
        printer.note("commands are taken here, a verb a line: `help` lists them, `quit` ends")?;
    }
    let paced = run.pace.is_some();
    let mut stream = PlainStream { pump, printer, versions: BTreeSet::new(), paced, commands };
    let events = stream.pump.tell();
    stream.print(&events)?;
    match run.work {
        PlainWork::Waiting => stream.follow_what_waits(),
        PlainWork::Demonstration => stream.submit_demonstration()?,
    }
    stream.work()
}

/// The engine, once its record was read; `None` if it was told to end before. A reading that takes long is told.
fn entered(
    mut anteroom: Anteroom<'_>,
    printer: &mut Printer<'_>,
) -> Result<Option<(Engine, Door)>, CliError> {
    let begun = Instant::now();
    let mut told = false;
    while !anteroom.turn() {
        if !told && anteroom.has_records() && begun.elapsed() >= LOOK_PATIENCE {
            told = true;
            let reading = anteroom.snapshot().reading.map_or_else(String::new, |reading| reading.to_string());
            printer.note(&format!("the record is being verified; {reading}"))?;
        }
    }
    if anteroom.has_ended() {
        printer.note("ended before the engine was up; nothing was carried out")?;
        return Ok(None);
    }
    anteroom.enter().map(Some).map_err(start_error)
}

/// An engine whose events are printed, and the versions that are followed.
struct PlainStream<'a> {
    pump: Pump,
    printer: Printer<'a>,
    versions: BTreeSet<CapabilityId>,
    /// Whether the live cell has a thread of its own.
    paced: bool,
    /// What is typed meanwhile, if that is read.
    commands: Option<Commands>,
}

impl PlainStream<'_> {
    fn follow_what_waits(&mut self) {
        let candidates = self.pump.engine().snapshot().candidates;
        let open = candidates.into_iter().filter(|view| !is_over(view));
        self.versions = open.map(|view| view.version).collect();
    }

    fn submit_demonstration(&mut self) -> Result<(), CliError> {
        let known = self.pump.engine().snapshot().candidates;
        let known: Vec<CapabilityId> = known.into_iter().map(|view| view.version).collect();
        let Some(name) = embedded::names_beside(&known).next() else {
            return self.printer.note(
                "every demonstration candidate is registered; `holdpoint candidate register` takes others",
            );
        };
        self.printer.note(&format!("submitting the demonstration candidate {name}"))?;
        let candidate = embedded::read(Path::new(name)).map_err(CliError::usage)?;
        let package = Package::clone(&candidate.package);
        let command = Command::Register { package, name: name.to_owned(), by: None };
        let reply = self.pump.submit(Request::unsigned("demonstration".to_owned(), command));
        match reply {
            // The demonstration is nobody, and signs nothing.
            Reply::Refused { code: Refusal::NotAllowed, text, .. } => {
                return Err(CliError::usage(text).with_hint(
                    "`holdpoint demo` without --data runs in a store of its own; in the console, `:demo` is signed by who sits there",
                ));
            }
            Reply::Refused { text, hint, .. } => return Err(CliError::usage(Problem::from((text, hint)))),
            Reply::Accepted { .. }
            | Reply::Stopped { .. }
            | Reply::Snapshot { .. }
            | Reply::Question { .. }
            | Reply::Detail { .. }
            | Reply::Film { .. }
            | Reply::Registry { .. }
            | Reply::Audit { .. }
            | Reply::Health { .. }
            | Reply::Verified { .. } => {}
        }
        let events = self.pump.tell();
        self.tell(&events)
    }

    /// Until everything that is followed is settled, nobody reads any more, or the engine is told to end.
    fn work(mut self) -> Result<Exit, CliError> {
        loop {
            if self.versions.is_empty() && !self.holds() {
                return self.finish();
            }
            let (progress, events) = self.pump.turn();
            self.tell(&events)?;
            let idle = matches!(progress, Progress::Idle { .. });
            let gone = self.printer.is_gone() || self.pump.engine().has_ended();
            if gone || self.take_commands()? || (self.is_settled(idle) && !self.holds()) {
                return self.finish();
            }
            if idle {
                self.pump.wait(if self.paced { PACED_PAUSE } else { IDLE_PAUSE });
            }
        }
    }

    /// Whether what was typed, or may yet be, keeps the run.
    fn holds(&self) -> bool {
        self.commands.as_ref().is_some_and(Commands::holds)
    }

    /// Takes in what was typed and what came of it. Tells whether the run is to end.
    fn take_commands(&mut self) -> Result<bool, CliError> {
        let Some(commands) = &mut self.commands else { return Ok(false) };
        for said in commands.look() {
            match said {
                Said::Line(line) => self.printer.note(&line)?,
                Said::Quit => return Ok(true),
            }
        }
        Ok(false)
    }

    /// Nothing more happens to any of them by itself.
    fn is_settled(&self, idle: bool) -> bool {
        let snapshot = self.pump.engine().snapshot();
        self.versions.iter().all(|version| {
            let view = snapshot.candidates.iter().find(|view| view.version == *version);
            view.is_none_or(|view| is_over(view) || (idle && self.rests(&snapshot, view)))
        })
    }

    /// An idle engine has nothing to do for it. With a pace of its own the live cell may be waited for in the middle
    /// of a stage.
    fn rests(&self, snapshot: &Snapshot, view: &CandidateView) -> bool {
        let asked = snapshot.prompts.iter().any(|prompt| prompt.version == view.version);
        let works = self.paced && view.flags.running.is_some();
        !asked && !works && !view.flags.provisional
    }

    /// Prints events, follows what is submitted meanwhile, and holds if the engine does.
    fn tell(&mut self, events: &[Event]) -> Result<(), CliError> {
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
            Some(why) => Err(CliError::internal(format!("the engine holds: {}", why.sentence()))),
        }
    }

    /// Ends the engine and says what became of each version.
    fn finish(mut self) -> Result<Exit, CliError> {
        // What was done is told, also where it was done a moment ago.
        self.take_commands()?;
        let candidates = self.pump.engine().snapshot().candidates;
        let followed: Vec<Followed> = candidates
            .iter()
            .filter(|view| self.versions.contains(&view.version))
            .map(|view| Followed { version: view.version.clone(), exit: outcome_of(view) })
            .collect();
        self.pump.submit(Request::unsigned("the-end".to_owned(), Command::Shutdown));
        let mut events = self.pump.tell();
        events.extend(self.pump.finish());
        self.print(&events)?;
        if followed.is_empty() {
            self.printer
                .note("nothing was judged: no version waits; `holdpoint candidate register` submits one")?;
        }
        for one in &followed {
            self.printer.note(&one.to_string())?;
        }
        Ok(worst(&followed))
    }
}

/// Nothing more is to be decided about it: it is history, or confirmed and in control.
fn is_over(view: &CandidateView) -> bool {
    view.state.is_terminal() || outcome_of(view) == Exit::Confirmed
}
