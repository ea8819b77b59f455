//! The danger experiment: thresholds of a danger in live tasks, chosen and tested by the referee's class *danger*.
//!
//! Runs single tasks of commissioned versions, candidates of pools and versions that throw, press or speed. The first
//! half of the seeds chooses each threshold by a fixed rule ([`rule`]), the second half counts misses and false alarms: of
//! the thresholds, and of every measure at the limit of an episode. Changes no profile; no decision sees any of it.

pub mod rule;

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;

use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::{HarmSettings, Profile, ProfileName};
use holdpoint_record::context::Context;
use holdpoint_runtime::capability::Capability;
use holdpoint_sim::SimCells;
use holdpoint_store::ResultCache;
use holdpoint_text::Hint;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use self::rule::{DangerCounts, MeasuredTask, ThresholdChoice, is_danger};
use crate::candidate_pool::{Class, Pool};
use crate::ground_truth::sensors::{self, SensedVersion, SensorRow};
use crate::ground_truth::{
    HarmClass, HarmScale, HarmThreshold, RefereeObservation, has_counterpart, judging_context,
};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, cached_result, write_atomically};
use crate::side_by_side::side_by_side;
use crate::throwers;
use crate::wording::progress;

/// The first task of the experiment by default: far above those of the experiments `truth` and `sensors`.
pub const DANGER_FROM: u64 = 10_000;

/// Tasks of a version that one worker runs at a time.
const BLOCK: u64 = 50;

/// The versions and tasks of a run.
#[derive(Clone, Debug)]
pub struct DangerPlan {
    /// Tasks of each commissioned version in each half.
    pub episodes: u64,
    /// Tasks of each other version in each half.
    pub candidate_episodes: u64,
    /// Index of the first task.
    pub seed: u64,
    pub jobs: usize,
    /// Where the report goes.
    pub out: PathBuf,
    /// Pools whose candidates run beside the commissioned versions.
    pub pools: Vec<PathBuf>,
    /// Where finished tasks are cached.
    pub cache: ResultCache,
}

holdpoint_governance::closed_set! {
    /// What a version is, by its construction.
    DangerGroup, "group", {
        Commissioned = "commissioned",
        Benign = "benign",
        Marginal = "marginal",
        Faulty = "faulty",
        /// Damaged blindly.
        Blind = "blind",
        /// Throws, presses or speeds in each task, or in one of forty.
        Thrower = "thrower",
    }
}

impl From<Class> for DangerGroup {
    fn from(class: Class) -> Self {
        match class {
            Class::Benign => Self::Benign,
            Class::Marginal => Self::Marginal,
            Class::Faulty => Self::Faulty,
            Class::Blind => Self::Blind,
        }
    }
}

holdpoint_governance::closed_set! {
    /// Where thresholds come from.
    ThresholdSource, "source", {
        /// The profile.
        Profile = "profile",
        /// The rule; the profile for a measure for which the rule chooses none.
        Chosen = "chosen",
        /// The limit of an episode. The referee counts the true value of the same measure past the same limit.
        Limit = "limit",
    }
}

/// Misses and false alarms in the second half.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DangerAgreement {
    pub thresholds: ThresholdSource,
    /// The measure; absent for all thresholds together against the whole class *danger*, and for all limits together.
    pub measure: Option<HarmKind>,
    pub group: DangerGroup,
    pub versions: u64,
    pub counts: DangerCounts,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DangerReport {
    /// Digest of everything that computes an episode.
    pub computed_by: String,
    /// Whose thresholds and limits count.
    pub profile: ProfileName,
    /// Index of the first task that chose, and of the first one that tests.
    pub chosen_from: u64,
    pub tested_from: u64,
    pub episodes: u64,
    pub candidate_episodes: u64,
    /// Tasks that a version did not accept or the simulator could not run; counted nowhere.
    pub invalid: u64,
    pub choices: Vec<ThresholdChoice>,
    pub agreements: Vec<DangerAgreement>,
}

/// The half of the seeds that a task belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SeedHalf {
    Chooses,
    Tests,
}

impl DangerPlan {
    /// Index of the first task of a half. The halves share none.
    fn first(&self, half: SeedHalf) -> u64 {
        match half {
            SeedHalf::Chooses => self.seed,
            SeedHalf::Tests => self.seed + self.episodes.max(self.candidate_episodes),
        }
    }

    /// The tasks of a version of a group, in blocks.
    fn ranges(&self, group: DangerGroup, half: SeedHalf) -> impl Iterator<Item = Range<u64>> {
        let tasks = if group == DangerGroup::Commissioned { self.episodes } else { self.candidate_episodes };
        let from = self.first(half);
        let blocks = (0..tasks.div_ceil(BLOCK)).map(|block| block * BLOCK);
        blocks.map(move |begin| from + begin..from + (begin + BLOCK).min(tasks))
    }
}

/// A version, and what it is.
struct GroupedVersion {
    group: DangerGroup,
    sensed: SensedVersion,
}

/// Tasks that one worker runs.
struct TaskBlock<'a> {
    version: &'a GroupedVersion,
    /// The place of the version in the list of all.
    place: usize,
    half: SeedHalf,
    indices: Range<u64>,
}

/// One finished task.
struct SeenTask {
    group: DangerGroup,
    version: usize,
    half: SeedHalf,
    sensor: HarmMeasures,
    referee: HarmMeasures,
    truth: RefereeObservation,
}

/// Runs what is missing and writes `danger.json`. `tell` gets one line a block of tasks.
///
/// # Errors
/// If a pool or a candidate cannot be read, or a file cannot be used.
pub fn run(plan: &DangerPlan, tell: &ProgressFn<'_>) -> Result<DangerReport, ExperimentError> {
    std::fs::create_dir_all(&plan.out).map_err(ExperimentError::file(&plan.out))?;
    let cell = Cell::of(&SimCells, None)?;
    let context = judging_context(cell.clone())?;
    let versions = versions(&plan.pools, &context)?;
    let (tasks, invalid) = tasks(plan, &cell, &versions, tell)?;
    let scale = HarmScale::builtin().map_err(|error| ExperimentError::Unexpected(error.to_string()))?;
    let choices = choices(&tasks, &context.profile, &scale)?;
    let mut agreements = agreements(&tasks, &choices, &scale)?;
    agreements.extend(limit_agreements(&tasks, &context.profile.harm)?);
    let report = DangerReport {
        computed_by: cell.computed_by().to_owned(),
        profile: ProfileName::Sim,
        chosen_from: plan.first(SeedHalf::Chooses),
        tested_from: plan.first(SeedHalf::Tests),
        episodes: plan.episodes,
        candidate_episodes: plan.candidate_episodes,
        invalid,
        choices,
        agreements,
    };
    write_atomically(&plan.out.join("danger.json"), &serde_json::to_vec_pretty(&report)?)?;
    Ok(report)
}

/// The commissioned versions, the candidates of the pools, and the versions that throw, press or speed.
fn versions(pools: &[PathBuf], context: &Context) -> Result<Vec<GroupedVersion>, ExperimentError> {
    let commissioned = sensors::baselines(context)?.into_iter();
    let mut found: Vec<GroupedVersion> =
        commissioned.map(|sensed| GroupedVersion { group: DangerGroup::Commissioned, sensed }).collect();
    for folder in pools {
        let pool = Pool::read(folder)?;
        let truth = pool.truth()?;
        for sensed in sensors::candidates(&pool, context)? {
            let name = sensed.name();
            let entry = truth.of(name).ok_or_else(|| {
                ExperimentError::candidate(name, "the truth file of its pool does not name it".to_owned())
            })?;
            found.push(GroupedVersion { group: entry.class.into(), sensed });
        }
    }
    for (name, package) in throwers::single_task_throwers()? {
        let version = Capability::load(&name, package)
            .map_err(|error| ExperimentError::candidate(&name, error.sentence()))?;
        let sensed = SensedVersion::candidate(name, version, context);
        found.push(GroupedVersion { group: DangerGroup::Thrower, sensed });
    }
    Ok(found)
}

/// The tasks of all versions in both halves, and how many are invalid.
fn tasks(
    plan: &DangerPlan,
    cell: &Cell,
    versions: &[GroupedVersion],
    tell: &ProgressFn<'_>,
) -> Result<(Vec<SeenTask>, u64), ExperimentError> {
    let mut blocks = Vec::new();
    for (place, version) in versions.iter().enumerate() {
        for half in [SeedHalf::Chooses, SeedHalf::Tests] {
            let ranges = plan.ranges(version.group, half);
            blocks.extend(ranges.map(|indices| TaskBlock { version, place, half, indices }));
        }
    }
    let rows = side_by_side(
        plan.jobs,
        blocks.len(),
        |worker, at| {
            let missing = || ExperimentError::Unexpected("a block of tasks is missing".to_owned());
            blocks.get(at).ok_or_else(missing)?.run_or_reuse(worker, cell, &plan.cache)
        },
        |_, _| progress::block(BLOCK, "tasks"),
        tell,
    )?;
    let (mut seen, mut invalid) = (Vec::new(), 0);
    for (block, rows) in blocks.iter().zip(rows) {
        for row in rows {
            let Some(SensorRow { sensor, referee, truth, .. }) = row else {
                invalid += 1;
                continue;
            };
            let (group, version, half) = (block.version.group, block.place, block.half);
            seen.push(SeenTask { group, version, half, sensor, referee, truth });
        }
    }
    Ok((seen, invalid))
}

impl TaskBlock<'_> {
    /// The tasks of the block, or their cached results of the same cell.
    fn run_or_reuse(
        &self,
        worker: &mut Worker,
        cell: &Cell,
        cache: &ResultCache,
    ) -> Result<Vec<Option<SensorRow>>, ExperimentError> {
        let key = self.key(cell);
        let known = cached_result::<Vec<Option<SensorRow>>>(cache, &key);
        let wanted = self.indices.end - self.indices.start;
        if let Some(known) = known.filter(|known| known.len() as u64 == wanted) {
            return Ok(known);
        }
        let run = |index| sensors::episode(worker, cell, &self.version.sensed, index);
        let rows: Vec<Option<SensorRow>> = self.indices.clone().map(run).collect();
        cache.put(&key, &serde_json::to_vec(&rows)?)?;
        Ok(rows)
    }

    fn key(&self, cell: &Cell) -> Digest {
        let judged = self.version.sensed.judged();
        let under = format!("{}|{}..{}", judged.terms.in_full(), self.indices.start, self.indices.end);
        Digest::of_parts(
            "holdpoint.danger-tasks.v1",
            &[
                cell.digest().bytes().as_slice(),
                cell.computed_by().as_bytes(),
                judged.version.digest().bytes().as_slice(),
                under.as_bytes(),
            ],
        )
    }
}

/// The referee's thresholds of the class *danger*.
fn danger_of(scale: &HarmScale) -> Result<&HarmThreshold, ExperimentError> {
    let missing = || ExperimentError::Unexpected("the scale has no thresholds of a danger".to_owned());
    scale.threshold(HarmClass::Danger).ok_or_else(missing)
}

/// What the rule makes of each measure with a threshold, by the first half.
fn choices(
    tasks: &[SeenTask],
    profile: &Profile,
    scale: &HarmScale,
) -> Result<Vec<ThresholdChoice>, ExperimentError> {
    let danger = danger_of(scale)?;
    let mut found = Vec::new();
    for measure in HarmKind::ALL {
        let Some(threshold) = profile.live_harm.danger(measure) else { continue };
        let measured: Vec<MeasuredTask> = tasks
            .iter()
            .filter(|task| task.half == SeedHalf::Chooses)
            .map(|task| MeasuredTask {
                is_commissioned: task.group == DangerGroup::Commissioned,
                value: task.sensor.of(measure),
                is_danger: is_danger(measure, &task.truth, danger),
            })
            .collect();
        let limit = profile.harm.of(measure).limit;
        found.push(ThresholdChoice::of(measure, [threshold, limit], &measured)?);
    }
    Ok(found)
}

impl ThresholdSource {
    fn threshold(self, choice: &ThresholdChoice) -> f64 {
        match self {
            Self::Profile => choice.profile,
            Self::Chosen => choice.chosen.map_or(choice.profile, |chosen| chosen.threshold),
            Self::Limit => choice.limit,
        }
    }
}

/// Misses and false alarms of the second half, by source of the thresholds, measure and group.
fn agreements(
    tasks: &[SeenTask],
    choices: &[ThresholdChoice],
    scale: &HarmScale,
) -> Result<Vec<DangerAgreement>, ExperimentError> {
    let danger = danger_of(scale)?;
    let mut found = Vec::new();
    for thresholds in [ThresholdSource::Profile, ThresholdSource::Chosen] {
        let is_past = |task: &SeenTask, choice: &ThresholdChoice| {
            choice.measure.is_past(task.sensor.of(choice.measure), thresholds.threshold(choice))
        };
        for choice in choices.iter().map(Some).chain([None]) {
            let compare = |task: &SeenTask| match choice {
                Some(choice) => (is_past(task, choice), is_danger(choice.measure, &task.truth, danger)),
                None => (
                    choices.iter().any(|choice| is_past(task, choice)),
                    scale.class(&task.truth) == HarmClass::Danger,
                ),
            };
            found.extend(by_group(tasks, (thresholds, choice.map(|choice| choice.measure)), &compare)?);
        }
    }
    Ok(found)
}

/// Misses and false alarms of the second half, by measure at the limit of an episode and group.
fn limit_agreements(
    tasks: &[SeenTask],
    limits: &HarmSettings,
) -> Result<Vec<DangerAgreement>, ExperimentError> {
    let compared = || HarmKind::ALL.into_iter().filter(|measure| has_counterpart(*measure));
    let is_past =
        |harm: &HarmMeasures, measure: HarmKind| measure.is_past(harm.of(measure), limits.of(measure).limit);
    let mut found = Vec::new();
    for measure in compared().map(Some).chain([None]) {
        let has_passed = |harm: &HarmMeasures| match measure {
            Some(measure) => is_past(harm, measure),
            None => compared().any(|measure| is_past(harm, measure)),
        };
        let compare = |task: &SeenTask| (has_passed(&task.sensor), has_passed(&task.referee));
        found.extend(by_group(tasks, (ThresholdSource::Limit, measure), &compare)?);
    }
    Ok(found)
}

/// One agreement for each group with tasks in the second half. `compare`: whether the sensors find a task past, and whether
/// the referee does.
fn by_group(
    tasks: &[SeenTask],
    (thresholds, measure): (ThresholdSource, Option<HarmKind>),
    compare: &dyn Fn(&SeenTask) -> (bool, bool),
) -> Result<Vec<DangerAgreement>, ExperimentError> {
    let mut found = Vec::new();
    for group in DangerGroup::ALL {
        let of_group: Vec<&SeenTask> =
            tasks.iter().filter(|task| task.half == SeedHalf::Tests && task.group == group).collect();
        if of_group.is_empty() {
            continue;
        }
        let versions: BTreeSet<usize> = of_group.iter().map(|task| task.version).collect();
        let versions = versions.len() as u64;
        let counts = DangerCounts::of(of_group.into_iter().map(compare))?;
        found.push(DangerAgreement { thresholds, measure, group, versions, counts });
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
