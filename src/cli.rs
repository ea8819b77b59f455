//! The command line: what can be asked, how answers and errors are printed, and the exit codes.
//!
//! Owns argument parsing, output and exit codes, and the verbs that need no engine. What it must not do: decide
//! anything, or print foreign text that did not pass the sanitiser. Verbs that need the engine are handed to an
//! [`EngineVerbs`].

pub mod alarms;
pub mod audit;
mod bar;
pub mod bench;
pub mod candidate;
pub mod chosen;
pub mod completions;
mod confirm_time;
#[cfg(feature = "console")]
mod console;
mod context;
pub mod data;
pub mod decide;
pub mod demo;
pub mod doctor;
mod engine_verbs;
pub mod experiment;
pub mod explain;
pub mod health;
pub mod identity;
pub mod kept;
#[cfg(feature = "console")]
pub mod keys;
pub mod man;
pub mod metrics;
pub mod output;
mod own_folder;
#[cfg(feature = "console")]
mod own_service;
pub mod paper;
mod passphrase;
pub mod per_candidate;
pub mod pool;
pub mod profile;
mod profile_on_record;
pub mod proof;
mod prune;
pub mod recordings;
pub mod refine;
pub mod registry;
#[cfg(feature = "console")]
pub mod replay;
pub mod run;
pub mod schema;
pub mod serve;
#[cfg(feature = "console")]
mod settings;
mod side;
pub mod skill;
pub mod status;
pub mod stop;
pub mod store;
#[cfg(feature = "console")]
pub mod theme;
pub mod truth;
pub mod verify;
mod when;
pub mod witness;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory, Parser, Subcommand};

pub use crate::error::{CliError, Exit};
pub use context::CliContext;
pub use engine_verbs::{EngineVerbs, RealEngine};
pub use output::Output;
pub(crate) use side::refused;

/// Decides whether a new version of a robot's skill may take control of the robot.
///
/// Without a command it opens the console; without a terminal it runs the demonstration.
#[derive(Clone, Debug, Parser)]
#[command(name = "holdpoint", bin_name = "holdpoint", version, max_term_width = 100, after_help = AFTER_HELP)]
pub struct Cli {
    #[allow(clippy::doc_markdown, reason = "the help prints it as it stands")]
    /// The store's folder [default: $XDG_DATA_HOME/holdpoint or ~/.local/share/holdpoint].
    #[arg(long, global = true, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Prints JSON, one document a line.
    #[arg(long, global = true)]
    pub json: bool,
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: Option<Verb>,
}

const AFTER_HELP: &str = "\
Exit codes:
  0 confirmed or done, 1 rejected, 2 usage or configuration, 3 held or timed out, 4 rolled back,
  5 nothing was judged, 6 not confirmed by the engine, 70 internal error

Examples:
  holdpoint
  holdpoint run --headless --script tests/scenarios/promote-benign.toml --json
  holdpoint candidate check manifests/candidates/grasp-improved";

/// What can be asked.
#[derive(Clone, Debug, Subcommand)]
pub enum Verb {
    /// Runs upgrades: in the console, or without a screen from a script.
    Run(run::RunArgs),
    /// Runs the engine on the store until it is told to end, as a service; submits nothing.
    Serve(serve::ServeArgs),
    /// Runs the demonstration in a store of its own, which is removed afterwards unless --data names one.
    Demo(demo::DemoArgs),
    /// Shows what versions there are.
    Registry(registry::RegistryArgs),
    /// Registers, checks and compares candidates.
    Candidate(candidate::CandidateArgs),
    /// Makes a skill of one's own code: begins, builds, tries it.
    Skill(skill::SkillArgs),
    /// Shows or awaits the state of families and candidates.
    Status(status::StatusArgs),
    /// Approves a candidate that waits for approval.
    Approve(decide::ApproveArgs),
    /// Rejects a candidate.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Reject(decide::VersionArgs),
    /// Rolls a family back to its predecessor.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Rollback(decide::FamilyArgs),
    /// Stops the arm at once, whatever is under way; `go` lets it work again.
    Stop(stop::StopArgs),
    /// Lets a stopped cell work again.
    Go(stop::GoArgs),
    /// Says what the agent of the live cell works towards.
    Goal(stop::GoalArgs),
    /// Confirms what the machine's clock says, where it was set; nothing is activated before.
    ConfirmTime(confirm_time::ConfirmTimeArgs),
    /// Leaves a note for those who come after.
    Note(stop::NoteArgs),
    /// Sends a version back to evaluation, or closes profiles to it.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Demote(decide::DemoteArgs),
    /// Runs sandbox or shadow of a version again.
    Repeat(decide::RepeatArgs),
    /// Tightens the envelope of an active version.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Restrict(decide::VersionArgs),
    /// Lifts the restriction of an active version, or opens closed profiles.
    Release(decide::ReleaseArgs),
    /// Answers a monitor's question: the version goes on.
    Continue(decide::VersionArgs),
    /// Makes a superseded version of a stopped family active again.
    Rearm(decide::VersionArgs),
    /// Emergency: one person lets a version in alone; two others review it.
    BreakGlass(decide::BreakGlassArgs),
    /// Pauses the pipeline; reject, demote and rollback still work.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Pause(decide::PauseArgs),
    /// Resumes a paused pipeline.
    Resume(decide::PauseArgs),
    /// Says why a version stands where it stands, decision by decision.
    Explain(explain::ExplainArgs),
    /// Shows whether the live cell is better or worse than it was: success, violations, time and force over time.
    Health(health::HealthArgs),
    /// Computes the metrics that can be had from telemetry and record.
    Metrics(metrics::MetricsArgs),
    /// Makes, enrols, revokes and lists the identities that sign decisions.
    Identity(identity::IdentityArgs),
    /// Shows and checks deployment profiles.
    Profile(profile::ProfileArgs),
    /// Draws pools of candidates for experiments.
    Pool(pool::PoolArgs),
    /// Shows the alarms that are open, or the history of all.
    Alarms(alarms::AlarmsArgs),
    /// Reads, verifies, proves and exports the audit log, and names its witnesses.
    Audit(audit::AuditArgs),
    /// Looks at the store, copies it, writes its history out, and mends it.
    Store(store::StoreArgs),
    #[cfg(feature = "console")]
    /// Shows what was recorded of an upgrade.
    Replay(replay::ReplayArgs),
    /// Lists, verifies and prunes recordings of upgrades.
    Recordings(recordings::RecordingsArgs),
    /// Makes a candidate of a baseline by optimising its parameters on success alone.
    Refine(refine::RefineArgs),
    /// Measures the engine on this machine.
    Bench(bench::BenchArgs),
    /// Runs an experiment and writes its report.
    Experiment(experiment::ExperimentArgs),
    /// Tells whether this machine and terminal have what is needed.
    Doctor(doctor::DoctorArgs),
    #[cfg(feature = "console")]
    /// Prints the console's keys.
    Keys(keys::KeysArgs),
    #[cfg(feature = "console")]
    /// Shows the console's themes.
    Theme(theme::ThemeArgs),
    /// Prints a completion script for a shell.
    Completions(completions::CompletionsArgs),
    /// Prints the manual page, or writes one for each verb.
    Man(man::ManArgs),
    /// Prints the JSON schemas of what goes over the socket.
    Schema(schema::SchemaArgs),
}

/// The whole program but its engine: parses `arguments`, does what they ask, prints, and says how it ended.
pub fn entry(arguments: impl IntoIterator<Item = OsString>, engine: &mut dyn EngineVerbs) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    // What cannot be parsed still says what form its error is wanted in.
    let json = arguments.iter().any(|argument| argument == "--json");
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => return crate::error::print_usage(&error, json),
    };
    let mut out = Output::stdout(cli.json);
    let ended = dispatch(&cli, engine, &mut out).and_then(|exit| out.flush().map(|()| exit));
    match ended {
        Ok(exit) => exit,
        Err(error) => {
            let mut stderr = std::io::stderr().lock();
            if cli.json {
                error.print_json(&mut stderr);
            } else {
                error.print(&mut stderr);
            }
            error.exit()
        }
    }
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`] with the exit code to end with.
pub fn dispatch(cli: &Cli, engine: &mut dyn EngineVerbs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    use decide::AskedDecision;
    let context = || {
        let data = data::folder(cli.data.as_deref())?;
        Ok::<CliContext, CliError>(CliContext { data, data_given: cli.data.is_some(), json: cli.json })
    };
    match &cli.verb {
        None => engine.without_verb(&context()?, out),
        Some(Verb::Run(args)) => engine.run(&context()?, args, out),
        Some(Verb::Serve(args)) => engine.serve(&context()?, args, out),
        Some(Verb::Demo(args)) => engine.demo(&context()?, args, out),
        Some(Verb::Registry(args)) => registry::run(&context()?, args, out),
        Some(Verb::Candidate(args)) => candidate::run(&context()?, args, engine, out),
        Some(Verb::Skill(args)) => skill::run(&context()?, args, out),
        Some(Verb::Status(args)) => engine.status(&context()?, args, out),
        Some(Verb::Approve(args)) => engine.decide(&context()?, &AskedDecision::Approve(args.clone()), out),
        Some(Verb::Reject(args)) => engine.decide(&context()?, &AskedDecision::Reject(args.clone()), out),
        Some(Verb::Rollback(args)) => engine.decide(&context()?, &AskedDecision::Rollback(args.clone()), out),
        Some(Verb::Demote(args)) => engine.decide(&context()?, &AskedDecision::Demote(args.clone()), out),
        Some(Verb::Stop(args)) => engine.decide(&context()?, &AskedDecision::Stop(args.clone()), out),
        Some(Verb::Go(args)) => engine.decide(&context()?, &AskedDecision::Go(args.clone()), out),
        Some(Verb::Goal(args)) => engine.decide(&context()?, &AskedDecision::Goal(args.clone()), out),
        Some(Verb::ConfirmTime(args)) => {
            engine.decide(&context()?, &AskedDecision::ConfirmTime(args.clone()), out)
        }
        Some(Verb::Note(args)) => engine.decide(&context()?, &AskedDecision::Note(args.clone()), out),
        Some(Verb::Pause(args)) => engine.decide(&context()?, &AskedDecision::Pause(args.clone()), out),
        Some(Verb::Resume(args)) => engine.decide(&context()?, &AskedDecision::Resume(args.clone()), out),
        Some(Verb::Repeat(args)) => engine.decide(&context()?, &AskedDecision::Repeat(args.clone()), out),
        Some(Verb::Restrict(args)) => engine.decide(&context()?, &AskedDecision::Restrict(args.clone()), out),
        Some(Verb::Release(args)) => engine.decide(&context()?, &AskedDecision::Release(args.clone()), out),
        Some(Verb::Continue(args)) => engine.decide(&context()?, &AskedDecision::Continue(args.clone()), out),
        Some(Verb::Rearm(args)) => engine.decide(&context()?, &AskedDecision::Rearm(args.clone()), out),
        Some(Verb::BreakGlass(args)) => {
            engine.decide(&context()?, &AskedDecision::BreakGlass(args.clone()), out)
        }
        Some(Verb::Explain(args)) => explain::run(&context()?, args, out),
        Some(Verb::Health(args)) => health::run(&context()?, args, out),
        Some(Verb::Metrics(args)) => metrics::run(&context()?, args, out),
        Some(Verb::Identity(args)) => identity::run(&context()?, args, out),
        Some(Verb::Profile(args)) => profile::run(&context()?, args, out),
        Some(Verb::Pool(args)) => pool::run(args, out),
        Some(Verb::Alarms(args)) => alarms::run(&context()?, args, out),
        Some(Verb::Audit(args)) => audit::run(&context()?, args, out),
        Some(Verb::Store(args)) => store::run(&context()?, args, out),
        #[cfg(feature = "console")]
        Some(Verb::Replay(args)) => replay::run(&context()?, args, out),
        Some(Verb::Recordings(args)) => recordings::run(&context()?, args, out),
        Some(Verb::Refine(args)) => refine::run(args, out),
        Some(Verb::Bench(args)) => engine.bench(&context()?, args, out),
        Some(Verb::Experiment(args)) => experiment::run(args, out),
        Some(Verb::Doctor(args)) => doctor::run(&context()?, args, out),
        #[cfg(feature = "console")]
        Some(Verb::Keys(args)) => keys::run(args, out),
        #[cfg(feature = "console")]
        Some(Verb::Theme(args)) => theme::run(args, out),
        Some(Verb::Completions(args)) => completions::run(Cli::command(), cli.data.as_deref(), args, out),
        Some(Verb::Man(args)) => man::run(Cli::command(), args, out),
        Some(Verb::Schema(args)) => schema::run(args, out),
    }
}

#[cfg(test)]
mod tests;
