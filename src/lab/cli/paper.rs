//! `holdpoint-lab experiment e1|e2|e3|e4|e5|sensitivity|meta-faults|overhead|ablation|all`: arguments and the printed report.
//!
//! Prints the results of [`crate::paper_reproduction`]; measures and judges nothing.

use super::{failed, jobs_or_cores, progress};
use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use super::truth::shard;
use crate::paper_reproduction::run::{self, ExperimentPart, PaperOutcome, PaperPlan};
use crate::paper_reproduction::{PaperSetup, Preset, report};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};

/// The arguments of the paper's experiments.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint-lab experiment e2 --preset smoke --out paper-smoke
  holdpoint-lab experiment all --preset paper-e2 --out paper
  holdpoint-lab experiment e2 --preset claims --out paper --shard 1/8")]
pub struct PaperArgs {
    /// The number of runs.
    #[arg(long, value_name = "NAME", default_value_t = Preset::Smoke, value_parser = presets())]
    pub preset: Preset,
    /// The first seed to run, of those in the preset [default: its first].
    #[arg(long, value_name = "SEED")]
    pub first_seed: Option<u64>,
    /// Fewer seeds than in the preset.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=60))]
    pub seeds: Option<u64>,
    /// Seeds whose pools pass through the stages under each profile, 0 for rounds alone [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=60))]
    pub pools: Option<u64>,
    /// Of those, seeds whose pools also pass through with parts of the pipeline left out [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=60))]
    pub ablated: Option<u64>,
    /// Runs of the drift experiment [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=60))]
    pub drifts: Option<u64>,
    /// Jobs at once [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// One shard, counted from 1; a run without it writes the report and reuses all finished cells.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "1/1")]
    pub shard: (usize, usize),
    /// The folder for cells and report; finished cells in it are not run again.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The key that authenticates finished cells.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// The presets with their content.
fn presets() -> impl TypedValueParser<Value = Preset> {
    let described = |preset: Preset| PossibleValue::new(preset.name()).help(answers::paper_preset(preset));
    PossibleValuesParser::new(Preset::ALL.map(described)).try_map(|name| name.parse::<Preset>())
}

/// The arguments of `experiment report`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint-lab experiment report --out recordings/reports/claims-rounds")]
pub struct ReportArgs {
    /// The report's folder with report.toml and the rows it names; the report beside them is rewritten.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes a report again from its raw rows and prints the results.
///
/// # Errors
/// If a file cannot be used, or has a line that is not allowed.
pub fn regenerate_report(args: &ReportArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    print_outcome(&PaperOutcome { summary: report::write(&args.out).map_err(failed)? }, out)
}

/// Runs the experiments and prints the results.
///
/// # Errors
/// If the folder cannot be used, or a candidate does not reach an end.
pub fn run(args: &PaperArgs, part: ExperimentPart, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let mut size = args.preset.size();
    if let Some(first) = args.first_seed {
        size = size.beginning_at(first).ok_or_else(|| {
            CliError::usage(ExperimentError::Option {
                option: "--first-seed",
                value: first.to_string(),
                allowed: "a seed that the preset has",
            })
        })?;
    }
    if let Some(seeds) = args.seeds {
        if seeds > size.seeds {
            return Err(CliError::usage(ExperimentError::Option {
                option: "--seeds",
                value: seeds.to_string(),
                allowed: "at most as many as the preset has, from its first seed or from --first-seed on",
            }));
        }
        size.seeds = seeds;
    }
    let cache = args.cache_key.open_cache(&args.out.join("kept"))?;
    let setup = PaperSetup::new(cache, args.shard, jobs_or_cores(args.jobs)).map_err(failed)?;
    size.pools = args.pools.unwrap_or(size.pools).min(size.seeds);
    size.ablated = args.ablated.unwrap_or(size.ablated).min(size.pools);
    size.drifts = args.drifts.unwrap_or(size.drifts).min(size.seeds);
    let plan = PaperPlan { part, preset: args.preset, size, out: args.out.clone() };
    print_outcome(&run::run(&setup, &plan, &progress::tell).map_err(failed)?, out)
}

fn print_outcome(outcome: &PaperOutcome, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    if out.is_json() {
        out.json(outcome)?;
        return Ok(Exit::Confirmed);
    }
    for line in &outcome.summary {
        out.line(line)?;
    }
    Ok(Exit::Confirmed)
}
