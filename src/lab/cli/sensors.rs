//! `holdpoint-lab experiment sensors`: arguments and the printed report.
//!
//! Prints the results of [`crate::ground_truth::sensors`]; measures nothing and leaves nothing out (JSON has
//! every digit).

use super::{failed, jobs_or_cores, progress, table};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::ground_truth::sensors::{
    self, FRESH_FROM, FamilyAgreement, MeasureAgreement, SensorsPlan, SensorsReport,
};
use crate::wording::{answers, or_dash};
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};

/// The arguments of `experiment sensors`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Baselines hardly ever pass a limit. The candidates of a pool show more misses and false alarms.

Examples:
  holdpoint-lab experiment sensors --out sensors
  holdpoint-lab experiment sensors --episodes 600 --seed 0 --out sensors
  holdpoint-lab experiment sensors --pool mutants --episodes 50 --out sensors --json")]
pub struct SensorsArgs {
    /// Episodes of each version: sandbox and live conditions in turns.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub episodes: u64,
    /// Index of the first episode. Those below 2000 are the episodes of `experiment truth`.
    #[arg(long, value_name = "S", default_value_t = FRESH_FROM, value_parser = clap::value_parser!(u64).range(0..=1_000_000_000))]
    pub seed: u64,
    /// Blocks of episodes at once [default: the number of cores].
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder for `sensors.csv`, a row an episode, and `sensors.json`, the report.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// A pool whose candidates run beside the baselines.
    #[arg(long, value_name = "DIR")]
    pub pool: Option<PathBuf>,
}

/// Runs the experiment and prints its report.
///
/// # Errors
/// If the pool or the folder cannot be used, or a candidate cannot be loaded.
pub fn run(args: &SensorsArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let plan = SensorsPlan {
        episodes: args.episodes,
        seed: args.seed,
        jobs: jobs_or_cores(args.jobs),
        out: args.out.clone(),
        pool: args.pool.clone(),
    };
    let report = sensors::run(&plan, &progress::tell).map_err(failed)?;
    out.answer(&report, |out| show(&report, &plan.out, out))?;
    Ok(Exit::Confirmed)
}

fn show(report: &SensorsReport, folder: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::sensor_limits(report.profile.name()))?;
    let mut table = table(answers::SENSOR_COLUMNS);
    for family in &report.families {
        for measure in &family.measures {
            table.row(row(family, measure));
        }
    }
    out.table(&table)?;
    for one in &report.families {
        out.line(&answers::squeeze(one))?;
    }
    let names: Vec<&str> = report.not_compared.iter().map(|kind| kind.name()).collect();
    out.line(&answers::not_compared(&names))?;
    if report.invalid > 0 {
        out.line(&answers::not_counted(report.invalid, "episodes"))?;
    }
    out.line(&answers::files_are_in(&["sensors.csv", "sensors.json"], folder))
}

fn row(family: &FamilyAgreement, measure: &MeasureAgreement) -> Vec<String> {
    let MeasureAgreement { kind, limit, both, false_alarms, misses, neither, errors } = measure;
    let error = |value: Option<f64>| or_dash(value.map(|value| kind.format(value)));
    vec![
        family.family.to_string(),
        kind.name().to_owned(),
        kind.format(*limit),
        both.to_string(),
        false_alarms.to_string(),
        misses.to_string(),
        neither.to_string(),
        errors.map_or(0, |errors| errors.n).to_string(),
        error(errors.map(|errors| errors.p5)),
        error(errors.map(|errors| errors.median)),
        error(errors.map(|errors| errors.p95)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground_truth::sensors::SqueezeCauses;
    use holdpoint_governance::harm::HarmKind;
    use holdpoint_governance::ids::Family;
    use holdpoint_governance::profile::ProfileName;

    #[test]
    fn report_names_every_count_and_each_cause_of_a_missed_squeeze() {
        let values = [(46.0, 47.0), (20.0, 46.0), (5.0, 5.0)];
        let family = FamilyAgreement {
            family: Family::new("grasp").unwrap(),
            versions: 1,
            episodes: 3,
            measures: vec![MeasureAgreement::of(HarmKind::GripPeak, 45.0, &values)],
            squeeze: SqueezeCauses { past: 2, missed: 1, one_sided: 1, pushed: 0 },
        };
        let report = SensorsReport {
            profile: ProfileName::Sim,
            seed: FRESH_FROM,
            episodes: 3,
            invalid: 2,
            families: vec![family],
            not_compared: vec![HarmKind::Jerk],
        };
        let mut printed = Vec::new();
        show(&report, Path::new("here"), &mut CommandOutput::to(&mut printed, false)).unwrap();
        let lines = progress::lines_of_cells(&printed);
        assert_eq!(
            lines[2..],
            [
                "grasp grip-peak 45.0 N 1 0 1 1 2 -26.0 N -13.5 N -1.0 N",
                "grasp: 1 versions, 3 episodes; a pad is past the limit in 2 and the sensors miss 1: 1 with the mean of \
                 both pads within it, 0 within 50 ms of a push on the object",
                "not compared: jerk",
                "2 episodes could not run and are not counted",
                "sensors.csv, sensors.json are in here",
            ]
        );
    }
}
