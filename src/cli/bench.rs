//! `holdpoint bench`: arguments and the printed report.
//!
//! Prints the results of [`mod@crate::bench`]; measures nothing, and rounds nothing in JSON.

use clap::Args;

use super::output::{CommandOutput, TextTable};
use crate::bench::{self, BenchReport};
use crate::error::{CliError, Exit};
use holdpoint_wording::program::run::bench_heading;

/// The arguments of `bench`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint bench
  holdpoint bench --quick --json")]
pub struct BenchArgs {
    /// Fewer repetitions, so less precise numbers.
    #[arg(long)]
    pub quick: bool,
}

/// Measures and prints.
///
/// # Errors
/// If the engine could not be measured, or the output cannot be written.
pub fn run(args: &BenchArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let report = bench::run(args.quick).map_err(CliError::fault)?;
    out.answer(&report, |out| show(&report, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &BenchReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let BenchReport { version, build, robot, .. } = report;
    out.line(&bench_heading(version, build, robot))?;
    out.line("")?;
    let mut table = TextTable::new(&["what", "median", "p90", "unit", "n", "clock", "a sample is"]);
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
    out.table(&table)
}

/// Three significant digits, or the whole part if it has more; below 1, three decimals.
#[must_use]
pub fn number(value: f64) -> String {
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
    fn numbers_are_printed_with_three_digits() {
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
