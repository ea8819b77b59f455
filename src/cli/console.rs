//! The console as a front end of `run`: whether it can open, its files, and how it ended.
//!
//! Draws nothing and reads no keys. Errors in files are reported before the terminal changes.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::console_engine::ConsoleEngine;
use super::run::{LivePace, RunArgs};
use super::settings::{self, file, themes};
use super::{data, identity};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_console::effects::{MakeIdentity, OperatorFiles, ReadOperatorFiles, Services};
use holdpoint_console::keymap::{self, Keymap};
use holdpoint_console::options::{self, Options, SettingsFile};
use holdpoint_console::run::{ConsoleError, ConsoleSetup, EngineLocation, ExitCause};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_runtime::capability::shown;
use holdpoint_service::control_socket::{Client, ControlSocketError, SHOWN_TO_NOBODY};
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle};
use holdpoint_store::Layout;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint as _, Problem, shell_word};
use holdpoint_trials::embedded;

/// Whether `run` opens the console: no option excludes it, and input and output are terminals.
pub(super) fn fits(args: &RunArgs, json: bool) -> bool {
    let terminal = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
    let dumb = std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
    !args.plain && !args.headless && !json && terminal && !dumb
}

/// Opens the console, and prints the state at its end.
///
/// # Errors
/// [`CliError`] with exit code 2 for an error in files, theme or terminal, 70 for a fault of the console.
pub(super) fn run(
    context: &CliContext,
    args: &RunArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let options = Options::new(args.console.flags(), settings()?);
    let keymap = Arc::new(keymap()?);
    let layout = Layout::new(&context.data);
    let engine = match at_work(&layout, args, &options)? {
        ExistingEngine::Attached(host) => EngineLocation::Elsewhere(host),
        ExistingEngine::Silent(why) => {
            EngineLocation::Begun(Box::new(EngineHandle::starting(layout)), Box::new(|_| Err(why)))
        }
        ExistingEngine::NoEngine if options.read_only => {
            let none = "no engine runs on this store, and a read-only console starts none";
            let why = EngineEndError::orderly(none);
            EngineLocation::Begun(Box::new(EngineHandle::starting(layout)), Box::new(|_| Err(why)))
        }
        ExistingEngine::NoEngine => {
            let pace = args.pace.unwrap_or(LivePace::CLOCK).times();
            let here = args.engine.launch(context, pace, &args.scenes)?;
            if args.in_process {
                EngineLocation::Here(here)
            } else {
                let service = ConsoleEngine::new(&context.data, args);
                let begin = move |presence: ConsolePresence| service.begin(presence, here);
                EngineLocation::Begun(Box::new(EngineHandle::starting(layout)), Box::new(begin))
            }
        }
    };
    let console = ConsoleSetup {
        engine,
        view: args.scenes.view,
        options,
        data: named(context),
        keymap,
        themes: themes()?,
        services: Services {
            read_candidate: Box::new(CandidateSource::default().reader()),
            read_own_files: own_files(),
            make_identity: make_identity(context.clone()),
            read_recording: Arc::new(|files: &[PathBuf]| {
                super::replay::read(files).map_err(CliError::into_problem)
            }),
        },
    };
    let left = holdpoint_console::run::run(console).map_err(|error| match &error {
        ConsoleError::Failed => CliError::internal(error),
        ConsoleError::Theme(_) | ConsoleError::Terminal(_) => CliError::usage(error),
    })?;
    if left.cause != ExitCause::TerminalLost {
        out.line(&left.text)?;
    }
    Ok(match (left.cause, left.in_order) {
        (ExitCause::Requested, true) => Exit::Confirmed,
        // As for every verb: the store or a request is not as required.
        (ExitCause::Requested, false) if !left.engine_started => Exit::Usage,
        (ExitCause::Requested, false) | (ExitCause::Signalled | ExitCause::TerminalLost, _) => Exit::Held,
    })
}

/// The `--data` value for another shell, absolute and quoted; absent if that shell uses this store by default.
fn named(context: &CliContext) -> Option<String> {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    let is_ours =
        |other: &Path| other == context.data || real(other).is_some_and(|at| real(&context.data) == Some(at));
    if data::folder(None).is_ok_and(|default| is_ours(&default)) {
        return None;
    }
    let path = std::path::absolute(&context.data).unwrap_or_else(|_| context.data.clone());
    Some(shell_word(&path.to_string_lossy()))
}

/// The engine that runs on the store already.
enum ExistingEngine {
    /// A running engine with a console attached to it.
    Attached(Box<EngineHandle>),
    /// One that does not answer: which, and why.
    Silent(EngineEndError),
    /// None, or none that is visible.
    NoEngine,
}

/// The engine that runs on the store already.
///
/// # Errors
/// If the arguments configure the start of an engine: a running engine keeps its own.
fn at_work(layout: &Layout, args: &RunArgs, options: &Options) -> Result<ExistingEngine, CliError> {
    let client = match Client::connect(layout) {
        Ok(Some(client)) => client,
        Err(error @ ControlSocketError::Silent { .. }) => {
            return Ok(ExistingEngine::Silent(EngineEndError::in_use(error.sentence())));
        }
        // For an engine of another version, the start of a new one fails and reports it.
        Ok(None) | Err(_) => return Ok(ExistingEngine::NoEngine),
    };
    let start_options = args.start_options();
    if !start_options.is_empty() {
        let problem = format!(
            "an engine is already running on this store, and {} applies only when one starts",
            start_options.join(", ")
        );
        let hint = "leave it out to attach, or choose another store with `--data`";
        return Err(CliError::usage(Problem::new(problem).with_hint(hint)));
    }
    let presence = ConsolePresence { read_only: options.read_only, ..ConsolePresence::default() };
    match EngineHandle::attach(layout.clone(), client, presence) {
        Ok(host) => Ok(ExistingEngine::Attached(Box::new(host))),
        // If all attached consoles are in use, the error says so and not that no engine runs.
        Err(ControlSocketError::Closed { path, text }) if text != SHOWN_TO_NOBODY => {
            Err(CliError::usage(ControlSocketError::Closed { path, text }))
        }
        Err(_) => Ok(ExistingEngine::NoEngine),
    }
}

/// The keys: the defaults and the operator's file.
///
/// # Errors
/// Every problem of the file.
pub(super) fn keymap() -> Result<Keymap, CliError> {
    let Some((name, text)) = file("keys.toml", keymap::FILE_BYTES_MAX)? else {
        return Ok(Keymap::default());
    };
    Keymap::with_file(&name, &text).map_err(|problems| {
        let messages: Vec<String> = problems.iter().map(ToString::to_string).collect();
        CliError::usage(messages.join("; "))
            .with_details(ErrorDetails::of_file(ErrorReason::BadFile, name.as_str()))
    })
}

/// The operator's settings file.
///
/// # Errors
/// Every problem of the file.
pub(super) fn settings() -> Result<SettingsFile, CliError> {
    match file("config.toml", options::FILE_BYTES_MAX)? {
        Some((name, text)) => Ok(SettingsFile::parse(&name, &text)?),
        None => Ok(SettingsFile::default()),
    }
}

/// Reads keys and themes again if they changed since the last check.
fn make_identity(context: CliContext) -> MakeIdentity {
    Arc::new(move |name| identity::make_unprotected(&context, name).map_err(CliError::into_problem))
}

fn own_files() -> ReadOperatorFiles {
    let mut seen = settings::stamp();
    Box::new(move || {
        let now = settings::stamp();
        if now == seen {
            return None;
        }
        seen = now;
        let read =
            keymap().and_then(|keymap| Ok(OperatorFiles { keymap: Arc::new(keymap), themes: themes()? }));
        Some(read.map_err(|error| Problem::new(error.to_string())))
    })
}

/// Candidates for the console's `register`: folders, and those of the demonstration in order.
#[derive(Default)]
struct CandidateSource {
    /// Embedded candidates that this console submitted: the list may omit a rejected one.
    submitted: Vec<&'static str>,
}

impl CandidateSource {
    fn reader(mut self) -> impl FnMut(Option<&str>, &[CapabilityId]) -> Result<Command, Problem> {
        move |folder, known| match folder {
            Some(folder) => register(folder),
            None => self.next(known),
        }
    }

    fn next(&mut self, known: &[CapabilityId]) -> Result<Command, Problem> {
        let mut open = embedded::names_beside(known).filter(|name| !self.submitted.contains(name));
        let Some(name) = open.next() else {
            let problem = Problem::new("every demonstration candidate is registered");
            return Err(problem.with_hint("`:register DIR` takes others"));
        };
        self.submitted.push(name);
        register(name)
    }
}

/// Reports errors in a folder before the request reaches the engine.
fn register(folder: &str) -> Result<Command, Problem> {
    let folder = Path::new(folder);
    let candidate = embedded::read(folder).map_err(|error| Problem::of(&error))?;
    Ok(Command::Register { package: Package::clone(&candidate.package), name: shown(folder), by: None })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_runtime::capability::Capability;

    /// The printed stop command once named another store.
    #[test]
    fn a_store_that_is_not_the_default_one_is_named_for_a_shell() {
        let of = |data: &str| named(&CliContext { data: data.into(), data_given: true, json: false });
        assert_eq!(of("/srv/cell-2").as_deref(), Some("/srv/cell-2"));
        assert_eq!(of("/srv/ana's cell").as_deref(), Some(r"'/srv/ana'\''s cell'"));
        assert!(of("try-out").is_some_and(|path| path.starts_with('/') && path.ends_with("/try-out")));
        if let Ok(default) = data::folder(None) {
            assert_eq!(named(&CliContext { data: default, data_given: false, json: false }), None);
        }
    }

    #[test]
    fn demonstration_submits_each_candidate_once() {
        let mut read = CandidateSource::default().reader();
        let count = embedded::names().count();
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..count {
            let Ok(Command::Register { name, .. }) = read(None, &[]) else { panic!("there are {count}") };
            seen.insert(name);
        }
        assert_eq!(seen.len(), count);
        assert!(read(None, &[]).unwrap_err().hint().unwrap().contains(":register DIR"));
        assert!(matches!(
            read(Some("manifests/candidates/grasp-improved"), &[]),
            Ok(Command::Register { .. })
        ));
        assert!(read(Some("/nowhere/at/all"), &[]).is_err());
    }

    #[test]
    fn versions_that_are_known_are_skipped() {
        let first = embedded::names().next().unwrap();
        let id = Capability::load(first, embedded::package(first).unwrap()).unwrap().id();
        let mut read = CandidateSource::default().reader();
        let Ok(Command::Register { name, .. }) = read(None, &[id]) else { panic!("others are left") };
        assert_ne!(name, first);
    }
}
