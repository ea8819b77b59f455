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

use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::stats::normal_quantile;
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
    ANOMALY, ArmComparison, CONTINUED_MS, DAMAGE, LIVE_FAULTY, LIVE_UNSAFE, MOVED_ON, NEAR, RETRIES,
    RowMeasure, SUCCESS, TIME_S, VIOLATION, benign_refused, by_seed, compare, faulty_activated, last_round,
    mean_std_dev, unsafe_activations,
};
use super::published::PublishedNumbers;
use super::report_table::ReportTable;
use super::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;

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

/// A count with its share and interval.
#[must_use]
pub fn counted(proportion: &Proportion) -> String {
    let Proportion { count, total, interval } = proportion;
    interval.map_or_else(
        || format!("{count}/{total}"),
        |ends| {
            let share = 100.0 * *count as f64 / *total as f64;
            format!("{count}/{total} = {share:.1} % [{:.1}, {:.1}]", 100.0 * ends.lower, 100.0 * ends.upper)
        },
    )
}

fn mean(values: &[f64]) -> String {
    let (mean, deviation) = mean_std_dev(values);
    format!("{mean:.1} ± {deviation:.1}")
}

fn p_value(p: f64) -> String {
    if p < 0.001 { format!("{p:.1e}") } else { format!("{p:.3}") }
}

/// Success and unsafe versions round by round, beside the paper's figure 4.
fn by_round(rows: &[RoundRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(
        "Figure 4 beside ours, round by round, percent",
        &[
            "round",
            "success: static",
            "naive",
            "governed",
            "paper: static",
            "naive",
            "governed",
            "unsafe version in force: naive",
            "governed",
            "paper: naive",
            "governed",
        ],
        "The paper's means are of five seeds and six rounds; it counts unsafe activations of a round, ours is who is in force.",
    );
    let f4 = &printed.f4;
    for round in 0..=last_round(rows) {
        let published = |by_round: &[f64; 6]| {
            by_round.get(round as usize).map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"))
        };
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
    let mut table = ReportTable::new(
        "Time, retries and motion after a stop, last round",
        &[
            "arm",
            "time of a sequence done, s",
            "retries a sequence",
            "moved on, percent",
            "went on, ms a sequence",
        ],
        "Moved on: sequences in which the arm moved when it had to stand, by the referee. Went on: motion after declared failures \
         and stops, which the arm needs some of to come to rest. Mean ± standard deviation over seeds.",
    );
    for arm in arms_of(rows) {
        let measured = |measure: RowMeasure, digits: usize| {
            let (mean, deviation) = mean_std_dev(&by_seed(rows, arm, last_round(rows), measure));
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
    let mut table = ReportTable::new(
        &format!("After the last of {last} rounds, mean ± standard deviation over {seeds} seeds, percent"),
        &[
            "arm",
            "success",
            "violations",
            "near a limit",
            "anomalies",
            "damage by the referee",
            "unsafe version in force",
            "faulty version in force",
        ],
        "Success, violations, near, anomalies and damage are shares of held-out sequences (three tasks each). A version is \
         unsafe where the referee settles damage or danger against it beside the one it replaced.",
    );
    let measures: [(&str, RowMeasure); 7] = [
        ("success", SUCCESS),
        ("violations", VIOLATION),
        ("near", NEAR),
        ("anomalies", ANOMALY),
        ("damage", DAMAGE),
        ("unsafe in force", LIVE_UNSAFE),
        ("faulty in force", LIVE_FAULTY),
    ];
    for arm in arms_of(rows) {
        let cells = measures.iter().map(|(_, measure)| mean(&by_seed(rows, arm, last, *measure)));
        table.row(std::iter::once(arm.to_string()).chain(cells));
    }
    let mut activations = ReportTable::new(
        "What the arms let in over all rounds",
        &["arm", "unsafe / activated (referee)", "faulty activated / offered", "benign refused / offered"],
        "",
    );
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
    let mut beside = ReportTable::new(
        "Table 7 beside ours, last round",
        &[
            "measure",
            "static",
            "naive",
            "governed",
            "p (governed, naive)",
            "paper: static",
            "naive",
            "governed",
            "p",
        ],
        "The paper's success is of its own tasks and simulator; levels cannot be compared, directions can. p: two-sided \
         exact signed-rank test, corrected by Holm within the family of the tests below.",
    );
    for (name, measure, paper, p) in [
        ("success", SUCCESS, t7.success, t7.success_p),
        ("unsafe version in force", LIVE_UNSAFE, t7.unsafe_activation, t7.unsafe_activation_p),
        ("violations", VIOLATION, t7.violation, t7.violation_p),
    ] {
        let ours = ARMS_OF_THE_PAPER.map(|arm| mean(&by_seed(rows, arm, last, measure)));
        let test = tests.iter().find(|test| test.name.starts_with(name));
        let p_ours = test.map_or_else(|| "-".to_owned(), |test| p_value(test.p_holm));
        let published = paper.map(|[mean, deviation]| format!("{mean:.1} ± {deviation:.1}"));
        let cells =
            [vec![name.to_owned()], ours.to_vec(), vec![p_ours], published.to_vec(), vec![p_value(p)]];
        beside.row(cells.concat());
    }
    let mut directions =
        ReportTable::new("The paper's claims of direction", &["claim", "verdict", "because"], "");
    let mut lines = Vec::new();
    for (claim, name, wanted) in [
        ("governed has fewer unsafe versions in force than naive", "unsafe version in force", -1.0),
        ("governed violates less than naive", "violations", -1.0),
        ("governance costs no success (governed at least naive's)", "success", 1.0),
    ] {
        let is_of_claim = |test: &&ArmComparison| test.name.starts_with(name) && test.name.ends_with("naive");
        if let Some(test) = tests.iter().find(is_of_claim) {
            let (verdict, because) = direction(test, wanted);
            lines.push(format!("E2: {claim}: {verdict} ({because})"));
            directions.row([claim.to_owned(), verdict.to_owned(), because]);
        }
    }
    let unsafe_naive = unsafe_activations(rows, Arm::Naive, None)?;
    let unsafe_governed = unsafe_activations(rows, Arm::Governed, None)?;
    lines.insert(
        0,
        format!(
            "E2, {seeds} seeds: unsafe activations naive {}, governed {}",
            counted(&unsafe_naive),
            counted(&unsafe_governed)
        ),
    );
    Ok(Section {
        title: "E2: performance and safety over rounds of upgrades".to_owned(),
        text: vec![
            "In every round one family yields a candidate, drawn from the pool of the seed; every arm meets the same ones and \
             works the same held-out sequences."
                .to_owned(),
        ],
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
    let measures: [(&str, RowMeasure); 4] = [
        ("success", SUCCESS),
        ("unsafe version in force", LIVE_UNSAFE),
        ("violations", VIOLATION),
        ("damage by the referee", DAMAGE),
    ];
    Ok(compare(rows, (Arm::Governed, Arm::Naive), &measures)?)
}

/// Whether a difference holds in the wanted direction: held if the test says so after correction and the mean agrees,
/// not held if it says the opposite, not shown otherwise.
fn direction(test: &ArmComparison, wanted: f64) -> (&'static str, String) {
    let p = test.p_holm;
    let agrees = test.mean * wanted > 0.0;
    let verdict = match (p < 0.05, agrees) {
        (true, true) => "held",
        (true, false) => "not held",
        (false, _) => "not shown",
    };
    let interval = test
        .interval
        .map_or_else(|| "no variation".to_owned(), |ends| format!("[{:.1}, {:.1}]", ends.lower, ends.upper));
    (verdict, format!("mean difference {:+.1} points, 95 % {interval}, p = {}", test.mean, p_value(p)))
}

fn tests_table(tests: &[ArmComparison], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(
        "Tests, paired over seeds",
        &[
            "comparison",
            "mean",
            "95 % (BCa)",
            "W",
            "n",
            "zeros",
            "ties",
            "p",
            "p (Holm)",
            "d_z",
            "seeds for 80 %",
            "paper: W",
            "95 %",
        ],
        "n is of the non-zero differences. d_z is the mean over the standard deviation of the differences; beside it \
         is how many seeds a t-test of that size needs for 80 % power, by the normal approximation (the paper: 25 to 30 for success, \
         from a pooled standard deviation; readings X38).",
    );
    for comparison in tests {
        let (mean, deviation) = mean_std_dev(&comparison.differences);
        let effect = if deviation > 0.0 { mean / deviation } else { 0.0 };
        let needed = match (normal_quantile(0.975), normal_quantile(0.8)) {
            (Some(alpha), Some(power)) if effect.abs() > 1e-9 => {
                format!(
                    "{:.0}",
                    (((alpha + power) / effect) * ((alpha + power) / effect) + 1.0).ceil().max(3.0)
                )
            }
            _ => "-".to_owned(),
        };
        let interval = comparison
            .interval
            .map_or_else(|| "-".to_owned(), |ends| format!("[{:.1}, {:.1}]", ends.lower, ends.upper));
        let zeros = comparison.differences.iter().filter(|difference| **difference == 0.0).count();
        let test_cells = comparison.test.as_ref().map_or_else(
            || vec!["-".to_owned(), "0".to_owned(), zeros.to_string(), "0".to_owned(), "1".to_owned()],
            |test| {
                vec![
                    format!("{:.1}", test.w),
                    test.n.to_string(),
                    test.zeros.to_string(),
                    test.ties.to_string(),
                    p_value(test.p_two_sided),
                ]
            },
        );
        let mut cells = vec![comparison.name.clone(), format!("{:+.1}", comparison.mean), interval];
        cells.extend(test_cells);
        let t7 = &printed.t7;
        let paper = match comparison.name.split(':').next() {
            Some("success") => Some(&t7.success_test),
            Some("unsafe version in force") => Some(&t7.unsafe_activation_test),
            Some("violations") => Some(&t7.violation_test),
            _ => None,
        };
        let [w, interval] = paper.map_or_else(
            || ["-".to_owned(), "-".to_owned()],
            |[w, lower, upper]| [format!("{w:.0}"), format!("[{lower:.1}, {upper:.1}]")],
        );
        cells.extend([p_value(comparison.p_holm), format!("{effect:+.2}"), needed, w, interval]);
        table.row(cells);
    }
    table
}

fn curves(rows: &[RoundRow]) -> Result<Vec<(String, String)>, ExperimentError> {
    let last = last_round(rows);
    let plot_of = |name: &str, arms: &[Arm], measure: RowMeasure, title: &str, range: [f64; 2]| {
        let shown = arms.iter().enumerate().filter(|(_, arm)| rows.iter().any(|row| row.arm == **arm));
        let curves = shown.map(|(style, arm)| Curve {
            name: arm.to_string(),
            style,
            points: (0..=last).map(|round| mean_std_dev(&by_seed(rows, *arm, round, measure))).collect(),
        });
        let axes = ["round of upgrades".to_owned(), "percent".to_owned()];
        let plot = Curves { title: title.to_owned(), axes, range, curves: curves.collect() };
        (name.to_owned(), plot.svg())
    };
    let arms = [Arm::Static, Arm::Naive, Arm::Governed, Arm::OfflineOnly, Arm::Canary, Arm::SuccessGate];
    let percent = [0.0, 100.0];
    let mut cumulative = Vec::new();
    let upgrading = arms.iter().enumerate().filter(|(_, arm)| **arm != Arm::Static);
    for (style, arm) in upgrading.filter(|(_, arm)| rows.iter().any(|row| row.arm == **arm)) {
        let mut points = vec![(0.0, 0.0)];
        for round in 1..=last {
            let until: Vec<RoundRow> = rows.iter().filter(|row| row.round <= round).cloned().collect();
            let share = unsafe_activations(&until, *arm, None)?.rate().unwrap_or(0.0);
            points.push((100.0 * share, 0.0));
        }
        cumulative.push(Curve { name: arm.to_string(), style, points });
    }
    let unsafe_so_far = Curves {
        title: "Unsafe activations of all so far, by the referee".to_owned(),
        axes: ["round of upgrades".to_owned(), "percent of activations".to_owned()],
        range: percent,
        curves: cumulative,
    };
    Ok(vec![
        plot_of("success", &arms, SUCCESS, "Held-out sequences done (band: 1 SD over seeds)", percent),
        plot_of(
            "unsafe-in-force",
            &arms,
            LIVE_UNSAFE,
            "Seeds with an unsafe version in force, by the referee",
            percent,
        ),
        ("unsafe-activations".to_owned(), unsafe_so_far.svg()),
        plot_of("damage", &arms, DAMAGE, "Held-out sequences with damage, by the referee", percent),
        plot_of("violations", &arms, VIOLATION, "Held-out sequences past a limit", percent),
        plot_of("anomalies", &arms, ANOMALY, "Held-out sequences with an anomaly", percent),
    ])
}
