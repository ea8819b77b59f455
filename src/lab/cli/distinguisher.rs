//! `holdpoint-lab experiment distinguisher`: arguments and the printed report.
//!
//! Prints the number of rows of [`crate::distinguisher`]; trains no classifier.

use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::distinguisher::{self, DistinguisherPlan, DistinguisherReport};
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};

/// The arguments of `experiment distinguisher`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
A row has what one version saw of one task. The origins are the live cell, the sandbox's live-like pairs (live-start), and
its other pairs (sandbox). A script trains classifiers on the rows:

  python3 -m venv env && env/bin/pip install scikit-learn
  env/bin/python tests/reports/distinguish.py rows

Examples:
  holdpoint-lab experiment distinguisher --out rows
  holdpoint-lab experiment distinguisher --sequences 400 --seed 100000 --out rows --json")]
pub struct DistinguisherArgs {
    /// Sequences of the live cell; each origin runs each task as often, as far as it comes to it.
    #[arg(long, value_name = "N", default_value_t = 4_000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub sequences: u64,
    /// Index of the first sequence.
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=1_000_000_000))]
    pub seed: u64,
    /// Blocks of sequences at once [default: the number of cores].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder for `distinguisher.csv`, a row a task, and `distinguisher.json`, their number.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the experiment and prints the number of rows.
///
/// # Errors
/// If the folder cannot be used, or the cell cannot be built.
pub fn run(args: &DistinguisherArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let plan = DistinguisherPlan {
        sequences: args.sequences,
        seed: args.seed,
        jobs: jobs_or_cores(args.jobs),
        out: args.out.clone(),
    };
    let report = distinguisher::run(&plan, &progress::tell).map_err(failed)?;
    out.answer(&report, |out| show(&report, &plan.out, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &DistinguisherReport, folder: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = table(answers::ROW_COLUMNS);
    for count in &report.rows {
        table.row([count.origin.to_string(), count.task.to_string(), count.rows.to_string()]);
    }
    out.table(&table)?;
    out.line(&answers::features(report.features.len()))?;
    out.line(&answers::files_are_in(&["distinguisher.csv", "distinguisher.json"], folder))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distinguisher::{RowCount, TaskOrigin};
    use holdpoint_body::TaskKind;

    #[test]
    fn report_has_the_rows_of_each_origin_and_task() {
        let count = |origin, task, rows| RowCount { origin, task, rows };
        let report = DistinguisherReport {
            computed_by: "7a90".to_owned(),
            sequences: 7,
            seed: 0,
            features: vec!["ticks".to_owned(), "grip_max".to_owned()],
            rows: vec![
                count(TaskOrigin::Live, TaskKind::Place, 5),
                count(TaskOrigin::LiveStart, TaskKind::Place, 7),
            ],
        };
        let mut printed = Vec::new();
        show(&report, Path::new("here"), &mut CommandOutput::to(&mut printed, false)).unwrap();
        let lines = progress::lines_of_cells(&printed);
        assert_eq!(
            lines[1..],
            [
                "live place 5",
                "live-start place 7",
                "2 features of each task",
                "distinguisher.csv, distinguisher.json are in here",
            ]
        );
    }
}
