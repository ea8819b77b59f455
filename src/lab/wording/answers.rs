//! The lines and columns that the program's verbs print; `|` separates columns.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use super::range_to;
use crate::bench::decision::{DecisionBudget, DecisionCost, DecisionKind};
use crate::bench::peers::{CellMode, PeerEngine, PeerReport};
use crate::bench::stats::{StudyMeasure, StudyReport};
use crate::candidate_pool::{PoolIndex, Preset};
use crate::danger_thresholds::DangerReport;
use crate::danger_thresholds::rule::{BOUND_ALPHA, DANGERS_MIN, FALSE_ALARMS_MAX, RatePer10000};
use crate::ground_truth::Roc;
use crate::ground_truth::sensors::FamilyAgreement;
use crate::paper_reproduction::Preset as PaperPreset;
use crate::parameter_search::RefineReport;
use crate::parameter_search::search::SearchProgress;
use crate::pipeline_experiments::series::{SeriesReport, SeriesSummary};
use crate::throwers::FlightCounts;

pub fn is_in(file: &str, folder: &Path) -> String {
    format!("{file} is in {}", folder.display())
}

pub fn files_are_in(files: &[&str], folder: &Path) -> String {
    format!("{} are in {}", files.join(", "), folder.display())
}

/// Items that the simulator could not run.
pub fn not_counted(count: u64, what: &str) -> String {
    format!("{count} {what} could not run and are not counted")
}

/// Counts by name, as a list.
pub fn tally(counts: &BTreeMap<String, u64>) -> String {
    counts.iter().map(|(name, count)| format!("{count} {name}")).collect::<Vec<_>>().join(", ")
}

/// The build of some rows, by its digest.
pub fn build(decided_by: &str) -> String {
    format!("the decisions are those of the build {decided_by}")
}

pub fn profile(name: &str) -> String {
    format!("profile {name}")
}

// --- bench ---

pub const DECISION_COLUMNS: &str = "part | episodes | forks | ticks | cpu-s";
pub const PEER_COLUMNS: &str =
    "engine | per cpu-s | lowest | highest | to PyBullet | to MuJoCo C | lift | place | n a round";
pub const STUDY_COLUMNS: &str = "rule | what | under | found | unit | stated | ";

pub fn budget(report: &DecisionBudget) -> String {
    format!("holdpoint {}, {} build, one worker, no recording", report.version, report.build)
}

pub fn decision(cost: &DecisionCost) -> String {
    format!("{}: {}, at the end {}", decision_kind(cost.decision), cost.candidate, cost.end)
}

pub const fn decision_kind(kind: DecisionKind) -> &'static str {
    match kind {
        DecisionKind::Promotion => "promotion",
        DecisionKind::Interface => "rejected, interface",
        DecisionKind::Policy => "rejected, policy",
        DecisionKind::Behavior => "rejected, behavior",
        DecisionKind::Recovery => "rejected, recovery",
        DecisionKind::LiveLike => "rejected, in live-like pairs",
        DecisionKind::Refined => "rejected, refined for success alone",
    }
}

/// This cell's number format: the arm's own dynamics, and the physics engine's ticks.
pub const PHYSICS_NUMBERS: &str = "f64, in the engine f32";

pub const fn peer_engine(engine: &PeerEngine) -> &'static str {
    match engine {
        PeerEngine::Holdpoint(CellMode::Full) => "Holdpoint, full",
        PeerEngine::Holdpoint(CellMode::Adaptive) => "Holdpoint, adaptive",
        PeerEngine::Holdpoint(CellMode::Reduced) => "Holdpoint, reduced",
        PeerEngine::PyBullet => "PyBullet",
        PeerEngine::MujocoPython => "MuJoCo, Python loop",
        PeerEngine::MujocoNative => "MuJoCo, native C",
        PeerEngine::MujocoNativeFast => "MuJoCo, native C, fast model",
    }
}

pub fn round(round: u32, rounds: u32, engine: &PeerEngine) -> String {
    format!("round {round} of {rounds}: {}", peer_engine(engine))
}

pub fn peers(report: &PeerReport) -> String {
    let PeerReport { rounds, physics, .. } = report;
    format!(
        "grasp and place, 960 ticks; {rounds} interleaved rounds, medians; this cell {physics}, peers f64"
    )
}

pub fn left_out(engine: &PeerEngine, why: &str) -> String {
    format!("left out: {}: {why}", peer_engine(engine))
}

pub fn study(report: &StudyReport) -> String {
    format!("holdpoint {}, {} runs of each figure, sampled from", report.version, report.runs)
}

pub const fn study_measure(measure: StudyMeasure) -> &'static str {
    match measure {
        StudyMeasure::DiffersFromFullRun => "differs from the full run",
        StudyMeasure::RunsUsed => "runs used",
        StudyMeasure::DiffersFromFullBudget => "differs from the full budget",
        StudyMeasure::RejectsEarly => "rejects early what the full budget does not",
        StudyMeasure::PairsUsed => "pairs used",
        StudyMeasure::EqualCompatible => "equally good: compatible",
        StudyMeasure::AnomaliesIncompatible => "+.13 anomalies: incompatible",
        StudyMeasure::TradeCompatible => "success up, safety established as worse: compatible",
        StudyMeasure::EqualRejectedForHarm => "equally good: rejected for harm",
        StudyMeasure::WorseFound => "worse: not compatible",
        StudyMeasure::EqualFailsShadow => "equally good: fails",
        StudyMeasure::WorseFailsShadow => "worse: fails",
        StudyMeasure::UnchangedRestricted => "unchanged: restricted within the window",
        StudyMeasure::UnchangedRolledBack => "unchanged: rolled back within the window",
        StudyMeasure::DelayToRestriction => "worse: median delay to restriction",
        StudyMeasure::WorseRestricted => "worse: restricted within the window",
        StudyMeasure::DelayToRollback => "worse: median delay to rollback",
        StudyMeasure::WorseRolledBack => "worse: rolled back within the window",
    }
}

pub fn stated(stated: usize, refuted: usize) -> String {
    format!("{stated} stated rates, {refuted} refuted")
}

// --- pool ---

pub const POOL_COLUMNS: &str = "name | family | version";

/// The content of a preset.
pub const fn preset(preset: Preset) -> &'static str {
    match preset {
        Preset::Full10 => {
            "Six benign, two with obvious faults in each dimension, two with borderline faults: 16 a family"
        }
        Preset::Paper8 => "The paper's eight faulty ones alone: I I P P B B M1 M2",
        Preset::AppendixC => "The sixteen, and the other kinds of the paper's appendix C: 23 a family",
        Preset::Equal => {
            "The baseline under another number, and with a parameter changed by 1 in 1,000: 2 a family"
        }
        Preset::Mutants => "One mutant for each family and set",
        Preset::Components => {
            "The controllers as components, with each fault that code can have and without a fault: 15 a family"
        }
    }
}

/// A generated pool, in the shown folder, and its truth file.
pub fn generated(index: &PoolIndex, folder: &str, truth: &str) -> [String; 3] {
    [
        format!("{} candidates in {folder}", index.candidates.len()),
        format!("hidden ground truth in {truth}"),
        format!("truth     sha256 {}", index.truth_digest),
    ]
}

pub fn pool(index: &PoolIndex) -> String {
    let PoolIndex { seed, sets, generator, truth_digest, .. } = index;
    format!("seed {seed}, {sets} sets, made by holdpoint {generator}; truth sha256 {truth_digest}")
}

// --- refine ---

pub const REFINE_COLUMNS: &str = "parameter | before | after";

pub fn refined(report: &RefineReport) -> [String; 4] {
    let RefineReport { parent, evaluations, generations, seed, max_speed_m_s, max_force_n, .. } = report;
    let scores = [("trained episodes", &report.practised), ("fresh episodes", &report.fresh)];
    let [trained, fresh] =
        scores.map(|(what, score)| format!("{what:<19} {} before, {} after", score.before, score.after));
    [
        is_in(&report.id.to_string(), &report.folder),
        format!(
            "from {parent} in {evaluations} evaluations, {generations} generations, seed {seed}; declares {max_speed_m_s} m/s \
             and {max_force_n} N"
        ),
        trained,
        fresh,
    ]
}

pub fn after_search(report: &RefineReport) -> [String; 2] {
    [
        format!("the cached evaluations are in {}", report.kept.display()),
        format!(
            "the search used only success and time; next: holdpoint candidate check {}",
            report.folder.display()
        ),
    ]
}

/// The progress of a search.
pub fn search(progress: &SearchProgress, elapsed: Duration) -> String {
    let SearchProgress {
        generation,
        generations,
        best,
        episodes_done,
        episodes_simulated,
        episodes_total,
        ..
    } = progress;
    let left = episodes_total.saturating_sub(*episodes_done);
    // Cached episodes cost nothing, so only simulated ones predict the remaining time.
    let expected = (*episodes_simulated > 0)
        .then(|| elapsed.as_secs_f64() * left as f64 / *episodes_simulated as f64)
        .map_or_else(String::new, |secs| format!(", at most {secs:.0} s left"));
    format!(
        "generation {generation} of {generations}: best {best}, {episodes_done} of {episodes_total} episodes, {:.0} s{expected}",
        elapsed.as_secs_f64()
    )
}

// --- experiment drift ---

pub const DRIFT_COLUMNS: &str = "drift | magnitude | n | worsened | rolled back | recovered | end to end | lower 95 % | tasks | \
                                 safe ms | restored ms";

pub fn not_activated(left: u64, runs: u64) -> String {
    format!("{left} of {runs} runs had no activated candidate and are excluded")
}

// --- experiment per-candidate ---

pub const KIND_COLUMNS: &str =
    "class | kind | all | valid | sandb | shadow | gate | rolled back | kept | episodes";
pub const RATE_COLUMNS: &str = "rate | share | count | 95 % interval";
pub const CLAIM_COLUMNS: &str = "claim | verdict | because";

/// The rates of a summary, in its order.
pub const RATES: [&str; 8] = [
    "badr_screen",
    "badr_preactivation",
    "badr_lifecycle",
    "false_accept_rate",
    "false_reject_rate",
    "benign not kept",
    "marginal: badr_preactivation",
    "marginal: badr_lifecycle",
];

// --- experiment series ---

pub const SERIES_COLUMNS: &str = "series | tries | got in | pairs | cpu s | stopped by";

pub fn calibration(report: &SeriesReport) -> String {
    let calibration = &report.calibration;
    let loss = &calibration.loss;
    format!(
        "{} calibration episodes from seed {}: the commissioned version succeeds in {}, a tweak in {}; it loses {}",
        calibration.episodes,
        calibration.seed,
        calibration.commissioned,
        calibration.tweak,
        range_to(3, loss.mean, loss.lower, loss.upper)
    )
}

pub fn stopped_by(reasons: &BTreeMap<String, u64>) -> String {
    format!("stopped by: {}", tally(reasons))
}

pub fn series(summary: &SeriesSummary) -> String {
    let SeriesSummary { series, got_in, at_most, tries, pairs, cpu_secs, .. } = summary;
    format!(
        "a tweak got in in {got_in} of {series} series, at most {at_most:.3} (95 %); {tries} tries, {pairs} pairs, \
         {cpu_secs:.0} CPU-s"
    )
}

// --- experiment truth ---

pub const TRUTH_COLUMNS: &str =
    "harm by truth | all | blocked | rolled back | wrong | at most | bound | aim | episodes";
pub const WRONG: &str = "wrong: harmful and active at the end, or harmless and lost";

pub fn curve(curve: &Roc) -> String {
    let ([low, high], [hits, false_alarms]) = (curve.interval, curve.decided);
    format!(
        "area under the curve by {}: {}; the decisions: {hits:.3} of the harmful, {false_alarms:.3} of the harmless stopped",
        curve.by,
        range_to(3, curve.area, low, high)
    )
}

pub fn lost_worse(count: u64) -> String {
    format!("{count} of the lost harmless ones are nevertheless significantly worse")
}

pub fn open(count: u64) -> String {
    format!("{count} candidates may be worse than they are counted here")
}

// --- experiment sensors ---

pub const SENSOR_COLUMNS: &str =
    "family | measure | limit | both | false alarms | misses | neither | near | error 5 % | median | 95 %";

pub fn sensor_limits(profile: &str) -> String {
    format!("limits of profile {profile}; errors are sensor minus referee")
}

pub fn squeeze(one: &FamilyAgreement) -> String {
    let (family, squeeze) = (&one.family, &one.squeeze);
    format!(
        "{family}: {} versions, {} episodes; a pad is past the limit in {} and the sensors miss {}: {} with the mean of both \
         pads within it, {} within 50 ms of a push on the object",
        one.versions, one.episodes, squeeze.past, squeeze.missed, squeeze.one_sided, squeeze.pushed
    )
}

pub fn not_compared(measures: &[&str]) -> String {
    format!("not compared: {}", measures.join(", "))
}

// --- experiment danger ---

pub const CHOICE_COLUMNS: &str =
    "measure | profile | chosen | tasks | commissioned | dangers | misses | false alarms | of commissioned";
pub const AGREEMENT_COLUMNS: &str = "thresholds | measure | group | versions | tasks | dangers | missed | in 10,000 | false \
                                     alarms | in 10,000";

pub fn danger_rule(report: &DangerReport) -> String {
    format!(
        "thresholds of profile {}; the rule: of the thresholds that leave at most {FALSE_ALARMS_MAX} false alarms in 10,000 \
         tasks of commissioned versions open (exact, one-sided {BOUND_ALPHA}), the one with the fewest misses, then the \
         fewest false alarms; from {DANGERS_MIN} dangers on",
        report.profile
    )
}

pub fn danger_halves(report: &DangerReport) -> String {
    let DangerReport { chosen_from, tested_from, .. } = report;
    format!(
        "the tasks from {chosen_from} on chose; the tasks from {tested_from} on count, in 10,000 tasks with exact 95 % bounds:"
    )
}

// --- the paper's experiments ---

/// The runs of a preset.
pub const fn paper_preset(preset: PaperPreset) -> &'static str {
    match preset {
        PaperPreset::Smoke => {
            "One seed of calibration and one round: a quick check without statistical weight"
        }
        PaperPreset::PaperFig4 => "Five seeds, as in the paper's figure 4",
        PaperPreset::PaperE2 => "Fifteen seeds, as in the paper's table 7",
        PaperPreset::Protocol => "Five seeds and eight rounds, as in the paper's section 7.8",
        PaperPreset::Claims => "Forty seeds",
    }
}

pub fn shard_is_run(part: usize, of: usize) -> String {
    format!("part {part} of {of} is run; a run without --shard writes the report")
}

// --- experiment distinguisher ---

pub const ROW_COLUMNS: &str = "origin | task | rows";

pub fn features(count: usize) -> String {
    format!("{count} features of each task")
}

// --- experiment demonstrations ---

pub const DEMONSTRATION_COLUMNS: &str = "candidate | profile | outcome | kept | exact 95 % | endings";

// --- experiment throwers ---

pub const THROWER_COLUMNS: &str =
    "trigger | act | profile | end | because | tasks | thrown | first | dropped | unsafe | past harm";
pub const QUANTILE_COLUMNS: &str =
    "trigger | act | profile | activated | not rolled back | median | 90 % | outside domain | ends";
pub const RATE_QUANTILE_COLUMNS: &str =
    "act | one in | profile | activated | not rolled back | median | 90 %";

pub fn live_tasks(tasks: u64) -> String {
    format!(
        "live tasks until the rollback of activated versions, with exact 95 % bounds; \">\": past the {tasks} tasks of a run"
    )
}

pub fn flights(found: &FlightCounts) -> String {
    let FlightCounts { dropped, throws } = found;
    let rate = |found: RatePer10000| range_to(1, found.rate, found.lower, found.upper);
    format!(
        "by the referee {} throws and {dropped} drops in {} live tasks; missed by the engine: {}, {} in 10,000; false \
         alarms: {}, {} in 10,000",
        throws.dangers,
        throws.tasks,
        throws.misses,
        rate(throws.misses_rate),
        throws.false_alarms,
        rate(throws.false_alarms_rate)
    )
}

pub fn run_seeds(first: Option<u64>) -> String {
    first.map_or_else(|| "the seeds were secret".to_owned(), |seed| format!("the run seeds begin at {seed}"))
}
