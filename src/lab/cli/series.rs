//! `holdpoint-lab experiment series`: arguments and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments::series`]; measures nothing and leaves nothing out (JSON has
//! every digit).

use super::progress;
use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;

use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::series::{self, SeriesPlan, SeriesReport};
use holdpoint::cli::output::{CommandOutput, TextTable};
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};
use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

/// The arguments of `experiment series`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The seeds of the decisions are secret: a series that is run again has other episodes.

Examples:
  holdpoint-lab experiment series --out series
  holdpoint-lab experiment series --series 4 --tweaks 3 --json")]
pub struct SeriesArgs {
    /// Series, each of one author on one store.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub series: u64,
    /// The most tweaks of a series.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub tweaks: u32,
    /// Episodes that measure the loss of a tweak.
    #[arg(long, value_name = "N", default_value_t = 4_000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub episodes: u64,
    /// The first seed of these episodes: a calibration seed.
    #[arg(long, value_name = "S", default_value_t = CALIBRATION_FROM_RUN, value_parser = clap::value_parser!(u64).range(CALIBRATION_FROM_RUN..=1_000_000))]
    pub seed: u64,
    /// Series at once [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// Caches finished series here; an interrupted run continues from them.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The key that authenticates them.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the folder cannot be used, the calibration finds no inferior tweak, or a tweak does not reach an end.
pub fn run(args: &SeriesArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let plan = SeriesPlan {
        series: args.series,
        tweaks: args.tweaks,
        calibration: (args.seed, args.episodes),
        jobs: args.jobs.map_or(cores, usize::from),
        cache: args
            .cache_key
            .open_cache_if_named(args.out.as_deref().map(|out| out.join("kept")).as_deref(), "--out")?,
    };
    let report = series::run(&plan, &progress::tell).map_err(|error| match error {
        error @ ExperimentError::File { .. } => CliError::usage(error),
        error => CliError::fault(error),
    })?;
    out.answer(&report, |out| show(&report, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &SeriesReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let calibration = &report.calibration;
    out.line(&format!(
        "{} calibration episodes from seed {}: the commissioned version succeeds in {}, a tweak in {}; it loses {:.3} \
         [{:.3}, {:.3}]",
        calibration.episodes,
        calibration.seed,
        calibration.commissioned,
        calibration.tweak,
        calibration.loss.mean,
        calibration.loss.lower,
        calibration.loss.upper
    ))?;
    let mut table = TextTable::new(&["series", "tries", "got in", "pairs", "cpu s", "stopped by"]);
    for end in &report.series {
        table.row([
            end.series.to_string(),
            end.tries.len().to_string(),
            end.tries_until_in().map_or_else(|| "none".to_owned(), |number| format!("try {number}")),
            end.pairs().to_string(),
            format!("{:.0}", end.cpu_secs()),
            counts(&end.stopped_by()),
        ]);
    }
    out.table(&table)?;
    let summary = &report.summary;
    out.line(&format!("stopped by: {}", counts(&summary.stopped_by)))?;
    out.line(&format!(
        "a tweak got in in {} of {} series, at most {:.3} (95 %); {} tries, {} pairs, {:.0} CPU-s",
        summary.got_in, summary.series, summary.at_most, summary.tries, summary.pairs, summary.cpu_secs
    ))
}

fn counts(reasons: &BTreeMap<String, u64>) -> String {
    reasons.iter().map(|(reason, count)| format!("{count} {reason}")).collect::<Vec<_>>().join(", ")
}
