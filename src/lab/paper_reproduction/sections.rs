//! The report's sections, one an experiment: tables and plots from the raw rows, the paper's number beside each.

mod ablation;
mod findings;
mod meta;
mod positioning;
mod profiles;
mod rollback;
mod screening;
mod sensitivity;
mod shadow;

use std::collections::BTreeSet;

use holdpoint_governance::stats::{Interval, normal_quantile};
use holdpoint_plot::{Curve, Curves};

pub use self::ablation::ablation;
pub use self::findings::findings;
pub use self::meta::meta_faults;
pub use self::positioning::positioning;
pub use self::profiles::profiles;
pub use self::rollback::rollback;
pub use self::screening::screening;
pub use self::sensitivity::sensitivity;
pub use self::shadow::shadow;
use super::figures::{
    ANOMALY, ArmComparison, CONTINUED_MS, ComparedMeasure, DAMAGE, LIVE_FAULTY, LIVE_UNSAFE, MOVED_ON, NEAR,
    RETRIES, RowMeasure, SUCCESS, TIME_S, VIOLATION, benign_refused, by_seed, compare, faulty_activated,
    last_round, mean_std_dev, unsafe_activations,
};
use super::published::PublishedNumbers;
use super::report_table::ReportTable;
use super::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::{
    counted, number, or_dash, p_value, plus_minus, range, report as wording, report_tables as tables,
};

/// A part of the report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    pub title: String,
    /// Paragraphs before the tables.
    pub text: Vec<String>,
    pub tables: Vec<ReportTable>,
    /// Plots: a file's name without ending, and the SVG.
    pub plots: Vec<(String, String)>,
    /// Its lines on the first page.
    pub lines: Vec<String>,
}

impl Section {
    /// Sets the number of seeds of its tables beside that of the preset; a table that has a number keeps it.
    #[must_use]
    pub fn with_seeds(mut self, seeds: usize, preset_seeds: u64) -> Self {
        for table in &mut self.tables {
            table.seeds.get_or_insert((seeds, preset_seeds));
        }
        self
    }
}

/// The number of different seeds among the rows.
#[must_use]
pub fn seeds_in<T>(rows: &[T], seed: fn(&T) -> u64) -> usize {
    rows.iter().map(seed).collect::<BTreeSet<u64>>().len()
}

/// The arms that the paper compares.
const ARMS_OF_THE_PAPER: [Arm; 3] = [Arm::Static, Arm::Naive, Arm::Governed];

/// Whether a claim of direction holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DirectionVerdict {
    Held,
    NotHeld,
    NotShown,
}

impl DirectionVerdict {
    /// Of a test in the wanted direction: held if the test says so after correction and the mean agrees, not held if it
    /// says the opposite.
    fn of_test(test: &ArmComparison, wanted: f64) -> Self {
        match (test.p_holm < 0.05, test.mean * wanted > 0.0) {
            (true, true) => Self::Held,
            (true, false) => Self::NotHeld,
            (false, _) => Self::NotShown,
        }
    }

    /// Of a difference that has to lie above zero.
    const fn above_zero(lower: f64, upper: f64) -> Self {
        match (lower > 0.0, upper < 0.0) {
            (true, _) => Self::Held,
            (false, true) => Self::NotHeld,
            (false, false) => Self::NotShown,
        }
    }

    /// Of a difference that has to lie within a margin on either side of zero.
    const fn within(margin: f64, ends: Interval) -> Self {
        if ends.lower >= -margin && ends.upper <= margin {
            Self::Held
        } else if ends.lower > margin || ends.upper < -margin {
            Self::NotHeld
        } else {
            Self::NotShown
        }
    }
}

/// Mean and standard deviation of values over seeds.
fn mean(values: &[f64]) -> String {
    plus_minus(mean_std_dev(values))
}

/// Success and unsafe versions round by round, beside the paper's figure 4.
fn by_round(rows: &[RoundRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(tables::BY_ROUND);
    let f4 = &printed.f4;
    for round in 0..=last_round(rows) {
        let published = |by_round: &[f64; 6]| number(by_round.get(round as usize).copied(), 1);
        let mut cells = vec![round.to_string()];
        cells.extend(ARMS_OF_THE_PAPER.map(|arm| mean(&by_seed(rows, arm, round, SUCCESS))));
        cells.extend([&f4.success_static, &f4.success_naive, &f4.success_governed].map(published));
        cells.extend([Arm::Naive, Arm::Governed].map(|arm| mean(&by_seed(rows, arm, round, LIVE_UNSAFE))));
        cells.extend([published(&f4.unsafe_naive), published(&[0.0; 6])]);
        table.row(cells);
    }
    table
}

/// The paper's measures of how sequences run, last round.
fn task_measures(rows: &[RoundRow]) -> ReportTable {
    let mut table = ReportTable::new(tables::TASK_MEASURES);
    for arm in arms_of(rows) {
        let measured = |measure: RowMeasure, digits: usize| {
            let [mean, deviation] = mean_std_dev(&by_seed(rows, arm, last_round(rows), measure));
            format!("{mean:.digits$} ± {deviation:.digits$}")
        };
        table.row([
            arm.to_string(),
            measured(TIME_S, 2),
            measured(RETRIES, 2),
            measured(MOVED_ON, 1),
            measured(CONTINUED_MS, 0),
        ]);
    }
    table
}

fn arms_of(rows: &[RoundRow]) -> Vec<Arm> {
    Arm::ALL.into_iter().filter(|arm| rows.iter().any(|row| row.arm == *arm)).collect()
}

/// Whether the rounds have the arms that the paper compares.
#[must_use]
pub fn compares_arms(rows: &[RoundRow]) -> bool {
    ARMS_OF_THE_PAPER.iter().all(|arm| rows.iter().any(|row| row.arm == *arm))
}

/// E2: arms over rounds of upgrades; empty without those that the paper compares.
///
/// # Errors
/// If no interval exists for a count.
pub fn deployment(rows: &[RoundRow], printed: &PublishedNumbers) -> Result<Section, ExperimentError> {
    if !compares_arms(rows) {
        return Ok(Section::default());
    }
    let last = last_round(rows);
    let seeds = by_seed(rows, Arm::Governed, last, SUCCESS).len();
    let mut table = tables::after_last_round(last, seeds);
    for arm in arms_of(rows) {
        let cells = [SUCCESS, VIOLATION, NEAR, ANOMALY, DAMAGE, LIVE_UNSAFE, LIVE_FAULTY]
            .map(|measure| mean(&by_seed(rows, arm, last, measure)));
        table.row(std::iter::once(arm.to_string()).chain(cells));
    }
    let mut activations = ReportTable::new(tables::ACTIVATIONS);
    for arm in arms_of(rows).into_iter().filter(|arm| *arm != Arm::Static) {
        activations.row([
            arm.to_string(),
            counted(&unsafe_activations(rows, arm, None)?),
            counted(&faulty_activated(rows, arm)?),
            counted(&benign_refused(rows, arm)?),
        ]);
    }
    let tests = deployment_tests(rows)?;
    let t7 = &printed.t7;
    let mut beside = ReportTable::new(tables::TABLE_7);
    for (measure, paper, p) in [
        (ComparedMeasure::Success, t7.success, t7.success_p),
        (ComparedMeasure::UnsafeInForce, t7.unsafe_activation, t7.unsafe_activation_p),
        (ComparedMeasure::Violations, t7.violation, t7.violation_p),
    ] {
        let ours = ARMS_OF_THE_PAPER.map(|arm| mean(&by_seed(rows, arm, last, measure.of_rows())));
        let test = tests.iter().find(|test| test.measure == measure);
        let p_ours = or_dash(test.map(|test| p_value(test.p_holm)));
        let published = paper.map(plus_minus).to_vec();
        let cells = [
            vec![wording::compared_measure(measure).to_owned()],
            ours.to_vec(),
            vec![p_ours],
            published,
            vec![p_value(p)],
        ];
        beside.row(cells.concat());
    }
    let mut directions = ReportTable::new(tables::DEPLOYMENT_CLAIMS);
    let unsafe_of = |arm| unsafe_activations(rows, arm, None);
    let mut lines =
        vec![wording::unsafe_activations(seeds, &unsafe_of(Arm::Naive)?, &unsafe_of(Arm::Governed)?)];
    let wanted = [
        (ComparedMeasure::UnsafeInForce, -1.0),
        (ComparedMeasure::Violations, -1.0),
        (ComparedMeasure::Success, 1.0),
    ];
    for (claim, (measure, wanted)) in wording::DEPLOYMENT_CLAIMS.into_iter().zip(wanted) {
        if let Some(test) = tests.iter().find(|test| test.measure == measure) {
            let verdict = wording::verdict(DirectionVerdict::of_test(test, wanted));
            let because = wording::mean_difference(test);
            lines.push(wording::deployment_claim(claim, verdict, &because));
            directions.row([claim, verdict, because.as_str()]);
        }
    }
    Ok(Section {
        title: wording::DEPLOYMENT.to_owned(),
        text: vec![wording::OFFERS.to_owned()],
        tables: vec![
            beside,
            by_round(rows, printed),
            table,
            task_measures(rows),
            activations,
            directions,
            tests_table(&tests, printed),
        ],
        plots: curves(rows)?,
        lines,
    })
}

/// Every test of the rounds: one family.
///
/// # Errors
/// As [`compare`].
pub fn deployment_tests(rows: &[RoundRow]) -> Result<Vec<ArmComparison>, ExperimentError> {
    Ok(compare(rows, [Arm::Governed, Arm::Naive], &ComparedMeasure::ALL)?)
}

fn tests_table(tests: &[ArmComparison], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(tables::ARM_TESTS);
    for comparison in tests {
        let [mean, deviation] = mean_std_dev(&comparison.differences);
        let effect = if deviation > 0.0 { mean / deviation } else { 0.0 };
        let needed = match (normal_quantile(0.975), normal_quantile(0.8)) {
            (Some(alpha), Some(power)) if effect.abs() > 1e-9 => {
                let root = (alpha + power) / effect;
                Some((root * root + 1.0).ceil().max(3.0))
            }
            _ => None,
        };
        let zeros = comparison.differences.iter().filter(|difference| **difference == 0.0).count();
        let test = comparison.test.as_ref();
        let t7 = &printed.t7;
        let paper = match comparison.measure {
            ComparedMeasure::Success => Some(&t7.success_test),
            ComparedMeasure::UnsafeInForce => Some(&t7.unsafe_activation_test),
            ComparedMeasure::Violations => Some(&t7.violation_test),
            ComparedMeasure::Damage => None,
        };
        table.row([
            wording::comparison(comparison),
            format!("{:+.1}", comparison.mean),
            or_dash(comparison.interval.map(range)),
            number(test.map(|test| test.w), 1),
            test.map_or(0, |test| test.n).to_string(),
            zeros.to_string(),
            test.map_or(0, |test| test.ties).to_string(),
            test.map_or_else(|| "1".to_owned(), |test| p_value(test.p_two_sided)),
            p_value(comparison.p_holm),
            format!("{effect:+.2}"),
            number(needed, 0),
            number(paper.map(|[w, ..]| *w), 0),
            or_dash(paper.map(|[_, lower, upper]| format!("[{lower:.1}, {upper:.1}]"))),
        ]);
    }
    table
}

fn curves(rows: &[RoundRow]) -> Result<Vec<(String, String)>, ExperimentError> {
    let last = last_round(rows);
    let arms = [Arm::Static, Arm::Naive, Arm::Governed, Arm::OfflineOnly, Arm::Canary, Arm::SuccessGate];
    // The place of an arm is its style in every plot.
    let shown = arms.into_iter().enumerate().filter(|(_, arm)| rows.iter().any(|row| row.arm == *arm));
    let shown: Vec<(usize, Arm)> = shown.collect();
    let svg = |title: &str, of: &str, curves: Vec<Curve>| {
        let axes = [wording::ROUND_AXIS, of].map(str::to_owned);
        Curves { title: title.to_owned(), axes, range: [0.0, 100.0], curves }.svg()
    };
    let plot_of = |name: &str, title: &str, measure: RowMeasure| {
        let curve = |&(style, arm): &(usize, Arm)| Curve {
            name: arm.to_string(),
            style,
            points: (0..=last)
                .map(|round| mean_std_dev(&by_seed(rows, arm, round, measure)).into())
                .collect(),
        };
        (name.to_owned(), svg(title, "percent", shown.iter().map(curve).collect()))
    };
    let mut cumulative = Vec::new();
    for &(style, arm) in shown.iter().filter(|(_, arm)| *arm != Arm::Static) {
        let mut points = vec![(0.0, 0.0)];
        for round in 1..=last {
            let until: Vec<RoundRow> = rows.iter().filter(|row| row.round <= round).cloned().collect();
            let share = unsafe_activations(&until, arm, None)?.rate().unwrap_or(0.0);
            points.push((100.0 * share, 0.0));
        }
        cumulative.push(Curve { name: arm.to_string(), style, points });
    }
    Ok(vec![
        plot_of("success", wording::SUCCESS_PLOT, SUCCESS),
        plot_of("unsafe-in-force", wording::UNSAFE_IN_FORCE_PLOT, LIVE_UNSAFE),
        (
            "unsafe-activations".to_owned(),
            svg(wording::UNSAFE_ACTIVATIONS_PLOT, wording::ACTIVATIONS_AXIS, cumulative),
        ),
        plot_of("damage", wording::DAMAGE_PLOT, DAMAGE),
        plot_of("violations", wording::VIOLATIONS_PLOT, VIOLATION),
        plot_of("anomalies", wording::ANOMALIES_PLOT, ANOMALY),
    ])
}
