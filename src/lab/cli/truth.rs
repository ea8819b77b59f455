//! `holdpoint-lab experiment truth`: arguments and the printed report.
//!
//! Prints the results of [`crate::ground_truth`]; measures nothing and leaves nothing out (JSON has every digit).

use super::{PoolRunArgs, failed, progress, table};

use clap::Args;

use crate::ground_truth::{self, LOOKS, TruthPlan, TruthReport};
use crate::pipeline_experiments::claims::ClaimVerdict;
use crate::wording::{answers, number};
use holdpoint::cli::output::CommandOutput;
use holdpoint::error::{CliError, Exit};

/// The arguments of `experiment truth`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 if every aim is met, with 1 if one is missed or too few candidates show it.

Examples:
  holdpoint-lab pool generate --preset mutants --sets 100 --seed 11 --out mutants
  holdpoint-lab experiment truth --pool mutants --out truth
  holdpoint-lab experiment truth --pool mutants --out truth --most 600 --shard 1/4")]
pub struct TruthArgs {
    /// The pool and the decisions that are scored.
    #[command(flatten)]
    pub run: PoolRunArgs,
    /// The most pairs of episodes for a candidate: 200, 600 or 2000.
    #[arg(long, value_name = "N", default_value_t = 2_000, value_parser = looks)]
    pub most: u64,
    /// One shard of the candidates, counted from 1.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "1/1")]
    pub shard: (usize, usize),
}

fn looks(text: &str) -> Result<u64, String> {
    let allowed = || LOOKS.map(|look| look.to_string()).join(", ");
    let number = text.parse::<u64>().ok().filter(|number| LOOKS.contains(number));
    number.ok_or_else(|| format!("one of {} is allowed", allowed()))
}

pub(super) fn shard(text: &str) -> Result<(usize, usize), String> {
    let number = |text: &str| text.parse::<usize>().ok();
    match text.split_once('/').and_then(|(part, of)| Some((number(part)?, number(of)?))) {
        Some((part, of)) if (1..=of).contains(&part) && of <= 1_000 => Ok((part - 1, of)),
        _ => Err("I/N is allowed, I from 1 to N, N at most 1000".to_owned()),
    }
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the pool or the folder cannot be used, or a candidate does not reach an end.
pub fn run(args: &TruthArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let plan = TruthPlan { run: args.run.plan()?, most: args.most, shard: args.shard };
    let report = ground_truth::run(&plan, &progress::tell).map_err(failed)?;
    if out.is_json() {
        for candidate in &report.candidates {
            out.json(candidate)?;
        }
        out.json(&serde_json::json!({ "scale": report.scale, "scores": report.scores }))?;
    } else {
        show(&report, out)?;
    }
    let aims = report.scores.iter().flat_map(|score| &score.classes).map(|class| class.aim.verdict);
    Ok(exit_of(aims))
}

/// The exit code by the aims: an aim that too few candidates show is not met, and without an aim nothing is shown.
fn exit_of(aims: impl Iterator<Item = ClaimVerdict>) -> Exit {
    let mut aims = aims.peekable();
    let is_shown = aims.peek().is_some() && aims.all(|verdict| verdict == ClaimVerdict::Shown);
    if is_shown { Exit::Confirmed } else { Exit::Rejected }
}

fn show(report: &TruthReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    for score in &report.scores {
        out.line(&answers::profile(score.profile.name()))?;
        let mut table = table(answers::TRUTH_COLUMNS);
        for class in &score.classes {
            table.row([
                class.class.to_string(),
                class.wrong.total.to_string(),
                class.blocked.to_string(),
                class.contained.to_string(),
                class.wrong.count.to_string(),
                format!("{:.2}", class.aim.at_most),
                number(class.aim.bound, 3),
                class.aim.verdict.name().to_owned(),
                class.median_effort.to_string(),
            ]);
        }
        out.table(&table)?;
        for curve in &score.curves {
            out.line(&answers::curve(curve))?;
        }
        let worse: u64 = score.classes.iter().map(|class| class.lost_worse).sum();
        if worse > 0 {
            out.line(&answers::lost_worse(worse))?;
        }
        if score.open > 0 {
            out.line(&answers::open(score.open))?;
        }
    }
    out.line(answers::WRONG)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_code_is_0_only_if_every_aim_is_shown() {
        use ClaimVerdict::{NotShown, Refuted, Shown};
        for (aims, expected) in [
            (&[Shown, Shown][..], Exit::Confirmed),
            (&[], Exit::Rejected),
            (&[Shown, NotShown], Exit::Rejected),
            (&[Refuted, Shown], Exit::Rejected),
            (&[NotShown, Refuted], Exit::Rejected),
        ] {
            assert_eq!(exit_of(aims.iter().copied()), expected, "{aims:?}");
        }
    }
}
