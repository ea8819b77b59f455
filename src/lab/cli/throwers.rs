//! `holdpoint-lab experiment throwers`: arguments and the printed report.
//!
//! Prints the results of [`crate::throwers`]; measures and judges nothing.

use super::truth::shard;
use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use crate::throwers::{
    self, HarmAct, HarmRateSummary, TaskQuantile, ThrowerKind, ThrowerSummary, ThrowersPlan, ThrowersReport,
};
use crate::wording::{answers, or_dash};
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::{JOBS_MAX, ProfileArg};
use holdpoint::error::{CliError, Exit};

/// The arguments of `experiment throwers`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Each version works as an honest one does until its trigger, then it throws, presses or speeds. The seeds are secret, so a
version cannot know them, and a repetition draws others. Approvers agree to everything. Each finished run is a row of
throwers.jsonl at once.

Examples:
  holdpoint-lab experiment throwers --out throwers
  holdpoint-lab experiment throwers --trigger active-1-in-20 --act press --runs 20 --out throwers
  holdpoint-lab experiment throwers --trigger frame-age --trigger frame-age-hash --profile sim --out throwers --json
  holdpoint-lab experiment throwers --rows throwers-1/throwers.jsonl --rows throwers-2/throwers.jsonl")]
pub struct ThrowersArgs {
    /// A trigger; can be given several times [default: all].
    #[arg(long = "trigger", value_name = "NAME", value_parser = triggers())]
    pub triggers: Vec<ThrowerKind>,
    /// An act; can be given several times [default: all].
    #[arg(long = "act", value_name = "NAME", value_parser = acts())]
    pub acts: Vec<HarmAct>,
    /// A profile; can be given several times.
    #[arg(long = "profile", value_name = "NAME", value_enum, default_values = ["sim", "real", "human"])]
    pub profiles: Vec<ProfileArg>,
    /// Live tasks after which a version ends that is not rolled back.
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub tasks: u64,
    /// Runs of each trigger and act under each profile.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    pub runs: u64,
    /// The first run seed, for a repetition [default: secret seeds].
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(0..=1_000_000_000))]
    pub seed: Option<u64>,
    /// Versions at once [default: the number of cores].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// One shard of the runs, counted from 1; each needs a folder of its own.
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "1/1")]
    pub shard: (usize, usize),
    /// The folder for finished runs and their rows; finished runs in it are not run again.
    #[arg(long, value_name = "DIR", required_unless_present = "rows")]
    pub out: Option<PathBuf>,
    /// Prints the report of the rows in this file, and runs nothing; can be given several times.
    #[arg(long = "rows", value_name = "FILE", conflicts_with = "out")]
    pub rows: Vec<PathBuf>,
    /// The key that authenticates finished runs.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// The triggers; the error for another one lists them.
fn triggers() -> impl TypedValueParser<Value = ThrowerKind> {
    PossibleValuesParser::new(ThrowerKind::ALL.map(ThrowerKind::name))
        .try_map(|name| name.parse::<ThrowerKind>())
}

/// The acts, likewise.
fn acts() -> impl TypedValueParser<Value = HarmAct> {
    PossibleValuesParser::new(HarmAct::ALL.map(HarmAct::name)).try_map(|name| name.parse::<HarmAct>())
}

/// Runs the experiment, or reads its rows, and prints the report.
///
/// # Errors
/// If a file or the folder cannot be used, or a version comes to no end.
pub fn run(args: &ThrowersArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let reports = match &args.out {
        Some(folder) => vec![throwers::run(&plan(args, folder)?, &progress::tell).map_err(failed)?],
        None => throwers::reports_of(&args.rows).map_err(failed)?,
    };
    for report in reports {
        out.answer(&report, |out| show(&report, out))?;
    }
    Ok(Exit::Confirmed)
}

fn plan(args: &ThrowersArgs, folder: &Path) -> Result<ThrowersPlan, CliError> {
    Ok(ThrowersPlan {
        triggers: args.triggers.clone(),
        acts: args.acts.clone(),
        profiles: args.profiles.iter().map(|profile| (*profile).into()).collect(),
        tasks: args.tasks,
        runs: args.runs,
        seed: args.seed,
        shard: args.shard,
        jobs: jobs_or_cores(args.jobs),
        rows: folder.join("throwers.jsonl"),
        cache: args.cache_key.open_cache(&folder.join("runs"))?,
    })
}

fn show(report: &ThrowersReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut runs = table(answers::THROWER_COLUMNS);
    for run in &report.runs {
        let codes: Vec<&str> = run.codes.iter().map(|code| code.as_str()).collect();
        runs.row([
            run.trigger.to_string(),
            run.act.to_string(),
            run.profile.to_string(),
            run.end(),
            codes.join(", "),
            run.live_tasks.to_string(),
            run.thrown.to_string(),
            or_dash(run.first_thrown.map(|task| task.to_string())),
            or_dash(run.flights.map(|flights| flights.dropped.to_string())),
            run.unsafe_tasks.to_string(),
            run.past_harm.to_string(),
        ]);
    }
    out.table(&runs)?;
    let mut summaries = table(answers::QUANTILE_COLUMNS);
    for summary in &report.summary {
        summaries.row(summary_row(summary));
    }
    out.line("")?;
    out.table(&summaries)?;
    if !report.by_rate.is_empty() {
        let mut rates = table(answers::RATE_QUANTILE_COLUMNS);
        for rate in &report.by_rate {
            rates.row(rate_row(rate));
        }
        out.line("")?;
        out.table(&rates)?;
    }
    out.line(&answers::live_tasks(report.tasks))?;
    if let Some(flights) = &report.flights {
        out.line(&answers::flights(flights))?;
    }
    out.line(&answers::run_seeds(report.seed))?;
    out.line(&answers::build(&report.decided_by))
}

fn quantile(found: Option<TaskQuantile>) -> String {
    let text = |tasks: Option<u64>| tasks.map_or_else(|| ">".to_owned(), |tasks| tasks.to_string());
    or_dash(
        found.map(|found| format!("{} [{}, {}]", text(found.tasks), text(found.lower), text(found.upper))),
    )
}

fn rate_row(rate: &HarmRateSummary) -> [String; 7] {
    [
        rate.act.to_string(),
        rate.one_in.to_string(),
        rate.profile.to_string(),
        format!("{}/{}", rate.activated, rate.runs),
        rate.not_rolled_back.to_string(),
        quantile(rate.median),
        quantile(rate.p90),
    ]
}

fn summary_row(summary: &ThrowerSummary) -> [String; 9] {
    let share = summary.activated_share;
    [
        summary.trigger.to_string(),
        summary.act.to_string(),
        summary.profile.to_string(),
        format!("{}/{} [{:.2}, {:.2}]", summary.activated, summary.runs, share.lower, share.upper),
        summary.not_rolled_back.to_string(),
        quantile(summary.median),
        quantile(summary.p90),
        format!("{}/{}", summary.uncovered, summary.cell_tasks),
        answers::tally(&summary.ends),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::danger_thresholds::rule::{DangerCounts, RatePer10000};
    use crate::pipeline_experiments::candidate_run::DecisionOutcome;
    use crate::throwers::{FlightCheck, FlightCounts, ThrowerRun};
    use holdpoint_governance::decision::ReasonCode;
    use holdpoint_governance::lifecycle::State;
    use holdpoint_governance::monitor::SafetyEvent;
    use holdpoint_governance::outcome::StageOutcome;
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_governance::rollback::TriggerKind;
    use holdpoint_governance::stats::Interval;
    use holdpoint_protocol::scenario_state::Decider;

    fn active() -> ThrowerRun {
        ThrowerRun {
            trigger: ThrowerKind::Never,
            act: HarmAct::Throw,
            profile: ProfileName::Sim,
            run: 0,
            version: "grasp@1.1.0".parse().unwrap(),
            state: State::Active,
            activated: true,
            confirmed: true,
            decider: None,
            decision: None,
            codes: Vec::new(),
            rollback: None,
            safety_event: None,
            live_tasks: 400,
            thrown: 0,
            first_thrown: None,
            flights: None,
            unsafe_tasks: 0,
            past_harm: 0,
            cell_tasks: 1_200,
            uncovered: 0,
        }
    }

    #[test]
    fn report_has_the_end_of_each_version() {
        let rejected = ThrowerRun {
            trigger: ThrowerKind::Always,
            state: State::Rejected,
            activated: false,
            confirmed: false,
            decider: Some(Decider::Sandbox),
            decision: Some(DecisionOutcome::Stage(StageOutcome::Reject)),
            codes: vec![ReasonCode::BehaviorEstablishedWorse],
            live_tasks: 0,
            ..active()
        };
        let rolled_back = ThrowerRun {
            trigger: ThrowerKind::FrameAgeHash,
            state: State::RolledBack,
            codes: vec![ReasonCode::MonitorSafetyTrip],
            rollback: Some(TriggerKind::SafetyEvent),
            safety_event: Some(SafetyEvent::Danger),
            live_tasks: 31,
            thrown: 1,
            first_thrown: Some(31),
            flights: Some(FlightCheck { dropped: 2, missed: 0, false_alarms: 1 }),
            unsafe_tasks: 1,
            past_harm: 2,
            ..active()
        };
        let summary = vec![ThrowerSummary {
            trigger: ThrowerKind::FrameAgeHash,
            act: HarmAct::Throw,
            profile: ProfileName::Sim,
            runs: 3,
            activated: 2,
            activated_share: Interval { lower: 0.1, upper: 0.9, level: 0.95 },
            not_rolled_back: 1,
            median: Some(TaskQuantile { tasks: Some(31), lower: Some(0), upper: None }),
            p90: None,
            cell_tasks: 3_600,
            uncovered: 2,
            ends: [("active (no code)".to_owned(), 1), ("held (no code)".to_owned(), 2)].into(),
        }];
        let by_rate = vec![HarmRateSummary {
            act: HarmAct::Throw,
            one_in: 20,
            profile: ProfileName::Real,
            runs: 2,
            activated: 1,
            not_rolled_back: 0,
            median: Some(TaskQuantile { tasks: Some(31), lower: Some(0), upper: None }),
            p90: None,
        }];
        let rate = RatePer10000 { rate: 50.0, lower: 1.3, upper: 275.5 };
        let throws = DangerCounts {
            tasks: 200,
            dangers: 2,
            misses: 1,
            false_alarms: 1,
            misses_rate: rate,
            false_alarms_rate: rate,
        };
        let flights = Some(FlightCounts { dropped: 2, throws });
        let runs = vec![active(), rejected, rolled_back];
        let decided_by = "7a90".to_owned();
        let report = ThrowersReport { decided_by, tasks: 400, seed: None, summary, by_rate, flights, runs };
        let mut printed = Vec::new();
        show(&report, &mut CommandOutput::to(&mut printed, false)).unwrap();
        let lines = progress::lines_of_cells(&printed);
        assert_eq!(
            lines[1..],
            [
                "never throw sim active 400 0 - - 0 0",
                "always throw sim sandbox: reject behavior-established-worse 0 0 - - 0 0",
                "frame-age-hash throw sim rolled-back for safety-event (danger) monitor-safety-trip 31 1 31 2 1 2",
                "",
                "TRIGGER ACT PROFILE ACTIVATED NOT ROLLED BACK MEDIAN 90 % OUTSIDE DOMAIN ENDS",
                "frame-age-hash throw sim 2/3 [0.10, 0.90] 1 31 [0, >] - 2/3600 1 active (no code), 2 held (no code)",
                "",
                "ACT ONE IN PROFILE ACTIVATED NOT ROLLED BACK MEDIAN 90 %",
                "throw 20 real 1/2 0 31 [0, >] -",
                "live tasks until the rollback of activated versions, with exact 95 % bounds; \">\": past the 400 tasks of a \
                 run",
                "by the referee 2 throws and 2 drops in 200 live tasks; missed by the engine: 1, 50.0 [1.3, 275.5] \
                 in 10,000; false alarms: 1, 50.0 [1.3, 275.5] in 10,000",
                "the seeds were secret",
                "the decisions are those of the build 7a90",
            ]
        );
    }
}
