//! `holdpoint-lab experiment series`: arguments and the printed report.
//!
//! Prints the results of [`crate::pipeline_experiments::series`]; measures nothing and leaves nothing out (JSON has
//! every digit).

use super::truth::shard;
use super::{CacheArgs, failed, jobs_or_cores, progress, table};
use std::path::PathBuf;

use clap::Args;

use crate::pipeline_experiments::series::{self, SeriesPlan, SeriesReport};
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};
use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

/// The arguments of `experiment series`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The seeds of the decisions are secret: a series that is run again has other episodes.
With --out each finished series is a row of series.jsonl at once.

Examples:
  holdpoint-lab experiment series --out series
  holdpoint-lab experiment series --out series-1 --shard 1/2
  holdpoint-lab experiment series --rows series-1/series.jsonl --rows series-2/series.jsonl
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
    /// One shard of the series, counted from 1; each needs a folder of its own.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "1/1")]
    pub shard: (usize, usize),
    /// Prints the report of the rows in this file, and runs nothing; can be given several times.
    #[arg(long = "rows", value_name = "FILE", conflicts_with = "out")]
    pub rows: Vec<PathBuf>,
    /// Series at once [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The cache of finished series.
    #[command(flatten)]
    pub cache: CacheArgs,
}

/// Runs the experiment, or reads its rows, and prints the report.
///
/// # Errors
/// If a file or the folder cannot be used, the calibration finds no inferior tweak, or a tweak does not reach an end.
pub fn run(args: &SeriesArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let reports = if args.rows.is_empty() {
        vec![series::run(&plan(args)?, &progress::tell).map_err(failed)?]
    } else {
        series::reports_of(&args.rows).map_err(failed)?
    };
    for report in reports {
        out.answer(&report, |out| show(&report, out))?;
    }
    Ok(Exit::Confirmed)
}

fn plan(args: &SeriesArgs) -> Result<SeriesPlan, CliError> {
    Ok(SeriesPlan {
        series: args.series,
        tweaks: args.tweaks,
        shard: args.shard,
        calibration: (args.seed, args.episodes),
        jobs: jobs_or_cores(args.jobs),
        cache: args.cache.open()?,
        rows: args.cache.out.as_ref().map(|out| out.join("series.jsonl")),
    })
}

fn show(report: &SeriesReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::calibration(report))?;
    let mut table = table(answers::SERIES_COLUMNS);
    for end in &report.series {
        table.row([
            end.series.to_string(),
            end.tries.len().to_string(),
            end.tries_until_in().map_or_else(|| "none".to_owned(), |number| format!("try {number}")),
            end.pairs().to_string(),
            format!("{:.0}", end.cpu_secs()),
            answers::tally(&end.stopped_by()),
        ]);
    }
    out.table(&table)?;
    let summary = &report.summary;
    out.line(&answers::stopped_by(&summary.stopped_by))?;
    out.line(&answers::series(summary))?;
    out.line(&answers::build(&report.decided_by))
}
