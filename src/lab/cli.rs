//! The command line of `holdpoint-lab`: experiments, pools, the optimizer, benchmarks of rules and peers.
//!
//! Parses arguments and prints reports. Answers, errors and exit codes are those of `holdpoint`.

mod bench;
mod danger;
mod demonstrations;
mod distinguisher;
mod experiment;
mod paper;
mod per_candidate;
mod pool;
mod progress;
mod refine;
mod sensors;
mod series;
mod throwers;
mod truth;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use holdpoint::cli::output::TextTable;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::{JOBS_MAX, ProfileArg};
use holdpoint::cli::{CommandOutput, end, wants_json};
use holdpoint::error::{CliError, Exit, print_usage};
use holdpoint_store::ResultCache;

use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::per_candidate::RunPlan;

/// Measures Holdpoint: experiments, pools of candidates, an optimizer, benchmarks.
#[derive(Clone, Debug, Parser)]
#[command(
    name = "holdpoint-lab",
    bin_name = "holdpoint-lab",
    version,
    max_term_width = 100,
    after_help = "\
Examples:
  holdpoint-lab pool generate --seed 1 --out pool-1
  holdpoint-lab experiment drift --runs 2 --out results/drift
  holdpoint-lab bench decision"
)]
struct LabCli {
    /// Prints JSON, one document a line.
    #[arg(long, global = true)]
    json: bool,
    /// The verb with its arguments.
    #[command(subcommand)]
    verb: LabVerb,
}

/// The verbs.
#[derive(Clone, Debug, Subcommand)]
enum LabVerb {
    /// Sample pools of candidates for experiments.
    Pool(pool::PoolArgs),
    /// Derive a candidate from a baseline: optimize its parameters for success alone.
    Refine(refine::RefineArgs),
    /// Run an experiment and write its report.
    Experiment(experiment::ExperimentArgs),
    /// Measure the rules, whole decisions and other physics engines.
    Bench(bench::LabBenchArgs),
}

/// The program's definition.
#[must_use]
pub fn program() -> clap::Command {
    <LabCli as clap::CommandFactory>::command()
}

/// Runs the program: parses `arguments`, runs the verb, prints, and returns the exit code.
#[must_use]
pub fn entry(arguments: impl IntoIterator<Item = OsString>) -> Exit {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let json = wants_json(&arguments);
    match LabCli::try_parse_from(arguments) {
        Ok(cli) => {
            let mut out = CommandOutput::stdout(cli.json);
            let ended = run(&cli.verb, &mut out);
            end(ended, &mut out)
        }
        Err(error) => print_usage(&error, json),
    }
}

fn run(verb: &LabVerb, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match verb {
        LabVerb::Pool(args) => pool::run(args, out),
        LabVerb::Refine(args) => refine::run(args, out),
        LabVerb::Experiment(args) => experiment::run(args, out),
        LabVerb::Bench(args) => bench::run(args, out),
    }
}

/// Where an experiment caches its results.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct CacheArgs {
    /// Caches finished results here; an interrupted run continues from them.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The key that authenticates them.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

impl CacheArgs {
    fn open(&self) -> Result<Option<ResultCache>, CliError> {
        let folder = self.out.as_ref().map(|out| out.join("kept"));
        self.cache_key.open_cache_if_named(folder.as_deref(), "--out")
    }
}

/// A pool whose candidates go through the stages.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct PoolRunArgs {
    /// The pool's folder; its truth file is beside it.
    #[arg(long, value_name = "DIR")]
    pub pool: PathBuf,
    /// A profile, from the least strict to the strictest; can be given several times.
    #[arg(long = "profile", value_name = "NAME", value_enum, default_value = "sim")]
    pub profiles: Vec<ProfileArg>,
    /// The first run seed. Below 100 its episodes were never used for tuning.
    #[arg(long, default_value_t = 30, value_name = "N")]
    pub seed: u64,
    /// Run seeds that the candidates are distributed over, 1 to 100.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100))]
    pub blocks: u64,
    /// Candidates at once [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The cache of finished results.
    #[command(flatten)]
    pub cache: CacheArgs,
}

impl PoolRunArgs {
    fn plan(&self) -> Result<RunPlan, CliError> {
        Ok(RunPlan {
            pool: self.pool.clone(),
            profiles: self.profiles.iter().map(|profile| (*profile).into()).collect(),
            seed: self.seed,
            blocks: self.blocks,
            jobs: jobs_or_cores(self.jobs),
            cache: self.cache.open()?,
        })
    }
}

/// The items that run at once: the asked number, or one for each core.
fn jobs_or_cores(asked: Option<u16>) -> usize {
    asked.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), usize::from)
}

/// The error of an experiment: a wrong option, file or pool is a usage error.
fn failed(error: ExperimentError) -> CliError {
    match error {
        ExperimentError::Option { .. }
        | ExperimentError::File { .. }
        | ExperimentError::Text(_)
        | ExperimentError::Pool(_) => CliError::usage(error),
        _ => CliError::fault(error),
    }
}

/// A table without rows; `|` separates its columns.
fn table(columns: &'static str) -> TextTable {
    TextTable::new(&columns.split('|').map(str::trim).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_are_consistent() {
        program().debug_assert();
    }

    #[test]
    fn every_verb_has_examples_that_parse() {
        fn walk(command: &clap::Command, seen: &mut usize) {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let examples: Vec<&str> =
                help.lines().filter(|line| line.starts_with("  holdpoint-lab ")).collect();
            assert!(!examples.is_empty(), "{name}: no example");
            for example in examples {
                let parsed = LabCli::try_parse_from(example.split_whitespace());
                assert!(parsed.is_ok(), "{name}: {example}: {:?}", parsed.err());
                *seen += 1;
            }
            for verb in command.get_subcommands() {
                walk(verb, seen);
            }
        }
        let mut seen = 0;
        walk(&program(), &mut seen);
        assert!(seen >= 15, "{seen}");
    }
}
