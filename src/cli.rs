//! The command line: verbs and options, the printing of answers and errors, exit codes.
//!
//! Owns argument parsing, output and exit codes, and the verbs that need no engine. Decides nothing, and sanitizes
//! all foreign text before it prints. An [`EngineVerbs`] runs the verbs that need the engine.

pub mod alarms;
pub mod audit;
pub mod audit_proof;
pub mod bench;
pub mod candidate;
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
pub mod experiment;
pub mod explain;
pub mod health;
pub mod identity;
#[cfg(feature = "console")]
pub mod keys;
pub mod man;
pub mod metrics;
mod operator_folder;
pub mod output;
pub mod paper;
mod passphrase;
pub mod per_candidate;
pub mod pool;
pub mod profile;
mod profile_authorization;
pub mod profile_choice;
mod progress_bar;
mod prune;
pub mod recordings;
pub mod refine;
pub mod registry;
#[cfg(feature = "console")]
pub mod replay;
pub mod result_cache;
pub mod run;
pub mod schema;
pub mod serve;
#[cfg(feature = "console")]
mod settings;
pub mod skill;
pub mod status;
pub mod stop;
pub mod store;
#[cfg(feature = "console")]
pub mod theme;
mod time_arg;
pub mod truth;
mod verb_executor;
pub mod verify;
pub mod witness;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory, Parser, Subcommand};

pub use crate::error::{CliError, Exit};
pub use context::CliContext;
pub use engine_verbs::{EngineVerbs, RealEngine};
pub use output::CommandOutput;
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
Exit codes:
  0 confirmed or done, 1 rejected, 2 usage or configuration, 3 on hold or timed out,
  4 rolled back, 5 nothing was judged, 6 not confirmed by the engine, 70 internal error

Examples:
  holdpoint
  holdpoint run --headless --script tests/scenarios/promote-benign.toml --json
  holdpoint candidate check manifests/candidates/grasp-improved";

/// The verbs.
#[derive(Clone, Debug, Subcommand)]
pub enum Verb {
    /// Runs upgrades: in the console, or without a screen from a script.
    Run(run::RunArgs),
    /// Runs the engine on the store as a service until a signal ends it; submits nothing.
    Serve(serve::ServeArgs),
    /// Runs the demonstration in a temporary store, or in the one that --data names.
    Demo(demo::DemoArgs),
    /// Lists versions and shows their history.
    Registry(registry::RegistryArgs),
    /// Registers, checks and compares candidates.
    Candidate(candidate::CandidateArgs),
    /// Creates, builds and tests a custom skill.
    Skill(skill::SkillArgs),
    /// Shows or awaits the state of families and candidates.
    Status(status::StatusArgs),
    /// Approves a candidate that waits for approval.
    Approve(decide::ApproveArgs),
    /// Rejects a candidate.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Reject(decide::VersionArgs),
    /// Rolls a family back to its rollback target.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Rollback(decide::FamilyArgs),
    /// Stops the arm at once; `go` starts the cell again.
    Stop(stop::StopArgs),
    /// Starts a stopped cell again.
    Go(stop::GoArgs),
    /// Sets the goal of the agent in the live cell.
    Goal(stop::GoalArgs),
    /// Confirms the machine's clock after a clock mismatch; until then nothing is activated.
    ConfirmTime(confirm_time::ConfirmTimeArgs),
    /// Leaves a note for the next shift.
    Note(stop::NoteArgs),
    /// Returns a version to evaluation, or blocks it under profiles.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Demote(decide::DemoteArgs),
    /// Runs sandbox or shadow of a version again.
    Repeat(decide::RepeatArgs),
    /// Tightens the envelope of an active version.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Restrict(decide::VersionArgs),
    /// Lifts the restriction of an active version, or unblocks it under profiles.
    Release(decide::ReleaseArgs),
    /// Answers an escalation of the drift monitor: the version continues.
    Continue(decide::VersionArgs),
    /// Reactivates a superseded version of a safe-stopped family.
    Rearm(decide::VersionArgs),
    /// Break-glass: one person activates a version in an emergency; two others review it.
    BreakGlass(decide::BreakGlassArgs),
    /// Pauses the pipeline; reject, demote and rollback still work.
    #[command(mut_arg("identity", |arg| arg.help(decide::ANY_NAME)))]
    Pause(decide::PauseArgs),
    /// Resumes a paused pipeline.
    Resume(decide::PauseArgs),
    /// Explains, decision by decision, why a version is in its state.
    Explain(explain::ExplainArgs),
    /// Shows whether the live cell improves or degrades: success, violations, time and force over time.
    Health(health::HealthArgs),
    /// Computes metrics from telemetry and audit log.
    Metrics(metrics::MetricsArgs),
    /// Creates, enrolls, revokes and lists the identities that sign decisions.
    Identity(identity::IdentityArgs),
    /// Shows and checks deployment profiles.
    Profile(profile::ProfileArgs),
    /// Samples pools of candidates for experiments.
    Pool(pool::PoolArgs),
    /// Shows the open alarms, or the history of all.
    Alarms(alarms::AlarmsArgs),
    /// Reads, verifies, proves and exports the audit log, and names its witnesses.
    Audit(audit::AuditArgs),
    /// Inspects, copies, exports and repairs the store.
    Store(store::StoreArgs),
    #[cfg(feature = "console")]
    /// Replays the recording of an upgrade.
    Replay(replay::ReplayArgs),
    /// Lists, verifies and prunes recordings of upgrades.
    Recordings(recordings::RecordingsArgs),
    /// Derives a candidate from a baseline: optimizes its parameters for success alone.
    Refine(refine::RefineArgs),
    /// Measures the engine on this machine.
    Bench(bench::BenchArgs),
    /// Runs an experiment and writes its report.
    Experiment(experiment::ExperimentArgs),
    /// Checks whether this machine and terminal have what Holdpoint needs.
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
    /// Prints the JSON schemas of the socket's messages.
    Schema(schema::SchemaArgs),
}

/// Runs the program: parses `arguments`, dispatches the verb, prints, and returns the exit code.
pub fn entry(arguments: impl IntoIterator<Item = OsString>, engine: &mut dyn EngineVerbs) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    // An error of the parser, too, is printed in the requested format.
    let json = arguments.iter().any(|argument| argument == "--json");
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => return crate::error::print_usage(&error, json),
    };
    let mut out = CommandOutput::stdout(cli.json);
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

/// Runs the verb.
///
/// # Errors
/// [`CliError`] with the exit code to end with.
pub fn dispatch(
    cli: &Cli,
    engine: &mut dyn EngineVerbs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    use decide::RequestedDecision;
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
        Some(Verb::Approve(args)) => {
            engine.decide(&context()?, &RequestedDecision::Approve(args.clone()), out)
        }
        Some(Verb::Reject(args)) => engine.decide(&context()?, &RequestedDecision::Reject(args.clone()), out),
        Some(Verb::Rollback(args)) => {
            engine.decide(&context()?, &RequestedDecision::Rollback(args.clone()), out)
        }
        Some(Verb::Demote(args)) => engine.decide(&context()?, &RequestedDecision::Demote(args.clone()), out),
        Some(Verb::Stop(args)) => engine.decide(&context()?, &RequestedDecision::Stop(args.clone()), out),
        Some(Verb::Go(args)) => engine.decide(&context()?, &RequestedDecision::Go(args.clone()), out),
        Some(Verb::Goal(args)) => engine.decide(&context()?, &RequestedDecision::Goal(args.clone()), out),
        Some(Verb::ConfirmTime(args)) => {
            engine.decide(&context()?, &RequestedDecision::ConfirmTime(args.clone()), out)
        }
        Some(Verb::Note(args)) => engine.decide(&context()?, &RequestedDecision::Note(args.clone()), out),
        Some(Verb::Pause(args)) => engine.decide(&context()?, &RequestedDecision::Pause(args.clone()), out),
        Some(Verb::Resume(args)) => engine.decide(&context()?, &RequestedDecision::Resume(args.clone()), out),
        Some(Verb::Repeat(args)) => engine.decide(&context()?, &RequestedDecision::Repeat(args.clone()), out),
        Some(Verb::Restrict(args)) => {
            engine.decide(&context()?, &RequestedDecision::Restrict(args.clone()), out)
        }
        Some(Verb::Release(args)) => {
            engine.decide(&context()?, &RequestedDecision::Release(args.clone()), out)
        }
        Some(Verb::Continue(args)) => {
            engine.decide(&context()?, &RequestedDecision::Continue(args.clone()), out)
        }
        Some(Verb::Rearm(args)) => engine.decide(&context()?, &RequestedDecision::Rearm(args.clone()), out),
        Some(Verb::BreakGlass(args)) => {
            engine.decide(&context()?, &RequestedDecision::BreakGlass(args.clone()), out)
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
