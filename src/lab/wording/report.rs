//! The lines, paragraphs and labels of the paper's report.

use std::path::Path;

use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::stats::{Interval, PairedCounts};

use super::{counted, p_value, plus_minus, range_or_none};
use crate::paper_reproduction::figures::{ArmComparison, ComparedMeasure};
use crate::paper_reproduction::published::{PublishedBorderline, PublishedScreening};
use crate::paper_reproduction::sections::DirectionVerdict;
use crate::paper_reproduction::{Arm, Preset};

// --- The page ---

pub const TITLE: &str = "The paper's evaluation, re-run";
pub const LIMITS: &str = "What limits what this shows";

/// The limits of the numbers, in the four categories of the paper's section 10.
pub const VALIDITY: [[&str; 2]; 4] = [
    [
        "Internal",
        "Arms meet the same candidates and the same held-out sequences, and what decides knows neither what was planted nor \
         what the referee says. Thresholds were set on calibration seeds; the seeds here were used for nothing before. \
         Candidates of a seed share the episodes of the version in force, and so its luck.",
    ],
    [
        "Construct",
        "What is unsafe is the referee's word over some hundred pairs of episodes against a published scale; rare harm below \
         its resolution counts as none. A planted fault need do no physical harm, so both counts stand side by side.",
    ],
    [
        "External",
        "One simulated cell, one arm, three skills, parameters and wrappers as upgrades. Levels are not those of another \
         robot; directions may not be either.",
    ],
    [
        "Conclusion",
        "Seeds are the unit of the tests of rounds, candidates that of the pools. Tests are exact, corrected by Holm within \
         their family; \"not shown\" says that the numbers do not decide.",
    ],
];

pub fn written(page: &Path) -> String {
    format!("{} is written", page.display())
}

pub fn written_to(folder: &Path) -> String {
    format!("report.md, report.html and the raw rows are in {}", folder.display())
}

/// The number of seeds of those of the preset, with the lowest and the highest.
pub fn seeds(count: usize, of: u64, ends: Option<(u64, u64)>) -> String {
    let from_to = match ends {
        Some((first, last)) if first != last => format!("{first} to {last}"),
        Some((one, _)) => one.to_string(),
        None => "none".to_owned(),
    };
    format!("{count} of {of} seeds ({from_to})")
}

pub fn rounds(seeds: &str, arms: usize, (rounds, sequences): (u32, u64), rows: usize) -> String {
    format!("rounds of {seeds}, {arms} arms, {rounds} rounds of {sequences} held-out sequences, {rows} rows")
}

pub fn pools(seeds: &str, left_out: usize, rows: usize) -> String {
    format!("pools of {seeds}, of {left_out} with parts left out, {rows} rows")
}

pub fn drifts(runs: u64, seed: u64) -> String {
    format!("{runs} runs of twelve drifts, from seed {seed}")
}

pub fn layers(rows: usize) -> String {
    format!("{rows} rows of failures of the layer")
}

pub fn asked(preset: Preset, parts: &[String]) -> String {
    let parts = parts.join("; ");
    format!("Asked: what the paper's evaluation asks, on our own cell. Preset {preset}: {parts}.")
}

pub fn provenance(version: &str, computed_by: &str, decided_by: &str) -> String {
    format!(
        "Version {version}, computed by {computed_by}, decided by {decided_by}. Everything below is computed from the raw \
         rows beside this page."
    )
}

// --- Claims ---

pub const fn verdict(verdict: DirectionVerdict) -> &'static str {
    match verdict {
        DirectionVerdict::Held => "held",
        DirectionVerdict::NotHeld => "not held",
        DirectionVerdict::NotShown => "not shown",
    }
}

/// A difference of rates with its sign, percent points.
pub fn points(points: f64) -> String {
    format!("{points:+.1} points")
}

pub const fn compared_measure(measure: ComparedMeasure) -> &'static str {
    match measure {
        ComparedMeasure::Success => "success",
        ComparedMeasure::UnsafeInForce => "unsafe version in force",
        ComparedMeasure::Violations => "violations",
        ComparedMeasure::Damage => "damage by the referee",
    }
}

/// A comparison by its measure and arms, in tables and in `tests.csv`.
pub fn comparison(comparison: &ArmComparison) -> String {
    let ArmComparison { measure, arms: [first, second], .. } = comparison;
    format!("{}: {first} - {second}", compared_measure(*measure))
}

pub fn mean_difference(test: &ArmComparison) -> String {
    let ArmComparison { mean, interval, p_holm, .. } = test;
    format!("mean difference {}, 95 % {}, p = {}", points(*mean), range_or_none(*interval), p_value(*p_holm))
}

// --- E1 ---

pub const SCREENING: &str = "E1: screening";
pub const NOT_IN_POOL: &str = "not in the paper's pool";
pub const BENIGN_REJECTED: &str = "0 of 18 rejected";
pub const NO_SUCH_FAULT: &str = "no such fault";

/// The ends of a marginal fault.
pub const MARGINAL_ENDS: [&str; 5] =
    ["stopped by validation", "stopped by the sandbox", "stopped by shadow or gate", "rolled back", "kept"];

pub fn blocked([count, total]: [u32; 2]) -> String {
    format!("{count} of {total} blocked")
}

pub fn from_to([low, high]: [f64; 2]) -> String {
    if low < high { format!("{low:.2} to {high:.2}") } else { format!("{low:.2}") }
}

/// The rates of screening, each with the paper's.
pub fn screening_rates(published: &PublishedScreening) -> [(&'static str, String); 7] {
    let badr = format!("{:.1} %", published.badr);
    let downstream = "\"caught downstream\"".to_owned();
    [
        ("badr_screen, the paper's eight kinds", badr.clone()),
        ("validation and sandbox, the paper's eight", badr),
        ("badr_preactivation, all kinds", downstream.clone()),
        ("badr_lifecycle, all kinds", downstream),
        ("overt faults stopped before activation", "18 of 18".to_owned()),
        ("false_reject_rate", format!("{:.1} %", published.false_reject_rate)),
        ("benign not active in the end", "not told".to_owned()),
    ]
}

/// The dimensions of the marginal faults, each with the paper's result.
pub fn marginal(published: &PublishedBorderline) -> [(&'static str, String); 2] {
    let [before, after] = published.recovery;
    let found = "found by shadow or monitor";
    [
        ("behavior", format!("anomalies {:+.2}, {found}", published.anomaly_rise)),
        ("recovery", format!("rho {before:.2} to {after:.2}, {found}")),
    ]
}

pub fn candidates(count: usize) -> String {
    format!("{count} candidates, each against the first version of its family.")
}

pub fn screening(overt: &Proportion, false_rejects: &Proportion) -> String {
    let (overt, benign) = (counted(overt), counted(false_rejects));
    format!(
        "E1: overt faults stopped before activation {overt}; benign rejected {benign} (paper: 0 at screening, 54 % in its own \
         full pipeline)"
    )
}

// --- E2 ---

pub const DEPLOYMENT: &str = "E2: performance and safety over rounds of upgrades";
pub const OFFERS: &str = "In every round one family yields a candidate, drawn from the pool of the seed; every arm meets the \
                          same ones and works the same held-out sequences.";
pub const ROUND_AXIS: &str = "round of upgrades";
pub const ACTIVATIONS_AXIS: &str = "percent of activations";
pub const SUCCESS_PLOT: &str = "Held-out sequences done (band: 1 SD over seeds)";
pub const UNSAFE_IN_FORCE_PLOT: &str = "Seeds with an unsafe version in force, by the referee";
pub const UNSAFE_ACTIVATIONS_PLOT: &str = "Unsafe activations of all so far, by the referee";
pub const DAMAGE_PLOT: &str = "Held-out sequences with damage, by the referee";
pub const VIOLATIONS_PLOT: &str = "Held-out sequences past a limit";
pub const ANOMALIES_PLOT: &str = "Held-out sequences with an anomaly";

/// Of unsafe versions in force, violations and success.
pub const DEPLOYMENT_CLAIMS: [&str; 3] = [
    "governed has fewer unsafe versions in force than naive",
    "governed violates less than naive",
    "governance costs no success (governed at least naive's)",
];

pub fn unsafe_activations(seeds: usize, naive: &Proportion, governed: &Proportion) -> String {
    let (naive, governed) = (counted(naive), counted(governed));
    format!("E2, {seeds} seeds: unsafe activations naive {naive}, governed {governed}")
}

pub fn deployment_claim(claim: &str, verdict: &str, because: &str) -> String {
    format!("E2: {claim}: {verdict} ({because})")
}

// --- E3 ---

pub const SHADOW: &str = "E3: shadow";

/// A version after its activation without a shadow: it regressed, or it did not.
pub const AFTER_ACTIVATION: [&str; 2] = ["regressed while in control", "showed nothing until confirmed"];

pub fn detections(shadow_only: &Proportion, paper: f64) -> String {
    let share = counted(shadow_only);
    format!("of detections (candidate and category) shadow alone makes {share} (paper: {paper:.0} %)")
}

pub fn true_srdr(rate: &Proportion) -> String {
    format!("true SRDR {}", counted(rate))
}

pub fn shadow_alone(shadow_only: &Proportion, paper: f64) -> String {
    let share = counted(shadow_only);
    format!(
        "Of the faults that either finds, shadow alone finds {share}. The paper counts {paper:.0} %, by a unit of its own \
         (candidate and category; readings X10, X34)."
    )
}

pub fn shadow(shadow_only: &Proportion, detections: &str, discovered: &str) -> String {
    format!("E3: found by shadow and not by the sandbox {}; {detections}; {discovered}", counted(shadow_only))
}

// --- E4 ---

pub const ROLLBACK: &str = "E4: rollback under drift";

pub fn drift_runs(runs: u64) -> String {
    format!("{runs} runs, each with the version that it activated, under four drifts at three magnitudes.")
}

pub fn rollback(overall: &Proportion, paper: [f64; 2]) -> String {
    format!("E4: recovery end to end {} (paper: {} %)", counted(overall), plus_minus(paper))
}

// --- E5 ---

pub const PROFILES: &str = "E5: profiles";

pub fn profiles(monotone: bool, enough: bool, false_rejects: &[Proportion]) -> String {
    let verdict = match (monotone, enough) {
        (true, true) => "held",
        (true, false) => "held as far as seen; fewer than 150 benign candidates do not show it",
        (false, _) => "not held",
    };
    let counts: Vec<String> = false_rejects.iter().map(counted).collect();
    format!(
        "E5: stricter profiles reject no fewer benign candidates: {verdict}. Rejected: {}",
        counts.join("; ")
    )
}

// --- Sensitivity ---

pub const SENSITIVITY: &str = "Sensitivity to the thresholds";
pub const THRESHOLDS: [&str; 3] = ["a tenth lower", "as they are", "a tenth higher"];
pub const THRESHOLDS_B88: [&str; 3] =
    ["kappa_B .88, a tenth lower", "kappa_B .88", "kappa_B .88, a tenth higher"];

pub fn of_rounds(rounds: &Proportion) -> String {
    format!("{} of {} rounds", rounds.count, rounds.total)
}

pub fn changed_rounds(lower: u64, higher: u64) -> String {
    format!(
        "Sensitivity in rounds: other versions are in force in {lower} rounds with thresholds a tenth lower, in {higher} a \
         tenth higher"
    )
}

pub fn changed_candidates(lower: &Proportion, higher: &Proportion) -> String {
    let (lower, higher) = (counted(lower), counted(higher));
    format!("Sensitivity: with thresholds a tenth lower {lower} end otherwise, a tenth higher {higher}")
}

// --- Ablation ---

pub const ABLATION: &str = "Ablation";
pub const RADAR: &str = "Six measures, outer is better (the paper's figure 1)";
pub const RADAR_AXES: [&str; 6] =
    ["detected", "not accepted", "safe activation", "success", "rolled back", "no violation"];
pub const DETECTION_CLAIMS: [&str; 8] = [
    "without shadow fewer faults are detected",
    "without kappa_R fewer faults are detected",
    "without a monitor fewer faults are detected",
    "without rollback fewer faults are rolled back",
    "without the sandbox fewer faults are detected",
    "the sandbox is worth less than the monitor",
    "validation alone detects fewer than the whole way",
    "and more than nothing",
];
pub const ROLLBACK_CLAIMS: [&str; 2] = [
    "without kappa_R fewer activated versions are rolled back",
    "without rollback fewer activated versions are rolled back",
];
pub const ACTIVATION_CLAIMS: [&str; 3] = [
    "without shadow more unsafe versions are activated",
    "validation alone activates more unsafe versions",
    "and fewer than naive",
];
pub const SUCCESS_CLAIMS: [&str; 2] =
    ["without shadow success hardly changes", "without kappa_R success hardly changes"];

/// The number of claims, and of those held, not held and not shown.
pub fn ablation(all: usize, held: usize, not_held: usize, not_shown: usize) -> String {
    format!(
        "Ablation: of {all} of the paper's claims of direction {held} held, {not_held} did not, {not_shown} are not shown"
    )
}

pub fn detected_alone(pairs: PairedCounts, at_least: f64) -> String {
    let PairedCounts { pairs, candidate_only, active_only } = pairs;
    format!(
        "{candidate_only} of {pairs} are detected by the second alone, {active_only} by the first alone; difference at least {}",
        points(at_least)
    )
}

pub fn activated_alone([fewer, more]: [Arm; 2], pairs: PairedCounts, at_least: f64) -> String {
    let PairedCounts { pairs, candidate_only, active_only } = pairs;
    format!(
        "of {pairs} offers {more} alone activates {candidate_only} unsafe ones, {fewer} alone {active_only}; difference at \
         least {}",
        points(at_least)
    )
}

pub fn rolled_back(with: &Proportion, without: &Proportion, difference: Option<[f64; 2]>) -> String {
    let counts = format!("faulty ones rolled back {}, and {}", counted(with), counted(without));
    match difference {
        None => counts,
        Some([lower, upper]) => format!("{counts}; difference [{lower:+.1}, {upper:+.1}] points"),
    }
}

/// The change of success over some seeds; `is_same` without an interval says that it is the same on each.
pub fn success_change(mean: f64, seeds: usize, interval: Option<Interval>, is_same: bool) -> String {
    let interval = match interval {
        Some(ends) => format!("95 % [{:+.1}, {:+.1}]", ends.lower, ends.upper),
        None if is_same => "the same on every seed".to_owned(),
        None => range_or_none(None),
    };
    format!("{} over {seeds} seeds, {interval}", points(mean))
}

// --- Findings ---

pub const FINDINGS: &str = "Findings over all experiments";
pub const BRITTLE: &str = "without governance evolution is brittle: it violates more";
pub const EVOLVES: &str = "governance admits beneficial upgrades and performance grows";
pub const MANY_CHECKS: &str = "no single check is enough: each stops faults that none before it did";
pub const PROVISIONAL: &str =
    "activation is provisional: some faults show only after it, or under one profile";

pub fn findings(held: usize, all: usize) -> String {
    format!("Of the paper's findings over all experiments {held} of {all} are held here")
}

pub fn brittle(mean: f64, p: f64) -> String {
    format!("governed - naive: {} of sequences with a violation, p = {p:.3} (Holm)", points(mean))
}

pub fn evolves(rounds: u32, mean: f64, interval: Option<Interval>, refused: &Proportion) -> String {
    let (points, ends, refused) = (points(mean), range_or_none(interval), counted(refused));
    format!("governed - static after {rounds} rounds: {points} of success {ends}; benign refused {refused}")
}

/// Rates with their names, as a list.
fn named(rates: &[(&str, Proportion)], between: &str) -> String {
    let rates: Vec<String> = rates.iter().map(|(name, rate)| format!("{name} {}", counted(rate))).collect();
    rates.join(between)
}

pub fn stopped_first(by_stage: &[(&str, Proportion)]) -> String {
    format!("stopped first by {}", named(by_stage, ", by "))
}

pub fn rolled_back_after(by_profile: &[(&str, Proportion)]) -> String {
    format!("of the faulty ones rolled back after activation: {}", named(by_profile, ", "))
}

// --- Failures of the layer ---

pub const LAYER_FAILURES: &str = "Failures of the governance layer itself";

/// The class, and how it is injected into the pools.
pub const FAILURES_BEFORE: [[&str; 2]; 3] = [
    ["incomplete compatibility assessment", "interface and policy are never assessed"],
    ["distribution gap", "nothing is seen of the live world's conditions before activation"],
    ["misconfiguration", "thresholds are half of what they should be"],
];

/// The class, and how it is injected while a drift worsens a version.
pub const FAILURES_AFTER: [[&str; 2]; 6] = [
    ["none", "nothing fails"],
    ["monitor blind spot", "the monitor does not see whether tasks are done"],
    ["monitor blind spot", "the monitor sees no rate, and safety events alone"],
    ["monitor blind spot", "no telemetry reaches the monitor"],
    ["rollback unavailable", "the rollback target was blocked under the profile"],
    ["rollback unavailable", "the rollback target was changed in the store"],
];

/// The effect of a failure: significantly more than without one, or not.
pub const fn failure_effect(is_open: bool) -> &'static str {
    if is_open { "fails open" } else { "restricts, as far as seen" }
}

pub fn failures_before(open: u32, all: u32) -> String {
    format!(
        "Failures of the governance layer before an activation: {open} of {all} let more faulty candidates in"
    )
}

pub fn failures_after(open: u32, all: u32, drifts: usize) -> String {
    format!(
        "Failures of the governance layer while a version becomes worse in control: {open} of {all} leave more of them in \
         control as before ({drifts} drifts that worsen one)"
    )
}

// --- Other sections ---

pub const POSITIONING: &str = "Where this stands";
pub const OVERHEAD: &str = "Overhead";
pub const OVERHEAD_CLAIM: &str =
    "The paper claims that the cost is that of evaluation and grows with tasks and batch, not with stages.";

/// A step of the pipeline, and the paper's time.
pub const STAGE_COSTS: [[&str; 2]; 5] = [
    ["registration and validation", "0.06 ms"],
    ["sandbox", "about 3 ms"],
    ["shadow", "about 4 ms"],
    ["gate and activation", "< 0.01 ms"],
    ["provisional window", "about 2 ms a rollback"],
];
pub const COST_UNITS: [&str; 3] =
    ["seconds of a task", "sandbox episodes of a candidate", "candidates, one after another"];

pub fn overhead(secs_each: f64, candidates: usize, evaluation_percent: f64) -> String {
    format!(
        "Overhead: {secs_each:.1} s of processor time a candidate (mean of {candidates}), {evaluation_percent:.2} % of it in \
         evaluation and watching"
    )
}
