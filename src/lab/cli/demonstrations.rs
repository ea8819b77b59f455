//! `holdpoint-lab experiment demonstrations`: arguments and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments::demonstrations`]; measures nothing.

use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::pipeline_experiments::demonstrations::{
    self, DemonstrationSummary, DemonstrationsPlan, DemonstrationsReport,
};
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::{JOBS_MAX, ProfileArg};
use holdpoint::error::{CliError, Exit};
use holdpoint_governance::submission::Package;
use holdpoint_trials::embedded;

/// The first run seed: above those of every other experiment.
const FIRST_SEED: u64 = 10_000;

/// The arguments of `experiment demonstrations`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 if every candidate ends in the same state in at least 999 of 1,000 runs, with 1 if not. Approvers agree to
everything.

Examples:
  holdpoint-lab experiment demonstrations --out demonstrations
  holdpoint-lab experiment demonstrations --candidate align-improved --profile human --out people
  holdpoint-lab experiment demonstrations --candidate manifests/candidates/align-robust --out robust")]
pub struct DemonstrationsArgs {
    /// A demonstration candidate, or a candidate's folder; can be given several times [default: the demonstrations].
    #[arg(long = "candidate", value_name = "NAME|DIR")]
    pub candidates: Vec<PathBuf>,
    /// A profile; can be given several times.
    #[arg(long = "profile", value_name = "NAME", value_enum, default_value = "sim")]
    pub profiles: Vec<ProfileArg>,
    /// Runs of each candidate under each profile.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub runs: u64,
    /// The first run seed; the others follow.
    #[arg(long, value_name = "S", default_value_t = FIRST_SEED, value_parser = clap::value_parser!(u64).range(0..=1_000_000_000))]
    pub seed: u64,
    /// Run seeds at once [default: the number of cores].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder for finished runs and `demonstrations.json`; finished runs in it are not run again.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The key that authenticates finished runs.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the folder or a candidate cannot be used, or a candidate does not reach an end.
pub fn run(args: &DemonstrationsArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let plan = DemonstrationsPlan {
        candidates: candidates(&args.candidates)?,
        profiles: args.profiles.iter().map(|profile| (*profile).into()).collect(),
        seed: args.seed,
        runs: args.runs,
        jobs: jobs_or_cores(args.jobs),
        out: args.out.clone(),
        cache: args.cache_key.open_cache(&args.out.join("runs"))?,
    };
    let report = demonstrations::run(&plan, &progress::tell).map_err(failed)?;
    out.answer(&report, |out| show(&report, &plan.out, out))?;
    let all_kept = report.summary.iter().all(DemonstrationSummary::reaches_aim);
    Ok(if all_kept { Exit::Confirmed } else { Exit::Rejected })
}

/// The candidates with their names; all demonstrations if none is named.
fn candidates(named: &[PathBuf]) -> Result<Vec<(String, Package)>, CliError> {
    let demonstrations: Vec<PathBuf> = embedded::names().map(PathBuf::from).collect();
    let chosen = if named.is_empty() { demonstrations.as_slice() } else { named };
    let read = |path: &PathBuf| {
        let capability = embedded::read(path).map_err(CliError::usage)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok((name, Package::clone(&capability.package)))
    };
    chosen.iter().map(read).collect()
}

fn show(report: &DemonstrationsReport, folder: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = table(answers::DEMONSTRATION_COLUMNS);
    for summary in &report.summary {
        table.row([
            summary.name.clone(),
            summary.profile.to_string(),
            summary.outcome.to_string(),
            format!("{}/{}", summary.kept, summary.runs),
            format!("[{:.4}, {:.4}]", summary.share.lower, summary.share.upper),
            answers::tally(&summary.endings),
        ]);
    }
    out.table(&table)?;
    out.line(&answers::is_in("demonstrations.json", folder))
}
