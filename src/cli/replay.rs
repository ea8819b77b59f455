//! `holdpoint replay`: shows the recording of an upgrade, in the viewer, in the terminal, or as lines.
//!
//! Finds the files and checks them against the audit log before it opens them. Changes no recording and no store.

pub(super) mod episode;
mod segments;
mod truncated_copies;

use std::ffi::OsString;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde_json::json;

use self::episode::EpisodeSelector;
use super::recordings::{check, difference, on_record};
use super::run::ColorArg;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::hint_line;
use crate::error::{CliError, Exit};
use holdpoint_console::options::{CommandLineFlags, Options};
use holdpoint_console::replay::speed::Speed;
use holdpoint_console::replay::{ReplayError, ReplayOptions, print, run as run_in_terminal};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::TICKS_PER_SECOND;
use holdpoint_recordings::recording::Recording;
use holdpoint_recordings::recording_folder::{self, RecordingFile};
use holdpoint_recordings::viewer;
use holdpoint_store::Layout;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_wording::program::recordings as sentences;

/// How long the verb watches a new viewer: one that cannot draw ends within this time.
const WATCHED: Duration = Duration::from_millis(1_500);

/// The arguments of `replay`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Opens the installed rerun viewer (pip install rerun-sdk==0.36.3); --terminal needs no viewer. A
recording that does not match its digest in the audit log is not opened, and the verb exits with 1.

Examples:
  holdpoint replay grasp@1.1.0
  holdpoint replay grasp@1.1.0 --terminal --to 28800
  holdpoint replay grasp@1.1.0 --json
  holdpoint replay grasp@1.1.0 --episode worst --terminal
  holdpoint replay grasp@1.1.0 --drill 3 --rrd drill.rrd
  holdpoint replay recordings/accepted.rrd --plain
  holdpoint replay recordings/accepted.rrd --to 28800 --out early.rrd")]
pub struct ReplayArgs {
    /// A version, e.g. grasp@1.1.0, or a recording's file.
    #[arg(value_name = "UPGRADE", value_parser = parse_upgrade)]
    pub upgrade: ReplaySubject,
    /// Re-runs a paired episode of its sandbox beside the active version: its number, or the worst one.
    #[arg(long, value_name = "N|worst", value_parser = episode::parse_which, conflicts_with_all = ["to", "out"])]
    pub episode: Option<EpisodeSelector>,
    /// Re-runs one of the drills that it failed, as --episode does.
    #[arg(long, value_name = "N|worst", value_parser = episode::parse_which,
        conflicts_with_all = ["to", "out", "episode"])]
    pub drill: Option<EpisodeSelector>,
    /// Re-runs an episode that it ran alone before the pairs, as --episode does.
    #[arg(long, value_name = "N|worst", value_parser = episode::parse_which,
        conflicts_with_all = ["to", "out", "episode", "drill"])]
    pub alone: Option<EpisodeSelector>,
    /// Re-runs an episode of its confirmation, as --episode does.
    #[arg(long, value_name = "N|worst", value_parser = episode::parse_which,
        conflicts_with_all = ["to", "out", "episode", "drill", "alone"])]
    pub confirmation: Option<EpisodeSelector>,
    /// Writes that episode to a file for the viewer, with joint angles and torques as columns.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["terminal", "plain"])]
    pub rrd: Option<PathBuf>,
    /// Replays up to this tick; 240 ticks are a second of virtual time. The terminal begins there.
    #[arg(long, value_name = "TICK")]
    pub to: Option<u64>,
    /// Writes the recording up to that tick to a new file, and opens nothing.
    #[arg(long, value_name = "FILE", requires = "to", conflicts_with_all = ["terminal", "plain"])]
    pub out: Option<PathBuf>,
    /// Replays in this terminal; prints the events if the output is not a terminal.
    #[arg(long)]
    pub terminal: bool,
    /// Prints the events, one a line.
    #[arg(long)]
    pub plain: bool,
    /// Opens a recording that does not match the audit log, too.
    #[arg(long)]
    pub force: bool,
    /// Playing speed in the terminal: .25, .5, 1, 2, 4, ... 64.
    #[arg(long, value_name = "N", value_parser = parse_speed, default_value = "1")]
    pub speed: Speed,
    /// The theme [default: by the terminal's background].
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Whether to use colors; overrides `NO_COLOR`.
    #[arg(long, value_enum, value_name = "WHEN")]
    pub color: Option<ColorArg>,
    /// Draws with ASCII only.
    #[arg(long)]
    pub ascii: bool,
}

/// The subject of the replay.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReplaySubject {
    /// All recordings of a version in the store.
    Version(CapabilityId),
    /// One recording file, in any folder.
    File(PathBuf),
}

/// The environment of this program; a test has its own.
struct ProcessEnvironment {
    path: Option<OsString>,
    has_screen: bool,
    has_terminal: bool,
}

fn parse_upgrade(text: &str) -> Result<ReplaySubject, String> {
    if text.ends_with(recording_folder::ENDING) {
        return Ok(ReplaySubject::File(PathBuf::from(text)));
    }
    text.parse()
        .map(ReplaySubject::Version)
        .map_err(|_| "a version like grasp@1.1.0 is allowed, or a file whose name ends in .rrd".to_owned())
}

fn parse_speed(text: &str) -> Result<Speed, String> {
    let speed = text.parse().ok().and_then(Speed::of);
    speed.ok_or_else(|| ".25, .5, 1, 2, 4, 8, 16, 32 and 64 are allowed".to_owned())
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &ReplayArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let dumb = std::env::var_os("TERM").is_none_or(|term| term.is_empty() || term == "dumb");
    let surroundings = ProcessEnvironment {
        path: viewer::path(),
        has_screen: viewer::has_screen(),
        has_terminal: std::io::stdin().is_terminal() && std::io::stdout().is_terminal() && !dumb,
    };
    replay(context, args, &surroundings, out)
}

fn replay(
    context: &CliContext,
    args: &ReplayArgs,
    environment: &ProcessEnvironment,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    if let Some(request) = episode::film_request(args) {
        return episode::run(context, args, request, environment.has_terminal, out);
    }
    if args.rrd.is_some() {
        return Err(CliError::usage("--rrd writes an episode of an evaluation")
            .with_hint("name the episode: --episode, --drill, --alone or --confirmation"));
    }
    let files = files(context, &args.upgrade)?;
    let problems = problems(&files)?;
    for problem in &problems {
        let value = json!({ "sound": false, "problem": problem });
        out.answer(&value, |out| out.line(&sentences::differs_from_record(problem)))?;
    }
    if !problems.is_empty() && !args.force {
        if !out.is_json() {
            let hint = "`holdpoint audit verify` checks the audit log; --force opens the recording anyway";
            out.line(&hint_line(&hint.into()))?;
        }
        return Ok(Exit::Rejected);
    }
    if let (Some(path), Some(tick)) = (&args.out, args.to) {
        truncated_copies::write(&files, tick, path)?;
        let value = json!({ "file": path.display().to_string(), "tick": tick });
        out.answer(&value, |out| out.line(&format!("wrote {}", path.display())))?;
        return Ok(Exit::Confirmed);
    }
    let as_lines = args.plain || context.json || (args.terminal && !environment.has_terminal);
    if as_lines {
        lines(&files, args.to, out)?;
    } else if args.terminal {
        in_terminal(&files, args)?;
    } else {
        in_viewer(context, &files, args.to, environment, out)?;
    }
    Ok(Exit::Confirmed)
}

/// The files to show, in order; at least one.
fn files(context: &CliContext, wanted: &ReplaySubject) -> Result<Vec<PathBuf>, CliError> {
    match wanted {
        ReplaySubject::File(path) if path.is_file() => Ok(vec![path.clone()]),
        ReplaySubject::File(path) => Err(CliError::usage(format!("there is no recording {path:?}"))
            .with_details(ErrorDetails::of_path(ErrorReason::NotFound, path))),
        ReplaySubject::Version(version) => {
            let folder = Layout::new(&context.data).recordings();
            let found = recording_folder::of(&folder, version).map_err(|error| {
                CliError::usage(format!("cannot read the recordings in {folder:?}: {error}"))
                    .with_bad_file(&folder)
            })?;
            if found.is_empty() {
                let text = format!("there is no recording of {:?} in {folder:?}", version.to_string());
                return Err(CliError::usage(text)
                    .with_hint("`holdpoint recordings list` names all")
                    .with_details(ErrorReason::NotFound));
            }
            Ok(found)
        }
    }
}

/// The differences from the audit log, for files that lie in a store and are on record.
fn problems(files: &[PathBuf]) -> Result<Vec<String>, CliError> {
    let mut problems = Vec::new();
    for path in files {
        let Some((store, filed)) = in_store(path) else { continue };
        let record = on_record(&super::data::open(&store)?)?;
        if let Some(difference) = difference(&check(&filed, &record)?) {
            problems.push(format!("{} does not match its digest at closure: {difference}", filed.file));
        }
    }
    Ok(problems)
}

/// The store whose folder of recordings contains a file, and the file; `None` for other folders.
fn in_store(path: &Path) -> Option<(PathBuf, RecordingFile)> {
    let path = path.canonicalize().ok()?;
    let folder = path.parent()?;
    let store = folder.parent()?;
    let layout = Layout::new(store);
    if layout.recordings() != folder || !layout.database().is_file() {
        return None;
    }
    let filed = recording_folder::list(folder).ok()?.into_iter().find(|filed| filed.path == path)?;
    Some((store.to_owned(), filed))
}

/// The last virtual time of a tick, ms.
fn end_of_tick_ms(tick: u64) -> u64 {
    tick.saturating_add(1).saturating_mul(1_000).saturating_sub(1) / TICKS_PER_SECOND
}

fn lines(files: &[PathBuf], to: Option<u64>, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let recording = segments::read(files)?;
    let to_ms = to.map(end_of_tick_ms);
    if !out.is_json() {
        return Ok(print(&recording, to_ms, out.sink())?);
    }
    let is_wanted = |at_ms: u64| to_ms.is_none_or(|to_ms| at_ms <= to_ms);
    recording.events.iter().filter(|event| is_wanted(event.at_ms)).try_for_each(|event| out.json(event))
}

/// Reads a recording that matches the audit log, for the console.
///
/// # Errors
/// If it does not match, cannot be read, or this program was built without scenes.
pub(super) fn read(files: &[PathBuf]) -> Result<Recording, CliError> {
    match problems(files)?.into_iter().next() {
        Some(problem) => {
            Err(CliError::usage(problem).with_hint("`holdpoint audit verify` checks the audit log"))
        }
        None => segments::read(files),
    }
}

fn in_terminal(files: &[PathBuf], args: &ReplayArgs) -> Result<(), CliError> {
    play(segments::read(files)?, args)
}

/// Plays a recording in this terminal.
fn play(recording: Recording, args: &ReplayArgs) -> Result<(), CliError> {
    let flags = CommandLineFlags {
        theme: args.theme.clone(),
        color: args.color.map(Into::into),
        ascii: args.ascii,
        ..CommandLineFlags::default()
    };
    run_in_terminal(recording, replay_options(flags, args.to, args.speed)?).map_err(replay_failed)
}

/// How a replay looks, by flags and settings.
pub(super) fn replay_options(
    flags: CommandLineFlags,
    start_tick: Option<u64>,
    speed: Speed,
) -> Result<ReplayOptions, CliError> {
    let console = Options::new(flags, super::console::settings()?);
    Ok(ReplayOptions { start_tick, speed, console, themes: super::settings::themes()? })
}

pub(super) fn replay_failed(error: ReplayError) -> CliError {
    match &error {
        ReplayError::Failed => CliError::internal(error),
        ReplayError::Theme(_) | ReplayError::Empty(_) | ReplayError::Terminal(_) => CliError::usage(error),
    }
}

fn in_viewer(
    context: &CliContext,
    files: &[PathBuf],
    to: Option<u64>,
    environment: &ProcessEnvironment,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let viewer_error = |error: viewer::ViewerError| {
        let install = error.hint().map_or_else(String::new, |hint| format!("{hint}; "));
        CliError::usage(error).with_hint(format!("{install}--terminal shows it here"))
    };
    let viewer = viewer::find(environment.path.as_deref()).map_err(viewer_error)?;
    if !environment.has_screen {
        return Err(viewer_error(viewer::ViewerError::NoScreen));
    }
    let logs = Layout::new(&context.data).logs();
    let scratch = if to.is_some() || !logs.is_dir() { Some(truncated_copies::scratch()?) } else { None };
    let shown = match (to, &scratch) {
        (Some(tick), Some(scratch)) => truncated_copies::cut(files, tick, scratch)?,
        _ => absolute(files)?,
    };
    let logs = if logs.is_dir() { logs } else { scratch.unwrap_or(logs) };
    let opened = viewer.open(&shown, &logs).map_err(viewer_error)?;
    if opened.ended_within(WATCHED) == Some(false) {
        let text = format!("the scene viewer {:?} ended at once; see {:?}", viewer.program, opened.log);
        let error = CliError::usage(text).with_hint("--terminal shows it here");
        return Err(error.with_details(ErrorReason::Environment));
    }
    out.line(&sentences::opened(viewer.version, shown.len(), opened.process))
}

/// The viewer may run in another folder, so paths are made absolute.
fn absolute(files: &[PathBuf]) -> Result<Vec<PathBuf>, CliError> {
    let one = |path: &PathBuf| {
        path.canonicalize()
            .map_err(|error| CliError::usage(format!("cannot open {path:?}: {error}")).with_bad_file(path))
    };
    files.iter().map(one).collect()
}

#[cfg(test)]
mod tests;
