//! `holdpoint audit rerun`: makes the decisions of a store again, with its evaluations run from their revealed keys.
//!
//! Prints the result of [`holdpoint_explain::store_metrics::rerun`]; an engine may have the store open meanwhile. Writes nothing.

use std::collections::BTreeMap;

use clap::Args;

use super::data;
use super::metrics;
use super::output::TextTable;
use super::progress_bar::DelayedProgressBar;
use super::run::{JOBS_MAX, jobs};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_explain::store_metrics::RulesInForce;
use holdpoint_explain::store_metrics::rerun::{RerunDecision, RerunSettings, StoreRerun, rerun};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_wording::program::replay as sentences;

/// The arguments of `audit rerun`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct RerunArgs {
    /// The largest number of evaluations to run, in the order of registration [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub most: Option<u32>,
    /// Episodes evaluated at once [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
}

/// Runs the evaluations, and prints the comparison.
///
/// # Errors
/// [`CliError`] if the store cannot be read, or a trial cell fails.
pub(super) fn run(
    context: &CliContext,
    args: &RerunArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open(&context.data)?;
    let (cell, environment) = metrics::cell_of(&views)?;
    let bar = DelayedProgressBar::new();
    let tell =
        |version: &CapabilityId, done: u64, total: u64| bar.update(&format!("of {version}"), done, total);
    let settings = RerunSettings {
        cell,
        environment,
        frames: RulesInForce::known(),
        jobs: jobs(args.jobs),
        most: args.most.map_or(u64::MAX, u64::from),
        tell: &tell,
    };
    let found = rerun(&views, settings).map_err(CliError::usage)?;
    drop(bar);
    out.answer(&found, |out| show(&found, out))?;
    Ok(exit_of(&found))
}

fn exit_of(found: &StoreRerun) -> Exit {
    if found.decisions.is_empty() {
        Exit::NothingJudged
    } else if found.has_difference() {
        Exit::Rejected
    } else if found.is_equal() {
        Exit::Confirmed
    } else {
        Exit::Held
    }
}

fn show(found: &StoreRerun, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let StoreRerun { to_record, evaluations, decisions } = found;
    if decisions.is_empty() {
        return out.line(&sentences::no_decisions(*to_record));
    }
    let mut table = TextTable::new(&["record", "version", "runs", "result"]);
    for RerunDecision { record, version, runs, replay } in decisions {
        let result = match replay {
            ReplayOutcome::Equal => "same".to_owned(),
            ReplayOutcome::Differs { .. } => "DIFFERENT".to_owned(),
            ReplayOutcome::NotReplayed { why } => format!("not possible: {why}"),
        };
        table.row([record.to_string(), version.to_string(), runs.to_string(), result]);
    }
    out.table(&table)?;
    for RerunDecision { record, version, replay, .. } in decisions {
        if let ReplayOutcome::Differs { what } = replay {
            out.paragraph("", &format!("record {record}, {version}: {what}"))?;
        }
    }
    let same = decisions.iter().filter(|one| one.replay == ReplayOutcome::Equal).count() as u64;
    let mut causes: BTreeMap<NotReplayable, u64> = BTreeMap::new();
    for decision in decisions {
        if let ReplayOutcome::NotReplayed { why } = decision.replay {
            *causes.entry(why).or_default() += 1;
        }
    }
    let impossible: u64 = causes.values().sum();
    let different = decisions.len() as u64 - same - impossible;
    let causes: Vec<String> = causes.iter().map(|(why, count)| format!("{count} {why}")).collect();
    let totals = sentences::rerun_totals(*to_record, [same, different, impossible], &causes, *evaluations);
    out.paragraph("", &totals)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_code_names_a_difference_before_what_is_missing() {
        let decision = |replay: &ReplayOutcome| RerunDecision {
            record: 5,
            version: "grasp@1.1.0".parse().unwrap(),
            runs: 0,
            replay: replay.clone(),
        };
        let (equal, differs) = (ReplayOutcome::Equal, ReplayOutcome::Differs { what: "it".to_owned() });
        let missing = ReplayOutcome::NotReplayed { why: NotReplayable::KeyNotRevealed };
        for (replays, exit) in [
            (&[][..], Exit::NothingJudged),
            (&[&equal, &equal][..], Exit::Confirmed),
            (&[&equal, &missing][..], Exit::Held),
            (&[&missing, &differs, &equal][..], Exit::Rejected),
        ] {
            let decisions = replays.iter().map(|replay| decision(replay)).collect();
            assert_eq!(exit_of(&StoreRerun { to_record: 9, evaluations: 1, decisions }), exit);
        }
    }
}
