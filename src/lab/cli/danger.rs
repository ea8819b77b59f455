//! `holdpoint-lab experiment danger`: arguments and the printed report.
//!
//! Prints the results of [`crate::danger_thresholds`]; chooses and measures nothing.

use super::progress;
use std::path::PathBuf;

use clap::Args;

use crate::danger_thresholds::rule::{
    BOUND_ALPHA, ChosenThreshold, DANGERS_MIN, DangerCounts, FALSE_ALARMS_MAX, NoThreshold, RatePer10000,
    ThresholdChoice,
};
use crate::danger_thresholds::{self, DANGER_FROM, DangerAgreement, DangerPlan, DangerReport};
use crate::pipeline_experiments::ExperimentError;
use holdpoint::cli::output::{CommandOutput, TextTable};
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
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let plan = DangerPlan {
        episodes: args.episodes,
        candidate_episodes: args.candidate_episodes,
        seed: args.seed,
        jobs: args.jobs.map_or(cores, usize::from),
        out: args.out.clone(),
        pools: args.pools.clone(),
        cache: args.cache_key.open_cache(&args.out.join("tasks"))?,
    };
    let report = danger_thresholds::run(&plan, &progress::tell).map_err(|error| match error {
        error @ (ExperimentError::Pool(_) | ExperimentError::File { .. }) => CliError::usage(error),
        error => CliError::fault(error),
    })?;
    out.answer(&report, |out| show(&report, &plan, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &DangerReport, plan: &DangerPlan, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&format!(
        "thresholds of profile {}; the rule: of the thresholds that leave at most {FALSE_ALARMS_MAX} false alarms in \
         10,000 tasks of commissioned versions open (exact, one-sided {BOUND_ALPHA}), the one with the fewest misses, \
         then the fewest false alarms; from {DANGERS_MIN} dangers on",
        report.profile
    ))?;
    let mut table = TextTable::new(&[
        "measure",
        "profile",
        "chosen",
        "tasks",
        "commissioned",
        "dangers",
        "misses",
        "false alarms",
        "of commissioned",
    ]);
    for choice in &report.choices {
        table.row(choice_row(choice));
    }
    out.table(&table)?;
    out.line(&format!(
        "the tasks from {} on chose; the tasks from {} on count, in 10,000 tasks with exact 95 % bounds:",
        report.chosen_from, report.tested_from
    ))?;
    let mut table = TextTable::new(&[
        "thresholds",
        "measure",
        "group",
        "versions",
        "tasks",
        "dangers",
        "missed",
        "in 10,000",
        "false alarms",
        "in 10,000",
    ]);
    for agreement in &report.agreements {
        table.row(agreement_row(agreement));
    }
    out.table(&table)?;
    if report.invalid > 0 {
        out.line(&format!("{} tasks could not run and are not counted", report.invalid))?;
    }
    out.line(&format!("danger.json is in {}", plan.out.display()))
}

fn choice_row(choice: &ThresholdChoice) -> Vec<String> {
    let ThresholdChoice { measure, profile, limit: _, tasks, of_commissioned, dangers, chosen, cause } =
        choice;
    let cause = cause.map_or("-", NoThreshold::name);
    let count = |of: fn(&ChosenThreshold) -> u64| {
        chosen.as_ref().map_or_else(|| "-".to_owned(), |chosen| of(chosen).to_string())
    };
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
    let rate =
        |RatePer10000 { rate, lower, upper }: &RatePer10000| format!("{rate:.1} [{lower:.1}, {upper:.1}]");
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
    use holdpoint_store::{CacheSecret, ResultCache};

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
            profile: ProfileName::Sim,
            chosen_from: 10_000,
            tested_from: 10_100,
            episodes: 100,
            candidate_episodes: 10,
            invalid: 2,
            choices: vec![landing, zone],
            agreements: vec![agreement],
        };
        let plan = DangerPlan {
            episodes: 100,
            candidate_episodes: 10,
            seed: 10_000,
            jobs: 1,
            out: PathBuf::from("here"),
            pools: Vec::new(),
            cache: ResultCache::in_folder(PathBuf::from("unused"), CacheSecret::fresh().unwrap()),
        };
        let mut printed = Vec::new();
        show(&report, &plan, &mut CommandOutput::to(&mut printed, false)).unwrap();
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
