//! `holdpoint experiment`: arguments, progress lines and the printed report.
//!
//! Prints what [`holdpoint_lab::experiment`] measured; must not measure or judge anything itself.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::kept::CacheKeyArgs;
use super::output::Table;
use super::paper::{self, PaperArgs, ReportArgs};
use super::per_candidate::{self, PerCandidateArgs};
use super::run::JOBS_MAX;
use super::truth::{self, TruthArgs};
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_governance::metrics::Proportion;
use holdpoint_lab::experiment::ExperimentError;
use holdpoint_lab::experiment::drift::{self, DriftCell, DriftOptions, DriftReport, Spread};
use holdpoint_lab::paper::run::Part;
use holdpoint_text::{Hint, WIDTH_MAX, sanitise};

/// The arguments of `experiment`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint experiment drift --runs 30 --out results/drift
  holdpoint experiment drift --runs 2 --seed 100 --horizon 40 --pairs 20 --json
  holdpoint experiment per-candidate --pool pool-7
  holdpoint experiment truth --pool mutants --out truth
  holdpoint experiment all --preset paper-e2 --out paper")]
pub struct ExperimentArgs {
    /// The experiment that was chosen, with its arguments.
    #[command(subcommand)]
    pub which: Which,
}

/// The experiments that can be run.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum Which {
    /// Rollback under drift: four drifts in three magnitudes set in after an activation.
    Drift(DriftArgs),
    /// Every candidate of a pool through the seven stages, scored against its truth file afterwards.
    PerCandidate(PerCandidateArgs),
    /// The paper's screening: a pool's candidates through the stages, by class and dimension.
    E1(PaperArgs),
    /// The paper's rounds of upgrades, by arms that decide about them.
    E2(PaperArgs),
    /// The paper's shadow: what it finds that the sandbox does not, and what it spares.
    E3(PaperArgs),
    /// The paper's rollback under drift, beside its table 8.
    E4(PaperArgs),
    /// The paper's profiles: the same pool under sim, real and human.
    E5(PaperArgs),
    /// The paper's sensitivity: the thresholds a tenth lower and a tenth higher.
    Sensitivity(PaperArgs),
    /// Failures of the governance layer itself, injected: what gets through then.
    MetaFaults(PaperArgs),
    /// The paper's overhead: what a candidate costs, stage by stage, against episodes and candidates.
    Overhead(PaperArgs),
    /// The paper's ablation: rounds and pools with parts of the way left out.
    Ablation(PaperArgs),
    /// All of the paper's experiments, one after the other.
    All(PaperArgs),
    /// Writes a report again from its raw rows alone; nothing is worked.
    Report(ReportArgs),
    /// What candidates really are, by what the referee sees of them, and how decisions stand to it.
    Truth(TruthArgs),
}

/// The arguments of `experiment drift`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint experiment drift --runs 30 --out results/drift
  holdpoint experiment drift --runs 2 --seed 100 --horizon 40 --pairs 20")]
pub struct DriftArgs {
    /// Independent runs; each has a seed and a candidate of its own.
    #[arg(long, value_name = "N", default_value_t = 30)]
    pub runs: u64,
    /// Seed of the first run; the others follow it.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// How many runs at once [default: one per core].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder of cells and report; finished cells in it are not run again.
    #[arg(long, value_name = "DIR", default_value = "experiment-drift")]
    pub out: PathBuf,
    /// What finished cells are authenticated with.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
    /// Live sequences until a version that is not taken off is left.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub horizon: u32,
    /// Sequences of the twins that tell whether a drift worsens a version.
    #[arg(long, value_name = "N", default_value_t = 60)]
    pub pairs: u32,
}

/// Measures and prints.
///
/// # Errors
/// If the options are not allowed, a file cannot be used, or the pipeline fails.
pub fn run(args: &ExperimentArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.which {
        Which::Drift(args) => run_drift(args, out),
        Which::PerCandidate(args) => per_candidate::run(args, out),
        Which::E1(args) => paper::run(args, Part::E1, out),
        Which::E2(args) => paper::run(args, Part::E2, out),
        Which::E3(args) => paper::run(args, Part::E3, out),
        Which::E4(args) => paper::run(args, Part::E4, out),
        Which::E5(args) => paper::run(args, Part::E5, out),
        Which::Sensitivity(args) => paper::run(args, Part::Sensitivity, out),
        Which::MetaFaults(args) => paper::run(args, Part::MetaFaults, out),
        Which::Overhead(args) => paper::run(args, Part::Overhead, out),
        Which::Ablation(args) => paper::run(args, Part::Ablation, out),
        Which::All(args) => paper::run(args, Part::All, out),
        Which::Report(args) => paper::write_again(args, out),
        Which::Truth(args) => truth::run(args, out),
    }
}

fn run_drift(args: &DriftArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let options = DriftOptions {
        runs: args.runs,
        seed: args.seed,
        jobs: args.jobs.map_or_else(cores, usize::from),
        out: args.out.clone(),
        kept: args.cache_key.cells(&args.out.join("cells"))?,
        horizon: args.horizon,
        pairs: args.pairs,
    };
    let tell = |line: &str| {
        // Progress that cannot be shown is no reason to stop measuring.
        let _ = writeln!(std::io::stderr().lock(), "{}", sanitise(line, WIDTH_MAX));
    };
    let report = drift::run(&options, &tell).map_err(|error| match error {
        error @ (ExperimentError::Option { .. } | ExperimentError::File { .. }) => CliError::usage(error),
        error => CliError::internal(error.sentence()),
    })?;
    out.answer(&report, |out| show(&report, &options, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &DriftReport, options: &DriftOptions, out: &mut Output<'_>) -> Result<(), CliError> {
    let mut table = Table::new(&[
        "drift",
        "magnitude",
        "n",
        "worsened",
        "came off",
        "recovered",
        "end to end",
        "lower 95 %",
        "tasks",
        "safe ms",
        "restored ms",
    ]);
    for cell in &report.cells {
        table.row(row(cell));
    }
    out.table(&table)?;
    let left = report.not_activated;
    if left > 0 {
        out.line(&format!("{left} of {} runs had no activated candidate and count nowhere", report.runs))?;
    }
    out.line(&format!("drift.md, drift.csv, drift.json and drift.svg are in {}", options.out.display()))
}

fn row(cell: &DriftCell) -> Vec<String> {
    let count = |share: &Proportion| format!("{}/{}", share.count, share.total);
    let median = |spread: Option<Spread>| {
        spread.map_or_else(|| "-".to_owned(), |spread| format!("{:.0}", spread.median))
    };
    let lower = cell.end_to_end.interval.map_or_else(|| "-".to_owned(), |ends| format!("{:.2}", ends.lower));
    vec![
        cell.kind.to_string(),
        cell.magnitude.to_string(),
        cell.runs.to_string(),
        count(&cell.needed),
        count(&cell.trigger_recall),
        count(&cell.recovery_given_trigger),
        count(&cell.end_to_end),
        lower,
        median(cell.episodes_to_rollback),
        median(cell.time_to_safe_ms),
        median(cell.time_to_restored_ms),
    ]
}
