//! `holdpoint-lab bench`: arguments and the printed reports.
//!
//! Prints the results of [`mod@crate::bench`]; measures nothing, and rounds nothing in JSON.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use indicatif::ProgressBar;

use super::table;
use crate::bench::decision::{self, DecisionBudget};
use crate::bench::peers::{self, PeerError, PeerReport, PeerSettings};
use crate::bench::stats::{self, StatedBound};
use crate::wording::{answers, or_dash};
use holdpoint::cli::bench::number;
use holdpoint::cli::output::CommandOutput;
use holdpoint::error::{CliError, Exit};

/// The arguments of `bench`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
`holdpoint bench` times the engine on this machine.

Examples:
  holdpoint-lab bench decision
  holdpoint-lab bench stats --runs 2000
  holdpoint-lab bench peers --python .peers/venv/bin/python --scripts bench/peers")]
pub struct LabBenchArgs {
    /// What is measured.
    #[command(subcommand)]
    pub study: BenchStudy,
}

/// What `bench` measures.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum BenchStudy {
    /// Simulates the error rates of the rules and compares them with those the profiles state.
    ///
    /// Exits with 1 if a stated rate is refuted.
    Stats(StatsArgs),
    /// Counts the episodes of a promotion and of six kinds of rejection, by part, and times them.
    #[command(after_help = "\
Examples:
  holdpoint-lab bench decision
  holdpoint-lab bench decision --json")]
    Decision,
    /// Times the grasp-and-place episode in Holdpoint and in other physics engines, in interleaved rounds.
    Peers(PeersArgs),
}

/// The arguments of `bench stats`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint-lab bench stats
  holdpoint-lab bench stats --runs 2000 --json")]
pub struct StatsArgs {
    /// Runs for each figure.
    #[arg(long, default_value_t = stats::RUNS, value_parser = clap::value_parser!(u32).range(i64::from(stats::RUNS_MIN)..=i64::from(stats::RUNS_MAX)))]
    pub runs: u32,
}

/// The arguments of `bench peers`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The scripts are pybullet_grasp.py and mujoco_grasp.py with their folder models; each prints one JSON line of figures.
Missing scripts and engines are named and left out.

Examples:
  holdpoint-lab bench peers --python .peers/venv/bin/python --scripts bench/peers
  holdpoint-lab bench peers --python .peers/venv/bin/python --scripts bench/peers --native .peers/bin/mujoco_grasp_native")]
pub struct PeersArgs {
    /// The interpreter that has the peers installed.
    #[arg(long, value_name = "PROGRAM")]
    pub python: PathBuf,
    /// The folder with the peers' scripts.
    #[arg(long, value_name = "DIR")]
    pub scripts: PathBuf,
    /// The compiled peer, in C.
    #[arg(long, value_name = "PROGRAM")]
    pub native: Option<PathBuf>,
    /// Rounds; every engine runs once in each.
    #[arg(long, default_value_t = peers::ROUNDS, value_parser = clap::value_parser!(u32).range(1..=i64::from(peers::ROUNDS_MAX)))]
    pub rounds: u32,
    /// Episodes for each round in this cell.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub episodes: u64,
}

/// Measures and prints.
///
/// # Errors
/// If nothing could be measured, or the output cannot be written.
pub fn run(args: &LabBenchArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.study {
        BenchStudy::Peers(args) => {
            let report = compare(args)?;
            out.answer(&report, |out| show_peers(&report, out))?;
            Ok(Exit::Confirmed)
        }
        BenchStudy::Stats(args) => {
            let report = stats::run(args.runs).map_err(CliError::fault)?;
            out.answer(&report, |out| show_study(&report, out))?;
            Ok(exit_of(report.holds()))
        }
        BenchStudy::Decision => {
            let bar = ProgressBar::new_spinner();
            let report = decision::run(|decision| {
                bar.set_message(answers::decision_kind(decision));
                bar.tick();
            });
            bar.finish_and_clear();
            let report = report.map_err(CliError::fault)?;
            out.answer(&report, |out| show_budget(&report, out))?;
            Ok(Exit::Confirmed)
        }
    }
}

/// The exit code of a study: a refuted rate is a failed check.
const fn exit_of(holds: bool) -> Exit {
    if holds { Exit::Confirmed } else { Exit::Rejected }
}

fn show_budget(report: &DecisionBudget, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::budget(report))?;
    for cost in &report.decisions {
        out.line("")?;
        out.line(&answers::decision(cost))?;
        let mut table = table(answers::DECISION_COLUMNS);
        for part in cost.parts.iter().chain([&cost.whole]) {
            table.row([
                part.part.clone(),
                part.episodes.to_string(),
                part.forks.to_string(),
                part.ticks.to_string(),
                number(part.cpu_s),
            ]);
        }
        out.table(&table)?;
    }
    Ok(())
}

fn compare(args: &PeersArgs) -> Result<PeerReport, CliError> {
    // Peers run in the scripts' folder; relative paths refer to the caller's folder.
    let full = |path: &Path| std::path::absolute(path).map_err(CliError::internal);
    // A bare name is searched in PATH.
    let program = |path: &Path| match path.components().count() {
        1 => Ok(path.to_owned()),
        _ => full(path),
    };
    let settings = PeerSettings {
        python: program(&args.python)?,
        scripts: full(&args.scripts)?,
        native: args.native.as_deref().map(full).transpose()?,
        rounds: args.rounds,
        episodes: args.episodes,
    };
    let bar = ProgressBar::new_spinner();
    let rounds = args.rounds;
    let result = peers::run(&settings, &mut |round, engine| {
        bar.set_message(answers::round(round + 1, rounds, engine));
        bar.tick();
    });
    bar.finish_and_clear();
    result.map_err(|error| match error {
        PeerError::Own(_) => CliError::fault(error),
        PeerError::Missing(_) | PeerError::Alone(_) | PeerError::Lost { .. } => CliError::usage(error),
    })
}

fn show_peers(report: &PeerReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::peers(report))?;
    out.line("")?;
    let mut table = table(answers::PEER_COLUMNS);
    let ratio = |ratio: Option<f64>| or_dash(ratio.map(number));
    for row in &report.rows {
        let end = |pick: fn(f64, f64) -> f64| {
            row.rates.iter().copied().reduce(pick).map_or_else(String::new, number)
        };
        table.row([
            answers::peer_engine(&row.engine).to_owned(),
            number(row.median),
            end(f64::min),
            end(f64::max),
            ratio(row.to_pybullet),
            ratio(row.to_mujoco_native),
            format!("{:.1} %", 100.0 * row.lift_rate),
            format!("{:.1} %", 100.0 * row.place_rate),
            row.episodes.to_string(),
        ]);
    }
    out.table(&table)?;
    for (engine, why) in &report.absent {
        out.line(&answers::left_out(engine, why))?;
    }
    Ok(())
}

fn show_study(report: &stats::StudyReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::study(report))?;
    for recorded in &report.tables {
        out.line(&format!("  {recorded}"))?;
    }
    out.line("")?;
    let mut table = table(answers::STUDY_COLUMNS);
    for finding in &report.findings {
        let stated = match finding.stated {
            None => String::new(),
            Some(StatedBound::AtMost(rate)) => format!("<= {rate}"),
            Some(StatedBound::AtLeast(rate)) => format!(">= {rate}"),
        };
        table.row([
            finding.rule.to_owned(),
            answers::study_measure(finding.what).to_owned(),
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
    out.line(&answers::stated(stated, refuted))
}

#[cfg(test)]
mod tests {
    use super::exit_of;
    use holdpoint::error::Exit;

    #[test]
    fn a_refuted_rate_is_a_failed_check() {
        assert_eq!([true, false].map(exit_of), [Exit::Confirmed, Exit::Rejected]);
    }
}
