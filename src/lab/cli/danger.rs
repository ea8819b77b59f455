//! `holdpoint-lab experiment danger`: arguments and the printed report.
//!
//! Prints the results of [`crate::danger_thresholds`]; chooses and measures nothing.

use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::danger_thresholds::rule::{
    ChosenThreshold, DangerCounts, NoThreshold, RatePer10000, ThresholdChoice,
};
use crate::danger_thresholds::{self, DANGER_FROM, DangerAgreement, DangerPlan, DangerReport};
use crate::wording::{answers, or_dash, range_to};
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::result_cache::CacheKeyArgs;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};
use holdpoint_governance::harm::HarmKind;

/// The arguments of `experiment danger`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The tasks from --seed on choose each threshold by a fixed rule. The tasks after them count misses and false alarms.
Commissioned versions and versions that throw, press or speed always run. No profile is changed.

Examples:
  holdpoint-lab experiment danger --out danger
  holdpoint-lab experiment danger --pool pool-7 --pool mutants --out danger
  holdpoint-lab experiment danger --episodes 1000 --candidate-episodes 20 --seed 30000 --out danger --json")]
pub struct DangerArgs {
    /// Tasks of each commissioned version that choose, and as many that test: sandbox and live conditions in turns.
    #[arg(long, value_name = "N", default_value_t = 5_000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub episodes: u64,
    /// The same of each other version.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub candidate_episodes: u64,
    /// Index of the first task. Those below 2000 are the episodes of `experiment truth`.
    #[arg(long, value_name = "S", default_value_t = DANGER_FROM, value_parser = clap::value_parser!(u64).range(0..=1_000_000_000))]
    pub seed: u64,
    /// Blocks of tasks at once [default: the number of cores].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder for finished tasks and `danger.json`; finished tasks in it are not run again.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// A pool whose candidates run as well; can be given several times.
    #[arg(long = "pool", value_name = "DIR")]
    pub pools: Vec<PathBuf>,
    /// The key that authenticates finished tasks.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If a pool or the folder cannot be used, or a candidate cannot be loaded.
pub fn run(args: &DangerArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let plan = DangerPlan {
        episodes: args.episodes,
        candidate_episodes: args.candidate_episodes,
        seed: args.seed,
        jobs: jobs_or_cores(args.jobs),
        out: args.out.clone(),
        pools: args.pools.clone(),
        cache: args.cache_key.open_cache(&args.out.join("tasks"))?,
    };
    let report = danger_thresholds::run(&plan, &progress::tell).map_err(failed)?;
    out.answer(&report, |out| show(&report, &plan.out, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &DangerReport, folder: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::danger_rule(report))?;
    let mut choices = table(answers::CHOICE_COLUMNS);
    for choice in &report.choices {
        choices.row(choice_row(choice));
    }
    out.table(&choices)?;
    out.line(&answers::danger_halves(report))?;
    let mut agreements = table(answers::AGREEMENT_COLUMNS);
    for agreement in &report.agreements {
        agreements.row(agreement_row(agreement));
    }
    out.table(&agreements)?;
    if report.invalid > 0 {
        out.line(&answers::not_counted(report.invalid, "tasks"))?;
    }
    out.line(&answers::is_in("danger.json", folder))
}

fn choice_row(choice: &ThresholdChoice) -> Vec<String> {
    let ThresholdChoice { measure, profile, limit: _, tasks, of_commissioned, dangers, chosen, cause } =
        choice;
    let cause = cause.map_or("-", NoThreshold::name);
    let count =
        |of: fn(&ChosenThreshold) -> u64| or_dash(chosen.as_ref().map(|chosen| of(chosen).to_string()));
    vec![
        measure.name().to_owned(),
        measure.format(*profile),
        chosen.map_or_else(|| cause.to_owned(), |chosen| measure.format(chosen.threshold)),
        tasks.to_string(),
        of_commissioned.to_string(),
        dangers.to_string(),
        count(|chosen| chosen.misses),
        count(|chosen| chosen.false_alarms),
        count(|chosen| chosen.of_commissioned),
    ]
}

fn agreement_row(agreement: &DangerAgreement) -> Vec<String> {
    let DangerAgreement { thresholds, measure, group, versions, counts } = agreement;
    let DangerCounts { tasks, dangers, misses, false_alarms, misses_rate, false_alarms_rate } = counts;
    let rate = |found: &RatePer10000| range_to(1, found.rate, found.lower, found.upper);
    vec![
        thresholds.name().to_owned(),
        measure.map_or("any", HarmKind::name).to_owned(),
        group.name().to_owned(),
        versions.to_string(),
        tasks.to_string(),
        dangers.to_string(),
        misses.to_string(),
        rate(misses_rate),
        false_alarms.to_string(),
        rate(false_alarms_rate),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::danger_thresholds::{DangerGroup, ThresholdSource};
    use holdpoint_governance::profile::ProfileName;

    #[test]
    fn report_has_each_choice_and_each_rate_with_its_bounds() {
        let landing = ThresholdChoice {
            measure: HarmKind::LandingSpeed,
            profile: 1.7,
            limit: 0.3,
            tasks: 400,
            of_commissioned: 300,
            dangers: 60,
            chosen: Some(ChosenThreshold { threshold: 1.5, misses: 2, false_alarms: 3, of_commissioned: 1 }),
            cause: None,
        };
        let zone = ThresholdChoice {
            measure: HarmKind::ZoneClearance,
            profile: 0.02,
            limit: 0.05,
            dangers: 0,
            chosen: None,
            cause: Some(NoThreshold::FewDangers),
            ..landing
        };
        let rate = RatePer10000 { rate: 50.0, lower: 1.3, upper: 275.5 };
        let counts = DangerCounts {
            tasks: 200,
            dangers: 2,
            misses: 1,
            false_alarms: 1,
            misses_rate: rate,
            false_alarms_rate: rate,
        };
        let agreement = DangerAgreement {
            thresholds: ThresholdSource::Profile,
            measure: None,
            group: DangerGroup::Thrower,
            versions: 6,
            counts,
        };
        let report = DangerReport {
            computed_by: "7a90".to_owned(),
            profile: ProfileName::Sim,
            chosen_from: 10_000,
            tested_from: 10_100,
            episodes: 100,
            candidate_episodes: 10,
            invalid: 2,
            choices: vec![landing, zone],
            agreements: vec![agreement],
        };
        let mut printed = Vec::new();
        show(&report, Path::new("here"), &mut CommandOutput::to(&mut printed, false)).unwrap();
        let lines = progress::lines_of_cells(&printed);
        assert_eq!(
            lines[1..],
            [
                "MEASURE PROFILE CHOSEN TASKS COMMISSIONED DANGERS MISSES FALSE ALARMS OF COMMISSIONED",
                "landing-speed 1.700 m/s 1.500 m/s 400 300 60 2 3 1",
                "zone-clearance 0.020 m few-dangers 400 300 0 - - -",
                "the tasks from 10000 on chose; the tasks from 10100 on count, in 10,000 tasks with exact 95 % bounds:",
                "THRESHOLDS MEASURE GROUP VERSIONS TASKS DANGERS MISSED IN 10,000 FALSE ALARMS IN 10,000",
                "profile any thrower 6 200 2 1 50.0 [1.3, 275.5] 1 50.0 [1.3, 275.5]",
                "2 tasks could not run and are not counted",
                "danger.json is in here",
            ]
        );
    }
}
