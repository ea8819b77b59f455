//! The console as a front end of `run`: whether it fits here, its files, and how it ended.
//!
//! Must not draw or read keys; what is wrong with a file is said before the terminal is touched.

use std::io::IsTerminal as _;
use std::path::Path;
use std::sync::Arc;

use super::own_service::OwnService;
use super::run::{LivePace, RunArgs};
use super::settings::{self, file, themes};
use super::{data, identity};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_console::effects::{MakeIdentity, OwnFiles, ReadOwnFiles, Services};
use holdpoint_console::keymap::{self, Keymap};
use holdpoint_console::options::{self, Options, SettingsFile};
use holdpoint_console::run::{Cause, Console, ConsoleError, EngineAt};
use holdpoint_engine::door::{Client, DoorError, SHOWN_TO_NOBODY};
use holdpoint_engine::embedded;
use holdpoint_engine::host::{EndFault, Host, HostConfig};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::seat::Sitting;
use holdpoint_registry::Layout;
use holdpoint_runtime::capability::shown;
use holdpoint_text::{Hint as _, Problem};

/// Whether `run` opens the console: nothing else was asked for, and there is a terminal on both sides.
pub(super) fn fits(args: &RunArgs, json: bool) -> bool {
    let terminal = std::io::stdin().is_terminal() && std::io::stdout().is_terminal();
    let dumb = std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
    !args.plain && !args.headless && !json && terminal && !dumb
}

/// Opens the console and says how things were left.
///
/// # Errors
/// [`CliError`] with exit code 2 for what is wrong with files, theme or terminal, 70 for a fault of the console.
pub(super) fn run(context: &CliContext, args: &RunArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let options = Options::new(args.console.flags(), settings()?);
    let keymap = Arc::new(keymap()?);
    let layout = Layout::new(&context.data);
    let engine = match at_work(&layout, args, &options)? {
        AtWork::Seat(host) => EngineAt::Elsewhere(host),
        AtWork::Silent(why) => EngineAt::Begun(Box::new(Host::coming(layout)), Box::new(|_| Err(why))),
        AtWork::Nobody => {
            let here = HostConfig {
                data: context.data.clone(),
                profile: args.engine.profile(&context.data)?,
                seed: args.engine.seed(&context.data)?,
                jobs: args.engine.spare_jobs(),
                robot: args.engine.robot.clone(),
                pace: args.pace.unwrap_or(LivePace::CLOCK).times(),
                sinks: args.scenes.options(true).sinks()?,
                alone_max: None,
                seats: None,
            };
            if args.in_process {
                EngineAt::Here(here)
            } else {
                let service = OwnService::new(&context.data, args);
                let begin = move |sitting: Sitting| service.begin(sitting, here);
                EngineAt::Begun(Box::new(Host::coming(layout)), Box::new(begin))
            }
        }
    };
    let console = Console {
        engine,
        view: args.scenes.view,
        options,
        data: named(context),
        keymap,
        themes: themes()?,
        services: Services {
            read_candidate: Box::new(Candidates::default().reader()),
            read_own_files: own_files(),
            make_identity: make_identity(context.clone()),
        },
    };
    let left = holdpoint_console::run::run(console).map_err(|error| match &error {
        ConsoleError::Failed => CliError::internal(error),
        ConsoleError::Theme(_) | ConsoleError::Terminal(_) => CliError::usage(error),
    })?;
    if left.cause != Cause::Gone {
        out.line(&left.text)?;
    }
    Ok(match (left.cause, left.in_order) {
        (Cause::Asked, true) => Exit::Confirmed,
        // As for every verb: the store, or what was asked for, is not as it must be.
        (Cause::Asked, false) if !left.came_up => Exit::Usage,
        (Cause::Asked, false) | (Cause::Told | Cause::Gone, _) => Exit::Held,
    })
}

/// How another shell names this store; absent where it takes it without a word. From any folder, and as one word.
fn named(context: &CliContext) -> Option<String> {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    let is_ours =
        |other: &Path| other == context.data || real(other).is_some_and(|at| real(&context.data) == Some(at));
    if data::folder(None).is_ok_and(|default| is_ours(&default)) {
        return None;
    }
    let path = std::path::absolute(&context.data).unwrap_or_else(|_| context.data.clone());
    let path = path.to_string_lossy();
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-+,:@".contains(letter);
    Some(if path.chars().all(is_plain) {
        path.into_owned()
    } else {
        format!("'{}'", path.replace('\'', r"'\''"))
    })
}

/// What is at work on the store already.
enum AtWork {
    /// An engine, with a seat at it.
    Seat(Box<Host>),
    /// One that does not answer: which, and why.
    Silent(EndFault),
    /// None, or none that shows itself.
    Nobody,
}

/// The engine that is at work on the store already.
///
/// # Errors
/// If the arguments are for the start of an engine: the one at work goes by its own.
fn at_work(layout: &Layout, args: &RunArgs, options: &Options) -> Result<AtWork, CliError> {
    let client = match Client::connect(layout) {
        Ok(Some(client)) => client,
        Err(error @ DoorError::Silent { .. }) => {
            return Ok(AtWork::Silent(EndFault::in_use(error.sentence())));
        }
        // One of another version is told by the start of an own one, which fails for it.
        Ok(None) | Err(_) => return Ok(AtWork::Nobody),
    };
    let beginning = args.for_a_start();
    if !beginning.is_empty() {
        let problem = format!(
            "an engine is at work on this store, and {} is for the start of one",
            beginning.join(", ")
        );
        let hint = "leave it out to attach, or choose another store with `--data`";
        return Err(CliError::usage(Problem::new(problem).with_hint(hint)));
    }
    let sitting = Sitting { read_only: options.read_only, ..Sitting::default() };
    match Host::attach(layout.clone(), client, sitting) {
        Ok(host) => Ok(AtWork::Seat(Box::new(host))),
        // Every seat may be taken: that is what has to be said, and not that no engine is at work.
        Err(DoorError::Closed { path, text }) if text != SHOWN_TO_NOBODY => {
            Err(CliError::usage(DoorError::Closed { path, text }))
        }
        Err(_) => Ok(AtWork::Nobody),
    }
}

/// The keys: the defaults and what the operator's file adds.
///
/// # Errors
/// Every problem of the file.
pub(super) fn keymap() -> Result<Keymap, CliError> {
    let Some((name, text)) = file("keys.toml", keymap::FILE_BYTES_MAX)? else {
        return Ok(Keymap::default());
    };
    Keymap::with_file(&name, &text).map_err(|problems| {
        let said: Vec<String> = problems.iter().map(ToString::to_string).collect();
        CliError::usage(said.join("; "))
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

/// Looks whether keys or themes changed since the last look, and reads both anew if so.
fn make_identity(context: CliContext) -> MakeIdentity {
    Arc::new(move |name| identity::make_unprotected(&context, name).map_err(CliError::into_problem))
}

fn own_files() -> ReadOwnFiles {
    let mut seen = settings::stamp();
    Box::new(move || {
        let now = settings::stamp();
        if now == seen {
            return None;
        }
        seen = now;
        let read = keymap().and_then(|keymap| Ok(OwnFiles { keymap: Arc::new(keymap), themes: themes()? }));
        Some(read.map_err(|error| Problem::new(error.to_string())))
    })
}

/// Candidates for the console's `register`: folders, and the demonstration's in their order.
#[derive(Default)]
struct Candidates {
    /// Embedded ones that were submitted from this console: a rejected one may not be listed any more.
    submitted: Vec<&'static str>,
}

impl Candidates {
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

/// What is wrong with a folder is said before the engine is asked.
fn register(folder: &str) -> Result<Command, Problem> {
    let folder = Path::new(folder);
    let candidate = embedded::read(folder).map_err(|error| Problem::of(&error))?;
    Ok(Command::Register { package: Package::clone(&candidate.package), name: shown(folder), by: None })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_runtime::capability::Capability;

    /// What was said to stop the arm addressed another store's.
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
    fn the_demonstration_goes_through_its_candidates_once() {
        let mut read = Candidates::default().reader();
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
        let mut read = Candidates::default().reader();
        let Ok(Command::Register { name, .. }) = read(None, &[id]) else { panic!("others are left") };
        assert_ne!(name, first);
    }
}
