//! The verbs that run, feed or watch an engine, and the real engine that carries them out.
//!
//! Chooses between a running engine and one opened for the verb; decides nothing itself.

use std::sync::Arc;
use std::time::Duration;

use super::verb_executor::{VerbExecutor, last_cell, running};
use super::{bench, candidate, data, decide, demo, profile_choice, run, serve, status};
use crate::cells::PACED_CELLS;
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

/// The verbs that run, feed or watch an engine. Each prints its answer and returns the exit code.
pub trait EngineVerbs {
    /// Runs upgrades; `args.headless`, `args.plain` or the lack of a terminal choose the front end.
    ///
    /// # Errors
    /// [`CliError`] with the exit code to end with.
    fn run(
        &mut self,
        context: &CliContext,
        args: &run::RunArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Runs without a verb: opens the console, or without a terminal runs the demonstration.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn without_verb(&mut self, context: &CliContext, out: &mut CommandOutput<'_>) -> Result<Exit, CliError>;

    /// Runs the engine on the store until a signal ends it.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn serve(
        &mut self,
        context: &CliContext,
        args: &serve::ServeArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Takes a demonstration candidate through the stages.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn demo(
        &mut self,
        context: &CliContext,
        args: &demo::DemoArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Registers a candidate's folder.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn register(
        &mut self,
        context: &CliContext,
        args: &candidate::RegisterArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Runs one stage of one candidate.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn stage(
        &mut self,
        context: &CliContext,
        args: &candidate::StageArgs,
        stage: Stage,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Shows, watches or awaits states.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn status(
        &mut self,
        context: &CliContext,
        args: &status::StatusArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError>;

    /// Measures the engine.
    ///
    /// # Errors
    /// As [`EngineVerbs::run`].
    fn bench(
        &mut self,
        context: &CliContext,
        args: &bench::BenchArgs,
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
        args: &run::RunArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
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

    fn without_verb(&mut self, context: &CliContext, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
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
        self.demo(context, &demo::DemoArgs::default(), out)
    }

    fn serve(
        &mut self,
        context: &CliContext,
        args: &serve::ServeArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        let site = args.engine.site(Some(&context.data))?;
        let host = LaunchConfig {
            data: context.data.clone(),
            profile: args.engine.profile(&context.data, site.as_ref())?,
            seeds: EpisodeSeeds::Secret,
            jobs: args.engine.spare_jobs(),
            cells: Arc::new(PACED_CELLS),
            robot: args.engine.robot.clone(),
            site,
            pace: args.pace(),
            sinks: args.scenes.options(true).sinks()?,
            alone_max: args.attended.map(|secs| Duration::from_secs(u64::from(secs))),
            console_access: args.console_access()?,
        };
        if args.own_session {
            // The leader of a session has left the terminal already.
            let _ = rustix::process::setsid();
        }
        let service =
            ServiceSetup { host, json: context.json, quiet: args.quiet, only_faults: args.own_session };
        crate::headless::serve(service, out.sink())
    }

    fn demo(
        &mut self,
        context: &CliContext,
        args: &demo::DemoArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
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
        &mut self,
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

    fn stage(
        &mut self,
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

    fn status(
        &mut self,
        context: &CliContext,
        args: &status::StatusArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        status::run(context, args, out)
    }

    fn bench(
        &mut self,
        _context: &CliContext,
        args: &bench::BenchArgs,
        out: &mut CommandOutput<'_>,
    ) -> Result<Exit, CliError> {
        bench::run(args, out)
    }
}
