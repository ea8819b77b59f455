//! `holdpoint-lab experiment per-candidate`: arguments and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments::per_candidate`]; measures nothing and leaves nothing out
//! (JSON has every digit).

use super::{PoolRunArgs, failed, progress, table};

use clap::Args;

use crate::pipeline_experiments::claims::{ClaimVerdict, Summary};
use crate::pipeline_experiments::per_candidate::{self, PerCandidateReport};
use crate::wording::{answers, number, or_dash};
use holdpoint::cli::output::CommandOutput;
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
    /// The pool and its run.
    #[command(flatten)]
    pub run: PoolRunArgs,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the pool or the folder cannot be used, or a candidate does not reach an end.
pub fn run(args: &PerCandidateArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let report = per_candidate::run(&args.run.plan()?, &progress::tell).map_err(failed)?;
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

fn print_report(report: &PerCandidateReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    for summary in &report.summaries {
        out.line(&answers::profile(summary.profile.name()))?;
        let mut kinds = table(answers::KIND_COLUMNS);
        for kind in &summary.kinds {
            let mut row = vec![kind.class.name().to_owned(), kind.kind.clone(), kind.all.to_string()];
            row.extend(kind.stopped.iter().map(u64::to_string));
            row.extend([kind.contained, kind.kept, kind.median_episodes].map(|count| count.to_string()));
            kinds.row(row);
        }
        out.table(&kinds)?;
        out.line("")?;
        print_rates(summary, out)?;
        out.line("")?;
    }
    let mut table = table(answers::CLAIM_COLUMNS);
    for claim in &report.claims {
        table.row([claim.claim.as_str(), claim.verdict.name(), claim.because.as_str()]);
    }
    out.table(&table)
}

fn print_rates(summary: &Summary, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = table(answers::RATE_COLUMNS);
    let (overt, marginal) = (&summary.overt, &summary.marginal);
    let rates = [
        &overt.badr_screen,
        &overt.badr_preactivation,
        &overt.badr_lifecycle,
        &overt.false_accept_rate,
        &overt.false_reject_rate,
        &summary.benign_not_kept,
        &marginal.badr_preactivation,
        &marginal.badr_lifecycle,
    ];
    for (name, rate) in answers::RATES.into_iter().zip(rates) {
        let Proportion { count, total, interval } = rate;
        table.row([
            name.to_owned(),
            number(rate.rate(), 3),
            format!("{count} of {total}"),
            or_dash(interval.map(|ends| format!("{:.3} to {:.3}", ends.lower, ends.upper))),
        ]);
    }
    out.table(&table)
}
