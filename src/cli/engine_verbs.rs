//! The verbs that run, feed or watch an engine, and the real engine that carries them out.
//!
//! Chooses between a running engine and one opened for the verb; decides nothing itself.

use std::time::Duration;

use super::verb_executor::{VerbExecutor, last_cell, running};
use super::{bench, candidate, data, decide, demo, profile_choice, run, serve, status};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use crate::headless::{
    PlainWork, RunPlain, RunScript, RunStage, ServiceSetup, run_plain, run_script, run_stage,
};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::Command;
use holdpoint_runtime::capability::shown;
use holdpoint_service::engine_handle::LaunchConfig;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_wording::program::run as sentences;

/// A verb that runs, feeds or watches an engine, with its arguments.
#[derive(Clone, Copy, Debug)]
pub enum EngineVerb<'a> {
    /// Runs upgrades; `--headless`, `--plain` or the lack of a terminal choose the front end.
    Run(&'a run::RunArgs),
    /// Opens the console, or without a terminal runs the demonstration.
    Without,
    /// Runs the engine on the store until a signal ends it.
    Serve(&'a serve::ServeArgs),
    /// Takes a demonstration candidate through the stages.
    Demo(&'a demo::DemoArgs),
    /// Registers a candidate's folder.
    Register(&'a candidate::RegisterArgs),
    /// Runs one stage of one candidate.
    Stage(&'a candidate::StageArgs, Stage),
    /// Shows, watches or awaits states.
    Status(&'a status::StatusArgs),
    /// Measures the engine.
    Bench(&'a bench::BenchArgs),
}

/// Carries out the verbs that run, feed or watch an engine.
pub trait EngineVerbs {
    /// Prints the verb's answer and returns the exit code.
    ///
    /// # Errors
    /// [`CliError`] with the exit code to end with.
    fn run(
        &mut self,
        context: &CliContext,
        verb: EngineVerb<'_>,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;
}

/// The engine of this program.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealEngine;

impl EngineVerbs for RealEngine {
    fn run(
        &mut self,
        context: &CliContext,
        verb: EngineVerb<'_>,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        match verb {
            EngineVerb::Run(args) => run(context, args, out),
            EngineVerb::Without => without_verb(context, out),
            EngineVerb::Serve(args) => serve(context, args, out),
            EngineVerb::Demo(args) => demo(context, args, out),
            EngineVerb::Register(args) => register(context, args, out),
            EngineVerb::Stage(args, stage) => run_one_stage(context, args, stage, out),
            EngineVerb::Status(args) => status::run(context, args, out),
            EngineVerb::Bench(args) => bench::run(args, out),
        }
    }
}

fn run(context: &CliContext, args: &run::RunArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let json = context.json;
    let robot = args.engine.robot.as_deref();
    let cache = args.cache_key.open_cache_if_named(args.cache.as_deref(), "--cache")?;
    match &args.script {
        Some(script) => {
            let data = context.data_given.then_some(context.data.as_path());
            let run = RunScript {
                script,
                data,
                cache,
                seed: args.seed,
                jobs: args.engine.jobs(),
                robot,
                site: args.engine.site(data)?,
                json,
                sinks: args.scenes.options(context.data_given).sinks()?,
            };
            run_script(run, out.sink())
        }
        #[cfg(feature = "console")]
        None if super::console::fits(args, json) => super::console::run(context, args, out),
        None => {
            let site = args.engine.site(Some(&context.data))?;
            let run = RunPlain {
                work: PlainWork::Waiting,
                data: &context.data,
                profile: args.engine.profile(&context.data, site.as_ref())?,
                seeds: EpisodeSeeds::Secret,
                jobs: args.engine.jobs(),
                robot,
                site,
                json,
                pace: args.pace.and_then(run::LivePace::times),
                sinks: args.scenes.options(true).sinks()?,
                // The front end was chosen for lack of a terminal, so the input belongs to another program.
                commands: args.plain,
            };
            run_plain(run, out.sink())
        }
    }
}

fn without_verb(context: &CliContext, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    #[cfg(feature = "console")]
    {
        let args = run::RunArgs::default();
        if super::console::fits(&args, context.json) {
            return super::console::run(context, &args, out);
        }
    }
    if context.data_given {
        let text = "without a terminal and without a verb, the demonstration runs in a temporary store";
        let hint = "`holdpoint demo` submits it to this store; `holdpoint serve` runs an engine on it";
        return Err(CliError::usage(text).with_hint(hint));
    }
    demo(context, &demo::DemoArgs::default(), out)
}

fn serve(
    context: &CliContext,
    args: &serve::ServeArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let host = LaunchConfig {
        alone_max: args.attended.map(|secs| Duration::from_secs(u64::from(secs))),
        console_access: args.console_access()?,
        ..args.engine.launch(context, args.pace(), &args.scenes)?
    };
    if args.own_session {
        // The leader of a session has left the terminal already.
        let _ = rustix::process::setsid();
    }
    let service = ServiceSetup { host, json: context.json, quiet: args.quiet, only_faults: args.own_session };
    crate::headless::serve(service, out.sink())
}

fn demo(context: &CliContext, args: &demo::DemoArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let fresh = if context.data_given { None } else { Some(crate::headless::fresh_store()?) };
    let data = fresh.as_ref().map_or(context.data.as_path(), tempfile::TempDir::path);
    let site = args.engine.site(Some(data))?;
    let run = RunPlain {
        work: PlainWork::Demonstration,
        data,
        profile: args.engine.profile(data, site.as_ref())?,
        seeds: args.seeds(context.data_given)?,
        jobs: args.engine.jobs(),
        robot: args.engine.robot.as_deref(),
        site,
        json: context.json,
        pace: args.pace.and_then(run::LivePace::times),
        sinks: run::SceneArgs::default().options(context.data_given).sinks()?,
        commands: false,
    };
    run_plain(run, out.sink())
}

fn register(
    context: &CliContext,
    args: &candidate::RegisterArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    // Errors in the folder are reported before an engine opens, so the store stays unchanged.
    let candidate = embedded::read(&args.folder).map_err(CliError::usage)?;
    let (package, name) = (Package::clone(&candidate.package), shown(&args.folder));
    let who = match &args.identity {
        Some(name) => Some(super::passphrase::unlock(
            super::passphrase::stored_identity(context, name)?,
            args.passphrase_file.as_deref(),
        )?),
        None => None,
    };
    let mut executor = VerbExecutor::open(context)?;
    let command = Command::Register { package, name, by: None };
    let exit = match &who {
        Some(who) => executor.execute_as(context, who, command, out)?,
        None => executor.execute(command, out)?,
    };
    if executor.is_own() && !out.is_json() {
        out.line(sentences::CANDIDATE_WAITS)?;
    }
    Ok(exit)
}

fn run_one_stage(
    context: &CliContext,
    args: &candidate::StageArgs,
    stage: Stage,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    // An unknown name is reported before an engine opens, so the store stays unchanged.
    decide::known_version(&data::open(&context.data)?, &args.version)?;
    if running(context)?.is_some() {
        let text = "held: the running engine of this store takes candidates through their stages";
        let hint = format!("`holdpoint status {} --watch` shows it", args.version);
        return Err(CliError::from_engine_fault(text).with_hint(hint));
    }
    let run = RunStage {
        data: &context.data,
        profile: profile_choice::last(&context.data)?,
        cell: last_cell(context)?,
        seeds: EpisodeSeeds::Secret,
        jobs: run::jobs(args.jobs),
        json: context.json,
        version: &args.version,
        stage,
    };
    run_stage(run, out.sink())
}
