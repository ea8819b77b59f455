//! `holdpoint-lab experiment`: arguments, progress lines and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments`]; measures and judges nothing.

use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::danger::{self, DangerArgs};
use super::demonstrations::{self, DemonstrationsArgs};
use super::distinguisher::{self, DistinguisherArgs};
use super::paper::{self, PaperArgs, ReportArgs};
use super::per_candidate::{self, PerCandidateArgs};
use super::sensors::{self, SensorsArgs};
use super::series::{self, SeriesArgs};
use super::throwers::{self, ThrowersArgs};
use super::truth::{self, TruthArgs};
use crate::paper_reproduction::run::ExperimentPart;
use crate::pipeline_experiments::drift::{self, DriftCell, DriftOptions, DriftReport, Quantiles};
use crate::wording::{answers, number};
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};
use holdpoint_governance::metrics::Proportion;

/// The arguments of `experiment`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint-lab experiment drift --runs 30 --out results/drift
  holdpoint-lab experiment drift --runs 2 --seed 100 --horizon 40 --pairs 20 --out results/drift --json
  holdpoint-lab experiment per-candidate --pool pool-7
  holdpoint-lab experiment series --out series
  holdpoint-lab experiment truth --pool mutants --out truth
  holdpoint-lab experiment sensors --out sensors
  holdpoint-lab experiment danger --pool pool-7 --out danger
  holdpoint-lab experiment demonstrations --out demonstrations
  holdpoint-lab experiment distinguisher --out rows
  holdpoint-lab experiment throwers --out throwers
  holdpoint-lab experiment all --preset paper-e2 --out paper")]
pub struct ExperimentArgs {
    /// The chosen experiment with its arguments.
    #[command(subcommand)]
    pub which: ExperimentVerb,
}

/// The experiments.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ExperimentVerb {
    /// Rollback under drift: four drifts at three magnitudes begin after an activation.
    Drift(DriftArgs),
    /// Takes every candidate of a pool through the seven stages, then scores it against the truth file.
    PerCandidate(PerCandidateArgs),
    /// Series of inferior versions by one author: in how many does any get in?
    Series(SeriesArgs),
    /// The paper's screening: a pool's candidates through the stages, by class and dimension.
    E1(PaperArgs),
    /// The paper's rounds of upgrades, for each arm that decides about them.
    E2(PaperArgs),
    /// The paper's shadow: what it detects beyond the sandbox, and what it saves.
    E3(PaperArgs),
    /// The paper's rollback under drift, compared with its table 8.
    E4(PaperArgs),
    /// The paper's profiles: the same pool under sim, real and human.
    E5(PaperArgs),
    /// The paper's sensitivity: the thresholds 10 % lower and 10 % higher.
    Sensitivity(PaperArgs),
    /// Injects failures into the governance layer itself and measures what passes then.
    MetaFaults(PaperArgs),
    /// The paper's overhead: the cost of a candidate, stage by stage, over episodes and candidates.
    Overhead(PaperArgs),
    /// The paper's ablation: rounds and pools with parts of the pipeline left out.
    Ablation(PaperArgs),
    /// All of the paper's experiments in sequence.
    All(PaperArgs),
    /// Writes a report again from its raw rows; runs no episode.
    Report(ReportArgs),
    /// Measures the ground truth of candidates with the referee, and compares decisions with it.
    Truth(TruthArgs),
    /// Compares each measure of harm with the referee: misses and false alarms at its limit, by family.
    Sensors(SensorsArgs),
    /// Chooses the thresholds of a danger in live tasks by the referee, and counts their errors on other seeds.
    Danger(DangerArgs),
    /// Runs demonstration candidates over many run seeds: in how many does each one keep its outcome?
    Demonstrations(DemonstrationsArgs),
    /// Records what a version sees of its task in the live cell and in the sandbox, for a classifier.
    Distinguisher(DistinguisherArgs),
    /// Takes versions that throw, press or speed under a trigger through the stages and into live work.
    Throwers(ThrowersArgs),
}

/// The arguments of `experiment drift`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint-lab experiment drift --runs 30 --out results/drift
  holdpoint-lab experiment drift --runs 2 --seed 100 --horizon 40 --pairs 20 --out results/drift")]
pub struct DriftArgs {
    /// Independent runs; each has its own seed and candidate.
    #[arg(long, value_name = "N", default_value_t = 30)]
    pub runs: u64,
    /// Seed of the first run; the others follow.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Runs at once [default: one per core].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder for cells and report; finished cells in it are not run again.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The key that authenticates finished cells.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
    /// Live sequences after which a run ends without a rollback.
    #[arg(long, value_name = "N", default_value_t = 200)]
    pub horizon: u32,
    /// Sequences of the twins that determine whether a drift worsens a version.
    #[arg(long, value_name = "N", default_value_t = 60)]
    pub pairs: u32,
}

/// Measures and prints.
///
/// # Errors
/// If the options are not allowed, a file cannot be used, or the pipeline fails.
pub fn run(args: &ExperimentArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.which {
        ExperimentVerb::Drift(args) => run_drift(args, out),
        ExperimentVerb::PerCandidate(args) => per_candidate::run(args, out),
        ExperimentVerb::Series(args) => series::run(args, out),
        ExperimentVerb::E1(args) => paper::run(args, ExperimentPart::E1, out),
        ExperimentVerb::E2(args) => paper::run(args, ExperimentPart::E2, out),
        ExperimentVerb::E3(args) => paper::run(args, ExperimentPart::E3, out),
        ExperimentVerb::E4(args) => paper::run(args, ExperimentPart::E4, out),
        ExperimentVerb::E5(args) => paper::run(args, ExperimentPart::E5, out),
        ExperimentVerb::Sensitivity(args) => paper::run(args, ExperimentPart::Sensitivity, out),
        ExperimentVerb::MetaFaults(args) => paper::run(args, ExperimentPart::MetaFaults, out),
        ExperimentVerb::Overhead(args) => paper::run(args, ExperimentPart::Overhead, out),
        ExperimentVerb::Ablation(args) => paper::run(args, ExperimentPart::Ablation, out),
        ExperimentVerb::All(args) => paper::run(args, ExperimentPart::All, out),
        ExperimentVerb::Report(args) => paper::regenerate_report(args, out),
        ExperimentVerb::Truth(args) => truth::run(args, out),
        ExperimentVerb::Sensors(args) => sensors::run(args, out),
        ExperimentVerb::Danger(args) => danger::run(args, out),
        ExperimentVerb::Demonstrations(args) => demonstrations::run(args, out),
        ExperimentVerb::Distinguisher(args) => distinguisher::run(args, out),
        ExperimentVerb::Throwers(args) => throwers::run(args, out),
    }
}

fn run_drift(args: &DriftArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let options = DriftOptions {
        runs: args.runs,
        seed: args.seed,
        jobs: jobs_or_cores(args.jobs),
        out: args.out.clone(),
        cache: args.cache_key.open_cache(&args.out.join("cells"))?,
        horizon: args.horizon,
        pairs: args.pairs,
    };
    let report = drift::run(&options, &progress::tell).map_err(failed)?;
    out.answer(&report, |out| show(&report, &options.out, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &DriftReport, folder: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = table(answers::DRIFT_COLUMNS);
    for cell in &report.cells {
        table.row(row(cell));
    }
    out.table(&table)?;
    if report.not_activated > 0 {
        out.line(&answers::not_activated(report.not_activated, report.runs))?;
    }
    out.line(&answers::files_are_in(&["drift.md", "drift.csv", "drift.json", "drift.svg"], folder))
}

fn row(cell: &DriftCell) -> Vec<String> {
    let count = |share: &Proportion| format!("{}/{}", share.count, share.total);
    let median = |found: Option<Quantiles>| number(found.map(|found| found.median), 0);
    let lower = number(cell.end_to_end.interval.map(|ends| ends.lower), 2);
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
