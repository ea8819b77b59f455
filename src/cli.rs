//! The command line: verbs and options, the printing of answers and errors, exit codes.
//!
//! Owns argument parsing, output and exit codes, and the verbs that need no engine. Decides nothing, and sanitizes
//! all foreign text before it prints. An [`EngineVerbs`] runs the verbs that run, feed or watch an engine; a person's decision
//! is one request, which its verb sends (`decide.rs`, `stop.rs`).

pub mod alarms;
pub mod audit;
pub mod audit_proof;
pub mod bench;
pub mod candidate;
pub mod cell;
pub mod cell_process;
pub mod completions;
mod confirm_time;
#[cfg(feature = "console")]
mod console;
#[cfg(feature = "console")]
mod console_engine;
mod context;
pub mod data;
pub mod decide;
pub mod demo;
pub mod doctor;
mod engine_verbs;
pub mod explain;
pub mod health;
pub mod identity;
#[cfg(feature = "console")]
pub mod keys;
pub mod lab;
pub mod man;
pub mod metrics;
mod operator_folder;
pub mod output;
mod passphrase;
pub mod profile;
mod profile_authorization;
pub mod profile_choice;
mod progress_bar;
mod prune;
pub mod recordings;
#[cfg(feature = "console")]
pub mod replay;
pub mod rerun;
pub mod result_cache;
mod roles;
pub mod run;
pub mod scenario;
pub mod schema;
pub mod serve;
#[cfg(feature = "console")]
mod settings;
pub mod site;
mod site_choice;
pub mod skill;
pub mod status;
pub mod stop;
pub mod store;
#[cfg(feature = "console")]
pub mod theme;
mod time_arg;
mod verb_executor;
pub mod verify;
pub mod version;
pub mod witness;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::error::{ContextKind, ContextValue};
use clap::{CommandFactory, Parser, Subcommand};
use rustix::process::Signal;
use tokio::signal::unix::{SignalKind, signal};

use crate::error::print_usage;

pub use crate::error::{CliError, Exit};
pub use context::CliContext;
pub use engine_verbs::{EngineVerb, EngineVerbs, RealEngine};
pub use output::CommandOutput;
pub(crate) use roles::with_present_names;
pub(crate) use verb_executor::refused;

/// Decides whether a new version of a robot's skill may take control of the robot.
///
/// Without a command it opens the console; without a terminal it runs the demonstration.
#[derive(Clone, Debug, Parser)]
#[command(name = "holdpoint", bin_name = "holdpoint", version, max_term_width = 100, after_help = AFTER_HELP)]
pub struct Cli {
    #[allow(clippy::doc_markdown, reason = "the help prints it verbatim")]
    /// The store's folder [default: $XDG_DATA_HOME/holdpoint or ~/.local/share/holdpoint].
    #[arg(long, global = true, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Prints JSON, one document a line.
    #[arg(long, global = true)]
    pub json: bool,
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: Option<Verb>,
}

const AFTER_HELP: &str = "\
Examples:
  holdpoint
  holdpoint scenario run tests/scenarios/promote-benign.toml --json
  holdpoint candidate check manifests/candidates/grasp-improved";

/// The verbs.
#[derive(Clone, Debug, Subcommand)]
pub enum Verb {
    /// Open the console with options, or print what happens line by line.
    #[command(mut_arg("cache_key", |arg| arg.hide(true)))]
    Run(run::RunArgs),
    /// Stop the arm now; `start` lets the cell run again.
    Stop(stop::StopArgs),
    /// Let a stopped cell run again.
    Start(stop::StartArgs),
    /// Show or await the state of families and candidates.
    Status(status::StatusArgs),
    /// Approve a candidate that waits for approval.
    Approve(decide::ApproveArgs),
    /// Reject a candidate.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Reject(decide::VersionArgs),
    /// Pause the pipeline; reject, demote and rollback still work.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)), after_help = "\
Examples:
  holdpoint pause --as mara --reason 'maintenance'
  holdpoint pause grasp --as mara --reason 'new fingers are being mounted'")]
    Pause(decide::PauseArgs),
    /// Resume a paused pipeline.
    #[command(after_help = "\
Examples:
  holdpoint resume grasp --as mara --reason 'the new fingers are measured'
  holdpoint resume --all --as mara --reason 'maintenance done'")]
    Resume(decide::ResumeArgs),
    /// Return a family to its rollback target.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Rollback(decide::FamilyArgs),
    /// List versions, and decide about one: retry, demote, block, restrict, reactivate ...
    Version(version::VersionVerbArgs),
    /// Set the goal of the live cell, leave a note, confirm its clock; serve a cell as a process.
    Cell(cell::CellArgs),
    /// Show why a version is in its state.
    Explain(explain::ExplainArgs),
    /// Compare the live cell with an earlier period: success, violations, time and force.
    Health(health::HealthArgs),
    /// List the open alarms, or the history of all.
    Alarms(alarms::AlarmsArgs),
    #[cfg(feature = "console")]
    /// Replay the recording of an upgrade, or run one of its episodes again.
    Replay(replay::ReplayArgs),
    /// Create, build, test and run a skill of your own.
    Skill(skill::SkillArgs),
    /// Check, compare and register candidates.
    Candidate(candidate::CandidateArgs),
    /// Run a scripted upgrade without a screen.
    Scenario(scenario::ScenarioArgs),
    /// Run the demonstration in a temporary store, or in the one that --data names.
    Demo(demo::DemoArgs),
    /// Run the engine on the store as a service until a signal ends it; submits nothing.
    Serve(serve::ServeArgs),
    /// Create, enroll, revoke and list the identities that sign decisions.
    Identity(identity::IdentityArgs),
    /// Show and check deployment profiles.
    Profile(profile::ProfileArgs),
    /// Check a site file: robot, cells, families and profile.
    Site(site::SiteArgs),
    /// Inspect, copy, export and repair the store.
    Store(store::StoreArgs),
    /// Read, verify, prove and export the audit log, and name its witnesses.
    Audit(audit::AuditArgs),
    /// List, verify and prune recordings of upgrades.
    Recordings(recordings::RecordingsArgs),
    /// Check whether this machine and terminal have what Holdpoint needs.
    Doctor(doctor::DoctorArgs),
    /// Measure the engine on this machine.
    Bench(bench::BenchArgs),
    /// Compute metrics from telemetry and audit log.
    Metrics(metrics::MetricsArgs),
    /// Say how to start the laboratory, the program for experiments.
    Lab(lab::LabArgs),
    /// Print a completion script for a shell.
    Completions(completions::CompletionsArgs),
    /// Print the manual page, or write one for each verb.
    Man(man::ManArgs),
    /// Print the JSON schemas of the socket's messages.
    Schema(schema::SchemaArgs),
    #[cfg(feature = "console")]
    /// Print the console's keys.
    Keys(keys::KeysArgs),
    #[cfg(feature = "console")]
    /// Show the console's themes.
    Theme(theme::ThemeArgs),
    /// Print what the exit codes mean.
    #[command(hide = true, before_help = roles::exit_codes(), after_help = "\
Example:
  holdpoint exit-codes")]
    ExitCodes,
}

impl Cli {
    /// Parses a command line, which may have former names of verbs.
    ///
    /// # Errors
    /// If the line is not one of the program's.
    pub fn parse_line(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let arguments = with_present_names(arguments.into_iter().collect());
        let matches = Self::program().try_get_matches_from(arguments).map_err(with_near_names)?;
        <Self as clap::FromArgMatches>::from_arg_matches(&matches)
    }

    /// The program's definition, with the help by role.
    #[must_use]
    pub fn program() -> clap::Command {
        Self::command().override_help(roles::help())
    }
}

/// Puts the most similar verb first, and takes out an option that is similar by its letters alone, as `--as` is to `--pase`.
fn with_near_names(mut error: clap::Error) -> clap::Error {
    if let Some(ContextValue::Strings(mut verbs)) = error.remove(ContextKind::SuggestedSubcommand) {
        verbs.reverse();
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(verbs));
    }
    let is_far = match (error.get(ContextKind::InvalidArg), error.get(ContextKind::SuggestedArg)) {
        (Some(ContextValue::String(given)), Some(ContextValue::String(known))) => {
            !known.starts_with(given.as_str()) && given.len().abs_diff(known.len()) > 1
        }
        _ => false,
    };
    if is_far {
        error.remove(ContextKind::SuggestedArg);
    }
    error
}

/// Runs the program: parses `arguments`, dispatches the verb, prints, and returns the exit code.
pub fn entry(arguments: impl IntoIterator<Item = OsString>, engine: &mut dyn EngineVerbs) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let json = wants_json(&arguments);
    let cli = match Cli::parse_line(arguments) {
        Ok(cli) => cli,
        Err(error) => return print_usage(&error, json),
    };
    let mut out = CommandOutput::stdout(json);
    let ended = dispatch(&cli, engine, &mut out).map_err(|error| match &cli.data {
        Some(folder) => error.with_store_in_hint(folder),
        None => error,
    });
    end(ended, &mut out)
}

/// A write beyond the limit of a file's size fails with an error; without a handler, its signal ends the process.
pub fn survive_file_size_limit() {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_io().build() else { return };
    let _inside = runtime.enter();
    // The handler stays until the process ends. Without it, the program works as before.
    drop(signal(SignalKind::from_raw(Signal::XFSZ.as_raw())));
}

/// Whether answers and errors are JSON, also where the line cannot be parsed.
#[must_use]
pub fn wants_json(arguments: &[OsString]) -> bool {
    arguments.iter().any(|argument| argument == "--json")
}

/// Ends a program: writes the buffered output, prints the error, and returns the exit code.
pub fn end(ended: Result<Exit, CliError>, out: &mut CommandOutput<'_>) -> Exit {
    match ended.and_then(|exit| out.flush().map(|()| exit)) {
        Ok(exit) => exit,
        Err(error) => {
            let mut stderr = std::io::stderr().lock();
            if out.is_json() {
                error.print_json(&mut stderr);
            } else {
                error.print(&mut stderr);
            }
            error.exit()
        }
    }
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`] with the exit code to end with.
pub fn dispatch(
    cli: &Cli,
    engine: &mut dyn EngineVerbs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let context = || {
        let data = data::folder(cli.data.as_deref())?;
        Ok::<CliContext, CliError>(CliContext { data, data_given: cli.data.is_some(), json: cli.json })
    };
    // A verb with a temporary store of its own needs no home folder.
    let without_home = || CliContext {
        data: data::folder(cli.data.as_deref()).unwrap_or_default(),
        data_given: cli.data.is_some(),
        json: cli.json,
    };
    match &cli.verb {
        None => engine.run(&context()?, EngineVerb::Without, out),
        Some(Verb::Run(args)) if args.script.is_some() => {
            engine.run(&without_home(), EngineVerb::Run(args), out)
        }
        Some(Verb::Run(args)) => engine.run(&context()?, EngineVerb::Run(args), out),
        Some(Verb::Stop(args)) => stop::stop(&context()?, args, out),
        Some(Verb::Start(args)) => stop::start(&context()?, args, out),
        Some(Verb::Status(args)) => engine.run(&context()?, EngineVerb::Status(args), out),
        Some(Verb::Approve(args)) => decide::approve(&context()?, args, out),
        Some(Verb::Reject(args)) => decide::reject(&context()?, args, out),
        Some(Verb::Pause(args)) => decide::pause(&context()?, args, out),
        Some(Verb::Resume(args)) => decide::resume(&context()?, args, out),
        Some(Verb::Rollback(args)) => decide::rollback(&context()?, args, out),
        Some(Verb::Version(args)) => version::run(&context()?, args, out),
        Some(Verb::Cell(args)) => cell::run(&context()?, args, out),
        Some(Verb::Explain(args)) => explain::run(&context()?, args, out),
        Some(Verb::Health(args)) => health::run(&context()?, args, out),
        Some(Verb::Alarms(args)) => alarms::run(&context()?, args, out),
        #[cfg(feature = "console")]
        Some(Verb::Replay(args)) => replay::run(&context()?, args, out),
        Some(Verb::Skill(args)) => skill::run(&context()?, args, out),
        Some(Verb::Candidate(args)) => candidate::run(&context()?, args, engine, out),
        Some(Verb::Scenario(args)) => {
            let scenario::ScenarioVerb::Run(args) = &args.verb;
            engine.run(&without_home(), EngineVerb::Run(&args.clone().into()), out)
        }
        Some(Verb::Demo(args)) => engine.run(&without_home(), EngineVerb::Demo(args), out),
        Some(Verb::Serve(args)) => engine.run(&context()?, EngineVerb::Serve(args), out),
        Some(Verb::Identity(args)) => identity::run(&context()?, args, out),
        Some(Verb::Profile(args)) => profile::run(&context()?, args, out),
        Some(Verb::Site(args)) => site::run(&without_home(), args, out),
        Some(Verb::Store(args)) => store::run(&context()?, args, out),
        Some(Verb::Audit(args)) => audit::run(&context()?, args, out),
        Some(Verb::Recordings(args)) => recordings::run(&context()?, args, out),
        Some(Verb::Doctor(args)) => doctor::run(&context()?, args, out),
        Some(Verb::Bench(args)) => engine.run(&without_home(), EngineVerb::Bench(args), out),
        Some(Verb::Metrics(args)) => metrics::run(&context()?, args, out),
        Some(Verb::Lab(args)) => Err(args.error()),
        Some(Verb::Completions(args)) => completions::run(Cli::command(), cli.data.as_deref(), args, out),
        Some(Verb::Man(args)) => man::run(Cli::command(), args, out),
        Some(Verb::Schema(args)) => schema::run(args, out),
        #[cfg(feature = "console")]
        Some(Verb::Keys(args)) => keys::run(args, out),
        #[cfg(feature = "console")]
        Some(Verb::Theme(args)) => theme::run(args, out),
        Some(Verb::ExitCodes) => {
            let meanings: std::collections::BTreeMap<_, _> =
                Exit::ALL.iter().map(|exit| (exit.code(), exit.meaning())).collect();
            out.answer(&meanings, |out| Ok(out.sink().write_all(roles::exit_codes().as_bytes())?))?;
            Ok(Exit::Confirmed)
        }
    }
}

#[cfg(test)]
mod tests;
