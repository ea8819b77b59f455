//! The verbs that need the engine, carried out by the real one.
//!
//! Chooses between an engine that runs on the store and one that is opened for the verb; must not decide
//! anything itself.

use super::{CliError, Context, EngineVerbs, Exit, Output, bench, candidate, decide, run, status};
use crate::headless::{RunPlain, RunScript, run_plain, run_script};

/// The seed of a run that names none.
const SEED_DEFAULT: u64 = 1;

/// The engine of this program.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealEngine;

impl EngineVerbs for RealEngine {
    fn run(
        &mut self,
        context: &Context,
        args: &run::RunArgs,
        out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        let json = context.json;
        let robot = args.robot.as_deref();
        match &args.script {
            Some(script) => {
                let run = RunScript {
                    script,
                    data: context.data_given.then_some(context.data.as_path()),
                    cache: args.cache.as_deref(),
                    seed: args.seed,
                    jobs: args.jobs(),
                    robot,
                    json,
                };
                run_script(&run, out.sink())
            }
            None => {
                let run = RunPlain {
                    data: &context.data,
                    profile: args.profile(),
                    seed: args.seed.unwrap_or(SEED_DEFAULT),
                    jobs: args.jobs(),
                    robot,
                    json,
                };
                run_plain(&run, out.sink())
            }
        }
    }

    fn register(
        &mut self,
        _context: &Context,
        _args: &candidate::RegisterArgs,
        _out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        Err(CliError::usage("registering needs an engine that this build does not start by itself"))
    }

    fn status(
        &mut self,
        _context: &Context,
        _args: &status::StatusArgs,
        _out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        Err(CliError::usage("the status needs an engine that this build does not start by itself"))
    }

    fn decide(
        &mut self,
        _context: &Context,
        _asked: &decide::Asked,
        _out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        Err(CliError::usage("deciding needs an engine that this build does not start by itself"))
    }

    fn bench(
        &mut self,
        _context: &Context,
        _args: &bench::BenchArgs,
        _out: &mut Output<'_>,
    ) -> Result<Exit, CliError> {
        Err(CliError::usage("this build does not measure yet"))
    }
}
