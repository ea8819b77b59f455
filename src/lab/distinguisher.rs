//! The distinguisher experiment: what a version sees of its task in the live cell, and in the two kinds of the sandbox's pairs.
//!
//! Runs the baselines and writes one row of features a task, from the observations that the version received.
//! `tests/reports/distinguish.py` trains classifiers on the rows. Trains none and judges nothing itself.

mod features;
mod recording;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;

use holdpoint_body::TaskKind;
use holdpoint_engine::live::listener::NoListener;
use holdpoint_engine::live::station::LiveStation;
use holdpoint_governance::ids::Family;
use holdpoint_record::context::Context;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::pair_spot::PairSpot;
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::trial_lab::TrialSubject;
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use self::features::NamedFeature;
use self::recording::{RunLog, recorded};
use crate::ground_truth::{JudgedVersion, judging_context};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, baselines, write_atomically};
use crate::side_by_side::side_by_side;
use crate::wording::progress;

holdpoint_governance::closed_set! {
    /// Where a version runs its task.
    TaskOrigin, "origin of a task", {
        /// In a sequence of the live cell.
        Live = "live",
        /// As the sandbox runs its live-like pairs, from a start of the live cell.
        LiveStart = "live-start",
        /// As the sandbox runs its other pairs.
        Sandbox = "sandbox",
    }
}

/// First seed of the experiment: far from those of any run, calibration, practice or truth.
const SEEDS_FROM: u64 = 3 << 60;

/// Seeds of one origin.
const ORIGIN_SEEDS: u64 = 1 << 40;

/// Sequences that one worker runs at a time, each with as many single tasks beside it.
const BLOCK: u64 = 25;

/// The tasks to record.
#[derive(Clone, Debug)]
pub struct DistinguisherPlan {
    /// Sequences of the live cell; each origin runs each task as often, as far as it comes to it.
    pub sequences: u64,
    /// Index of the first sequence.
    pub seed: u64,
    pub jobs: usize,
    /// Where the rows and the report go.
    pub out: PathBuf,
}

/// One run of one task.
#[derive(Clone, Debug, PartialEq)]
struct TaskRow {
    origin: TaskOrigin,
    task: TaskKind,
    sequence: u64,
    features: Vec<NamedFeature>,
}

/// How many rows there are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RowCount {
    pub origin: TaskOrigin,
    pub task: TaskKind,
    pub rows: u64,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistinguisherReport {
    /// Digest of everything that computes an episode.
    pub computed_by: String,
    pub sequences: u64,
    /// Index of the first sequence.
    pub seed: u64,
    /// The names of the columns that a classifier may use.
    pub features: Vec<String>,
    pub rows: Vec<RowCount>,
}

impl DistinguisherReport {
    fn of(plan: &DistinguisherPlan, cell: &Cell, rows: &[TaskRow]) -> Self {
        let count = |origin: TaskOrigin, task: TaskKind| {
            let rows = rows.iter().filter(|row| row.origin == origin && row.task == task).count() as u64;
            RowCount { origin, task, rows }
        };
        let of_origin = |origin: TaskOrigin| TaskKind::SEQUENCE.map(|task| count(origin, task));
        let names: Option<Vec<String>> =
            rows.first().map(|row| row.features.iter().map(|(name, _)| name.clone()).collect());
        Self {
            computed_by: cell.computed_by().to_owned(),
            sequences: plan.sequences,
            seed: plan.seed,
            features: names.unwrap_or_default(),
            rows: TaskOrigin::ALL.into_iter().flat_map(of_origin).collect(),
        }
    }
}

/// The versions of a sequence and their terms.
struct DistinguisherBench {
    cell: Cell,
    context: Context,
    active: BTreeMap<Family, Capability>,
}

/// The same versions with their runs recorded.
struct RecordedVersions {
    versions: BTreeMap<Family, Capability>,
    logs: Vec<(TaskKind, RunLog)>,
}

impl ActiveView for RecordedVersions {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.versions.get(family)
    }
}

impl RecordedVersions {
    fn of(active: &BTreeMap<Family, Capability>) -> Self {
        let (mut versions, mut logs) = (BTreeMap::new(), Vec::new());
        for (family, version) in active {
            let (version, log) = recorded(version);
            logs.push((version.bundle.task(), log));
            versions.insert(family.clone(), version);
        }
        Self { versions, logs }
    }

    /// The rows of the runs since the last call.
    fn take_rows(&self, origin: TaskOrigin, sequence: u64, rows: &mut Vec<TaskRow>) {
        for (task, log) in &self.logs {
            let runs = log.lock().map(|mut log| std::mem::take(&mut *log)).unwrap_or_default();
            let features = runs.iter().filter_map(features::of);
            rows.extend(features.map(|features| TaskRow { origin, task: *task, sequence, features }));
        }
    }
}

impl DistinguisherBench {
    fn new() -> Result<Self, ExperimentError> {
        let cell = Cell::of(&SimCells, None)?;
        let context = judging_context(cell.clone())?;
        let baselines = baselines()?;
        // The family that parks the arm has no task of its own.
        let in_sequence = |version: &Capability| TaskKind::named(version.id().family.as_str()).is_some();
        let active = baselines.into_iter().filter(in_sequence);
        let active = active.map(|version| (version.id().family, version)).collect();
        Ok(Self { cell, context, active })
    }

    fn terms(&self, version: &Capability) -> SkillTerms {
        JudgedVersion::new(&self.context, version.clone()).terms
    }

    fn subject(&self, version: &Capability) -> TrialSubject {
        TrialSubject { version: version.clone(), terms: self.terms(version), fallback: None }
    }

    /// The rows of these sequences of the live cell, and of as many single tasks of the other origins.
    fn rows(&self, worker: &mut Worker, indices: Range<u64>) -> Result<Vec<TaskRow>, ExperimentError> {
        let recorded = RecordedVersions::of(&self.active);
        let mut live = LiveStation::new(self.cell.clone())?;
        let mut rows = Vec::new();
        for index in indices {
            let terms = |version: &Capability| self.terms(version);
            live.run_sequence(&recorded, &terms, seed(TaskOrigin::Live, index), &mut NoListener, None);
            recorded.take_rows(TaskOrigin::Live, index, &mut rows);
            for version in recorded.versions.values() {
                let subject = self.subject(version);
                let others = self.active.values().map(|version| self.subject(version));
                let team = TrialTeam::excluding(&self.cell.spec.tasks, version.bundle.task(), others);
                for (origin, live_like) in [(TaskOrigin::LiveStart, true), (TaskOrigin::Sandbox, false)] {
                    let spot = PairSpot { seed: seed(origin, index), live_like };
                    // The observations are what counts, whatever comes of the task.
                    let _ = spot.run(worker, &self.cell, &team, &subject);
                    recorded.take_rows(origin, index, &mut rows);
                }
            }
        }
        Ok(rows)
    }
}

const fn seed(origin: TaskOrigin, index: u64) -> u64 {
    SEEDS_FROM + origin as u64 * ORIGIN_SEEDS + index
}

/// Runs the plan and writes `distinguisher.csv` and `distinguisher.json`. `tell` gets one line a block of sequences.
///
/// # Errors
/// If the cell cannot be built, or a file cannot be written.
pub fn run(plan: &DistinguisherPlan, tell: &ProgressFn<'_>) -> Result<DistinguisherReport, ExperimentError> {
    std::fs::create_dir_all(&plan.out).map_err(ExperimentError::file(&plan.out))?;
    let bench = DistinguisherBench::new()?;
    let blocks = plan.sequences.div_ceil(BLOCK);
    let found = side_by_side(
        plan.jobs,
        usize::try_from(blocks).unwrap_or(usize::MAX),
        |worker, at| {
            let from = at as u64 * BLOCK;
            let until = (from + BLOCK).min(plan.sequences);
            bench.rows(worker, plan.seed + from..plan.seed + until)
        },
        |_, _| progress::block(BLOCK, "sequences"),
        tell,
    )?;
    let rows: Vec<TaskRow> = found.into_iter().flatten().collect();
    let report = DistinguisherReport::of(plan, &bench.cell, &rows);
    write_atomically(&plan.out.join("distinguisher.csv"), csv(&report.features, &rows).as_bytes())?;
    write_atomically(&plan.out.join("distinguisher.json"), &serde_json::to_vec_pretty(&report)?)?;
    Ok(report)
}

fn csv(features: &[String], rows: &[TaskRow]) -> String {
    let mut text = format!("origin,task,sequence,{}\n", features.join(","));
    for TaskRow { origin, task, sequence, features } in rows {
        text.push_str(&format!("{origin},{task},{sequence}"));
        for (_, value) in features {
            text.push_str(&format!(",{value}"));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(jobs: usize, out: PathBuf) -> DistinguisherPlan {
        // Above all sequences that any report uses; more than one block.
        DistinguisherPlan { sequences: BLOCK + 3, seed: 900_000, jobs, out }
    }

    fn value(row: &TaskRow, wanted: &str) -> f64 {
        let (_, value) = row.features.iter().find(|(name, _)| name == wanted).unwrap();
        *value
    }

    #[test]
    fn tasks_from_live_starts_look_like_live_ones_and_those_of_the_sandbox_do_not() {
        let bench = DistinguisherBench::new().unwrap();
        let rows = bench.rows(&mut Worker::new(), 900_000..900_012).unwrap();
        let of = |origin: TaskOrigin, task: TaskKind| {
            rows.iter().filter(move |row| row.origin == origin && row.task == task)
        };
        for task in TaskKind::SEQUENCE {
            assert_eq!(of(TaskOrigin::LiveStart, task).count(), 12, "{task}");
            assert_eq!(of(TaskOrigin::Sandbox, task).count(), 12, "{task}");
            let live = of(TaskOrigin::Live, task).count();
            assert!((1..=12).contains(&live), "{task}: {live}");
        }
        // A later task of a sequence begins with a camera frame at hand; a single task of the sandbox does not.
        for task in [TaskKind::Align, TaskKind::Place] {
            let newest = |origin: TaskOrigin| {
                of(origin, task).map(|row| value(row, "frame_first")).fold(0.0, f64::max)
            };
            assert!(newest(TaskOrigin::Live) > 30.0 && newest(TaskOrigin::LiveStart) > 30.0, "{task}");
            assert_eq!(newest(TaskOrigin::Sandbox), 0.0, "{task}");
        }
        for row in &rows {
            assert!(row.features.iter().all(|(_, value)| value.is_finite()), "{row:?}");
            assert_eq!(row.features.len(), rows[0].features.len());
            assert_eq!(value(row, "tick_first"), 0.0, "{row:?}");
        }
    }

    #[test]
    fn rows_are_the_same_with_any_number_of_jobs() {
        let folder = tempfile::tempdir().unwrap();
        let outs = [folder.path().join("one"), folder.path().join("two")];
        let reports =
            [(1, &outs[0]), (2, &outs[1])].map(|(jobs, out)| run(&plan(jobs, out.clone()), &|_| {}).unwrap());
        assert_eq!(reports[0], reports[1]);
        let files = |name: &str| outs.clone().map(|out| std::fs::read_to_string(out.join(name)).unwrap());
        let [one, two] = files("distinguisher.csv");
        assert_eq!(one, two);
        let rows: u64 = reports[0].rows.iter().map(|count| count.rows).sum();
        assert_eq!(one.lines().count() as u64, rows + 1);
        let columns = 3 + reports[0].features.len();
        assert!(one.lines().all(|line| line.split(',').count() == columns));
        let [json, _] = files("distinguisher.json");
        assert_eq!(serde_json::from_str::<DistinguisherReport>(&json).unwrap(), reports[0]);
    }

    #[test]
    fn seeds_of_origins_are_disjoint_from_each_other_and_from_practice() {
        let ends = TaskOrigin::ALL.map(|origin| (seed(origin, 0), seed(origin, ORIGIN_SEEDS - 1)));
        assert!(ends.windows(2).all(|two| two[0].1 < two[1].0), "{ends:?}");
        assert!(ends[2].1 < holdpoint_trials::seeds::PRACTICE_FROM);
    }
}
