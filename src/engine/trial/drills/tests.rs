//! A drill that begins with work that others have done is the drill worked from its start, bit for bit.

use std::sync::Arc;

use holdpoint_body::{Observation, TaskKind};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::skill::SkillBundle;

use super::*;
use crate::embedded::baselines;

/// The calibration seed of the `index`-th test episode.
const fn seed(index: u64) -> u64 {
    1_200_000 + index
}

struct Bench {
    cell: Cell,
    terms: SkillTerms,
    versions: Vec<Capability>,
}

impl Bench {
    fn new() -> Self {
        let cell = Cell::builtin().unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        Self { cell, terms, versions: baselines().unwrap() }
    }

    fn version(&self, family: &str) -> &Capability {
        self.versions.iter().find(|version| version.id().family.as_str() == family).unwrap()
    }

    fn cast<'a>(&'a self, version: &'a Capability) -> Cast<'a> {
        Cast { version, predecessor: version, fallback: Some(self.version("park")) }
    }

    fn case<'a>(&'a self, cast: &'a Cast<'a>, kind: DrillKind, seed: u64) -> DrillCase<'a> {
        DrillCase { cell: &self.cell, terms: &self.terms, cast, kind, seed }
    }
}

/// How a drill ended, where it left the world, and how many points lay behind the end of the work.
type Ended = (DrillResult, u64, u32);

fn end(worker: &mut Worker, result: DrillResult, over: u32) -> Ended {
    (result, worker.built_arm().map_or(0, |arm| arm.body().state_hash()), over)
}

/// The drill with every point tried from a reset, as if nothing were known of the work and nothing kept.
fn from_the_start(worker: &mut Worker, case: &DrillCase<'_>) -> Ended {
    let trial = case.trial();
    let (stream, mut point) = first_point(case.kind, case.seed);
    for over in 0..POINT_TRIES {
        let Ok(arm) = worker.arm(&case.cell.clone(), &trial.setup()) else {
            return (DrillResult::Infeasible, 0, over);
        };
        let mut run = trial.start();
        let mut handle = arm.handle();
        let reached = run.work_until(&mut handle, &mut |passed| {
            passed.tick >= point && !matches!(passed.command, Command::Done | Command::Fail { .. })
        });
        if reached.unwrap() {
            let passed = case.at_point(worker, run, stream).unwrap();
            let result = if passed { DrillResult::Passed } else { DrillResult::Failed };
            return end(worker, result, over);
        }
        point = (point / 2).max(POINT_MIN);
    }
    (DrillResult::Infeasible, 0, POINT_TRIES)
}

#[test]
fn every_drill_begun_with_shared_work_is_the_drill_worked_from_its_start() {
    let bench = Bench::new();
    let (mut worker, mut other) = (Worker::new(), Worker::new());
    let (mut over, mut results) = (0, Vec::new());
    for family in ["grasp", "align", "place"] {
        let version = bench.version(family);
        let cast = bench.cast(version);
        for index in 0..4 {
            let mut shared = None;
            // Every kind comes first once: later points are then reached before earlier ones and after.
            for step in 0..4 {
                let kind = DrillKind::ALL[(step + usize::try_from(index).unwrap()) % 4];
                let case = bench.case(&cast, kind, seed(index));
                let expected = from_the_start(&mut other, &case);
                let result = case.run(&mut worker, &mut shared, &DrillKind::ALL);
                assert_eq!(result, expected.0, "{family} {kind:?} {index}");
                if result != DrillResult::Infeasible {
                    assert_eq!(
                        end(&mut worker, result, 0).1,
                        expected.1,
                        "{family} {kind:?} {index}: the world"
                    );
                }
                over += expected.2;
                results.push(result);
                assert_eq!(drill(&mut worker, &bench.cell, &bench.terms, &cast, kind, seed(index)), result);
            }
            assert!(shared.is_some_and(|work| work.forks() > 0), "{family} {index}: nothing was shared");
        }
    }
    assert!(over > 0, "no drill had a point behind the work's end: nothing was tried");
    assert!(results.contains(&DrillResult::Passed) && results.contains(&DrillResult::Failed), "{results:?}");
}

/// A bundle whose runs cannot be copied.
struct Single(Arc<dyn SkillBundle>);

impl SkillBundle for Single {
    fn digest(&self) -> Digest {
        self.0.digest()
    }
    fn interface(&self) -> Interface {
        self.0.interface()
    }
    fn task(&self) -> TaskKind {
        self.0.task()
    }
    fn start(&self, seed: u64) -> Box<dyn Skill> {
        Box::new(SingleRun(self.0.start(seed)))
    }
}

struct SingleRun(Box<dyn Skill>);

impl Skill for SingleRun {
    fn tick(&mut self, seen: &Observation) -> Command {
        self.0.tick(seen)
    }
    fn enter(&mut self, hook: Hook) {
        self.0.enter(hook);
    }
}

#[test]
fn a_skill_that_cannot_be_copied_is_worked_again_and_comes_to_the_same() {
    let bench = Bench::new();
    let version = bench.version("align");
    let mut single = version.clone();
    single.bundle = Arc::new(Single(version.bundle.clone()));
    let (cast, cast_single) = (bench.cast(version), bench.cast(&single));
    let (mut worker, mut other) = (Worker::new(), Worker::new());
    let (mut shared, mut never) = (None, None);
    for kind in DrillKind::ALL {
        let expected = bench.case(&cast, kind, seed(2)).run(&mut worker, &mut shared, &DrillKind::ALL);
        let case = bench.case(&cast_single, kind, seed(2));
        let result = case.run(&mut other, &mut never, &DrillKind::ALL);
        assert_eq!(end(&mut other, result, 0), end(&mut worker, expected, 0), "{kind:?}");
    }
    assert!(shared.is_some_and(|work| work.forks() > 0));
    assert!(never.is_some_and(|work| work.forks() == 0), "a skill that cannot be copied was");
}

/// What certainly fails is not worked on; the rest of it must not have mattered.
#[test]
fn a_drill_that_ends_early_fails_as_it_would_have_at_its_end() {
    let bench = Bench::new();
    let (mut worker, mut lost) = (Worker::new(), 0);
    let folder = std::path::Path::new(crate::MANIFESTS).join("candidates/align-no-stop");
    let version = Capability::read(&folder).unwrap();
    let cast = bench.cast(&version);
    for index in 0..6 {
        for kind in [DrillKind::Abort, DrillKind::Fallback] {
            let case = bench.case(&cast, kind, seed(index));
            let result = case.run(&mut worker, &mut None, &[kind]);
            let Some(expected) = to_the_end(&mut worker, &case) else { continue };
            assert_eq!(result, expected, "{kind:?} {index}");
            lost += u32::from(result == DrillResult::Failed);
        }
    }
    assert!(lost > 2, "the candidate that does not stop was to fail: {lost}");
}

/// Abort and fallback drills, worked to the end whatever happens on the way.
fn to_the_end(worker: &mut Worker, case: &DrillCase<'_>) -> Option<DrillResult> {
    let (cell, cast) = (case.cell.clone(), case.cast);
    let trial = case.trial();
    let arm = worker.arm(&cell, &trial.setup()).ok()?;
    let (_, point) = first_point(case.kind, case.seed);
    let mut run = trial.start();
    if !run.work_until(&mut arm.handle(), &mut |passed| passed.tick >= point).ok()? {
        return None;
    }
    let held = holds_object(&arm.body().telemetry());
    let (mut skill, mut guard) = run.into_skill_and_guard();
    let task = cast.version.bundle.task();
    let mut watcher = Watcher::new(task, *case.terms.watch());
    let (secs, mut handle) = (cast.version.abort_secs(), arm.handle());
    let report =
        holdpoint_runtime::recovery::abort(&mut handle, skill.as_mut(), &mut guard, &mut watcher, secs);
    let report = report.ok()?;
    let passed = match case.kind {
        DrillKind::Abort => {
            report.stopped_by == StoppedBy::Hook
                && report.violation.is_none()
                && !watcher.has(WatcherSignal::UnexpectedContact)
                && safe_pose(held, &arm.body().telemetry())
        }
        DrillKind::Fallback => {
            arm.body_mut().interrupt(holdpoint_body::Interrupt::Release);
            let next = cast.fallback?;
            arm.body_mut().begin_task(task);
            let admitted = admit(&next.manifest, &arm.body().telemetry()).is_ok();
            let guard = case.terms.guard(&next.manifest.permissions);
            let terms = case.terms.task(task, case.seed, next.abort_secs());
            let run = TaskRun::new(next.start(case.terms.bundle_seed(case.seed)), guard, terms);
            let record = run.finish(&mut arm.handle(), &mut |_, _| Supervision::Continue).ok()?;
            let stopped = report.stopped_by != StoppedBy::Nothing && report.violation.is_none();
            let safe = !record.violation && record.hard_stop.is_none() && !record.recovery;
            stopped && admitted && safe && safe_pose(held, &arm.body().telemetry())
        }
        DrillKind::Rollback | DrillKind::Detect => return None,
    };
    Some(if passed { DrillResult::Passed } else { DrillResult::Failed })
}
