//! `holdpoint-lab experiment per-candidate`: arguments and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments::per_candidate`]; measures nothing and leaves nothing out
//! (JSON has every digit).

use super::progress;
use std::path::PathBuf;

use clap::Args;

use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::claims::{ClaimVerdict, Summary};
use crate::pipeline_experiments::per_candidate::{self, PerCandidateReport};
use holdpoint::cli::output::{CommandOutput, TextTable};
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::{JOBS_MAX, ProfileArg};
use holdpoint::error::{CliError, Exit};
use holdpoint_governance::metrics::Proportion;

/// The arguments of `experiment per-candidate`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 if no claim is refuted, with 1 if one is.

Examples:
  holdpoint-lab pool generate --seed 7 --out pool-7
  holdpoint-lab experiment per-candidate --pool pool-7
  holdpoint-lab experiment per-candidate --pool pool-7 --profile sim --profile real --profile human --json")]
pub struct PerCandidateArgs {
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
    /// Caches finished candidates here; an interrupted run continues from them.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The key that authenticates them.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the pool or the folder cannot be used, or a candidate does not reach an end.
pub fn run(args: &PerCandidateArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let plan = per_candidate::RunPlan {
        pool: args.pool.clone(),
        profiles: args.profiles.iter().map(|profile| (*profile).into()).collect(),
        seed: args.seed,
        blocks: args.blocks,
        jobs: args.jobs.map_or(cores, usize::from),
        cache: args
            .cache_key
            .open_cache_if_named(args.out.as_deref().map(|out| out.join("kept")).as_deref(), "--out")?,
    };
    let report = per_candidate::run(&plan, &progress::tell).map_err(failed)?;
    if out.is_json() {
        for candidate in &report.candidates {
            out.json(candidate)?;
        }
        out.json(&serde_json::json!({ "summaries": report.summaries, "claims": report.claims }))?;
    } else {
        print_report(&report, out)?;
    }
    let refuted = report.claims.iter().any(|claim| claim.verdict == ClaimVerdict::Refuted);
    Ok(if refuted { Exit::Rejected } else { Exit::Confirmed })
}

fn failed(error: ExperimentError) -> CliError {
    match &error {
        ExperimentError::Pool(_) | ExperimentError::File { .. } => CliError::usage(error),
        _ => CliError::fault(error),
    }
}

fn print_report(report: &PerCandidateReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    for summary in &report.summaries {
        out.line(&format!("profile {}", summary.profile.name()))?;
        let header =
            ["class", "kind", "all", "valid", "sandb", "shadow", "gate", "rolled back", "kept", "episodes"];
        let mut table = TextTable::new(&header);
        for kind in &summary.kinds {
            let mut row = vec![kind.class.name().to_owned(), kind.kind.clone(), kind.all.to_string()];
            row.extend(kind.stopped.iter().map(u64::to_string));
            row.extend([kind.contained, kind.kept, kind.median_episodes].map(|count| count.to_string()));
            table.row(row);
        }
        out.table(&table)?;
        out.line("")?;
        print_rates(summary, out)?;
        out.line("")?;
    }
    let mut table = TextTable::new(&["claim", "verdict", "because"]);
    for claim in &report.claims {
        table.row([claim.claim.as_str(), claim.verdict.name(), claim.because.as_str()]);
    }
    out.table(&table)
}

fn print_rates(summary: &Summary, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = TextTable::new(&["rate", "share", "count", "95 % interval"]);
    let (overt, marginal) = (&summary.overt, &summary.marginal);
    for (name, rate) in [
        ("badr_screen", &overt.badr_screen),
        ("badr_preactivation", &overt.badr_preactivation),
        ("badr_lifecycle", &overt.badr_lifecycle),
        ("false_accept_rate", &overt.false_accept_rate),
        ("false_reject_rate", &overt.false_reject_rate),
        ("benign not kept", &summary.benign_not_kept),
        ("marginal: badr_preactivation", &marginal.badr_preactivation),
        ("marginal: badr_lifecycle", &marginal.badr_lifecycle),
    ] {
        let Proportion { count, total, interval } = rate;
        table.row([
            name.to_owned(),
            rate.rate().map_or_else(|| "-".to_owned(), |share| format!("{share:.3}")),
            format!("{count} of {total}"),
            interval.map_or_else(|| "-".to_owned(), |ends| format!("{:.3} to {:.3}", ends.lower, ends.upper)),
        ]);
    }
    out.table(&table)
}
