//! `holdpoint bench`: arguments and the printed report.
//!
//! Prints what [`holdpoint_lab::bench`] measured; must not measure or round away anything itself (JSON has every digit).

use clap::{Args, Subcommand};

use super::output::Table;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_lab::bench::stats::{self, Stated};
use holdpoint_lab::bench::{self, BenchReport};
use holdpoint_text::Hint;

/// The arguments of `bench`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint bench
  holdpoint bench --quick --json
  holdpoint bench stats --runs 2000")]
#[command(args_conflicts_with_subcommands = true)]
pub struct BenchArgs {
    /// What to measure instead of times.
    #[command(subcommand)]
    pub what: Option<BenchStudy>,
    /// Fewer repetitions; the numbers are then rougher.
    #[arg(long)]
    pub quick: bool,
}

/// What `bench` can measure beside times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Subcommand)]
pub enum BenchStudy {
    /// Simulates how often the rules err, and holds it against what the profiles say.
    ///
    /// Ends with the code of an internal fault where a stated rate is refuted.
    Stats(StatsArgs),
}

/// The arguments of `bench stats`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint bench stats
  holdpoint bench stats --runs 2000 --json")]
pub struct StatsArgs {
    /// Runs of each figure.
    #[arg(long, default_value_t = stats::RUNS, value_parser = clap::value_parser!(u32).range(i64::from(stats::RUNS_MIN)..=i64::from(stats::RUNS_MAX)))]
    pub runs: u32,
}

/// Measures and prints.
///
/// # Errors
/// If the engine could not be measured, or the output cannot be written.
pub fn run(args: &BenchArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    if let Some(BenchStudy::Stats(args)) = args.what {
        let report = stats::run(args.runs).map_err(|error| CliError::internal(error.sentence()))?;
        out.answer(&report, |out| show_study(&report, out))?;
        return Ok(if report.holds() { Exit::Confirmed } else { Exit::Internal });
    }
    let report = bench::run(args.quick).map_err(|error| CliError::internal(error.sentence()))?;
    out.answer(&report, |out| show(&report, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &BenchReport, out: &mut Output<'_>) -> Result<(), CliError> {
    let BenchReport { version, build, physics, .. } = report;
    out.line(&format!("holdpoint {version}, {build} build, physics {physics}, rules f64, one worker"))?;
    out.line("")?;
    let mut table = Table::new(&["what", "median", "p90", "unit", "n", "clock", "a sample is"]);
    for entry in &report.entries {
        table.row([
            entry.name.clone(),
            number(entry.median),
            number(entry.p90),
            entry.unit.name().to_owned(),
            entry.n.to_string(),
            entry.clock.name().to_owned(),
            entry.sample.to_owned(),
        ]);
    }
    out.table(&table)?;
    out.line("")?;
    let mut table = Table::new(&["peer episode", "lift", "place", "per cpu-s", "median ms", "p90 ms", "n"]);
    for peer in &report.peer {
        table.row([
            format!("{:?}", peer.mode).to_lowercase(),
            format!("{:.1} %", 100.0 * peer.lift_rate),
            format!("{:.1} %", 100.0 * peer.place_rate),
            number(peer.episodes_per_cpu_s),
            number(peer.median),
            number(peer.p90),
            peer.n.to_string(),
        ]);
    }
    out.table(&table)
}

fn show_study(report: &stats::StudyReport, out: &mut Output<'_>) -> Result<(), CliError> {
    out.line(&format!("holdpoint {}, {} runs of each figure, drawn from", report.version, report.runs))?;
    for table in &report.tables {
        out.line(&format!("  {table}"))?;
    }
    out.line("")?;
    let mut table = Table::new(&["rule", "what", "under", "found", "unit", "stated", ""]);
    for finding in &report.findings {
        let stated = match finding.stated {
            None => String::new(),
            Some(Stated::AtMost(rate)) => format!("<= {rate}"),
            Some(Stated::AtLeast(rate)) => format!(">= {rate}"),
        };
        table.row([
            finding.rule.to_owned(),
            finding.what.to_owned(),
            finding.under.clone(),
            if finding.unit == "share" { format!("{:.4}", finding.value) } else { number(finding.value) },
            finding.unit.to_owned(),
            stated,
            if finding.holds { String::new() } else { "refuted".to_owned() },
        ]);
    }
    out.table(&table)?;
    let refuted = report.findings.iter().filter(|finding| !finding.holds).count();
    let stated = report.findings.iter().filter(|finding| finding.stated.is_some()).count();
    out.line(&format!("{stated} stated rates, {refuted} refuted"))
}

/// Three significant digits, or more where the whole part has them.
fn number(value: f64) -> String {
    let decimals = match value.abs() {
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 1.0 => 2,
        _ => 3,
    };
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_keep_three_digits() {
        for (value, text) in [
            (1234.5, "1234"),
            (99.96, "100.0"),
            (12.34, "12.3"),
            (1.234, "1.23"),
            (0.1234, "0.123"),
            (0.0, "0.000"),
        ] {
            assert_eq!(number(value), text);
        }
    }
}
