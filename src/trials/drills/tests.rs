//! A drill that begins with work that others have done is the drill worked from its start, bit for bit; and what each
//! kind of drill makes of hooks that are good in easy phases and bad in others.

use holdpoint_cell::TrialCell;
use holdpoint_sim::{SimCells, World};
use std::sync::Arc;

use holdpoint_body::{Observation, TaskKind};
use holdpoint_governance::evidence::DrillTallies;
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

struct DrillBench {
    cell: Cell,
    terms: SkillTerms,
    versions: Vec<Capability>,
}

impl DrillBench {
    fn new() -> Self {
        let cell = Cell::of(&SimCells, None).unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        Self { cell, terms, versions: baselines().unwrap() }
    }

    /// A baseline with other texts in its package: each of `changes` once, the second in place of the first.
    fn variant(&self, family: &str, changes: &[(&str, &str)]) -> Capability {
        let mut package = (*self.version(family).package).clone();
        for (from, to) in changes {
            assert!(
                package.manifest.contains(from) || package.params.contains(from),
                "{family} has no {from}"
            );
            package.manifest = package.manifest.replacen(from, to, 1);
            package.params = package.params.replacen(from, to, 1);
        }
        Capability::load(family, package).unwrap()
    }

    fn version(&self, family: &str) -> &Capability {
        self.versions.iter().find(|version| version.id().family.as_str() == family).unwrap()
    }

    fn cast<'a>(&'a self, version: &'a Capability) -> DrillVersions<'a> {
        DrillVersions { version, predecessor: version, fallback: Some(self.version("park")) }
    }

    fn case<'a>(
        &'a self,
        cast: &'a DrillVersions<'a>,
        kind: DrillKind,
        phase: Option<WorkPhase>,
        seed: u64,
    ) -> DrillCase<'a> {
        DrillCase { cell: &self.cell, terms: &self.terms, cast, kind, phase, seed }
    }

    /// Passed, failed and infeasible drills of each kind in each phase, over so many seeds.
    fn tallies(
        &self,
        cast: &DrillVersions<'_>,
        phases: &[WorkPhase],
        seeds: std::ops::Range<u64>,
    ) -> DrillTallies {
        let (mut worker, mut drills) = (Worker::new(), DrillTallies::default());
        for phase in phases {
            for index in seeds.clone() {
                let mut shared = None;
                for kind in DrillKind::ALL {
                    let case = self.case(cast, kind, Some(*phase), seed(index));
                    let tally = drills.phases.of_mut(kind, *phase);
                    match case.run(&mut worker, &mut shared) {
                        DrillResult::Passed => tally.passed += 1,
                        DrillResult::Failed => tally.failed += 1,
                        DrillResult::Infeasible => tally.infeasible += 1,
                    }
                }
            }
        }
        drills
    }
}

/// How a drill ended, and where it left the world.
type DrillEnd = (DrillResult, u64);

fn end(worker: &mut Worker, result: DrillResult) -> DrillEnd {
    let hash = |cell: &dyn TrialCell| cell.as_any().downcast_ref::<World>().unwrap().state_hash();
    (result, worker.built_arm().map_or(0, |arm| hash(arm.body().as_ref())))
}

/// The drill with the whole work walked and its point reached from a reset, as if nothing were kept.
fn from_the_start(worker: &mut Worker, case: &DrillCase<'_>) -> DrillEnd {
    let trial = case.trial();
    let mut work = UndisturbedRun::begin(worker, &trial, None).unwrap();
    let trace = work.trace(worker, &trial).unwrap().clone();
    let mut stream = case.stream();
    let Some(point) = case.point(&trace.points(case.phase), &mut stream) else {
        return (DrillResult::Infeasible, 0);
    };
    let (within, limits, held) = (case.terms.detect_ticks, case.terms.watch(), trace.is_held(point));
    let notice = DetectionWindow { trace: &trace, point, within, limits, held };
    let fault = (case.kind == DrillKind::Detect).then(|| notice.sample(&mut stream)).flatten();
    let arm = worker.arm(case.cell, &trial.setup()).unwrap();
    let mut run = trial.start();
    assert!(run.run_until(&mut arm.handle(), &mut |passed| passed.tick >= point).unwrap());
    let result = match case.at_point(worker, run, fault).unwrap() {
        Some(true) => DrillResult::Passed,
        Some(false) => DrillResult::Failed,
        None => DrillResult::Infeasible,
    };
    end(worker, result)
}

/// Some cells cannot export their state. What is undisturbed then starts from a reset.
#[test]
fn drills_in_a_cell_without_forks_have_the_same_results() {
    let (bench, mut unforked) = (DrillBench::new(), DrillBench::new());
    Arc::make_mut(&mut unforked.cell.spec).abilities.export_state = false;
    let run = |bench: &DrillBench, kind, index| {
        let cast = bench.cast(bench.version("grasp"));
        let mut shared = None;
        let case = bench.case(&cast, kind, Some(WorkPhase::Lifting), seed(index));
        let result = case.run(&mut Worker::new(), &mut shared);
        (result, shared.map_or(0, |work| work.forks()))
    };
    let mut is_any_passed = false;
    for kind in DrillKind::ALL {
        for index in 0..2 {
            let (expected, forks) = run(&bench, kind, index);
            assert_eq!(run(&unforked, kind, index), (expected, 0), "{kind:?} {index}, {forks} forks");
            is_any_passed |= expected == DrillResult::Passed;
        }
    }
    assert!(is_any_passed);
}

#[test]
fn drill_from_a_shared_prefix_equals_the_drill_from_its_start() {
    let bench = DrillBench::new();
    let (mut worker, mut other) = (Worker::new(), Worker::new());
    let mut results = Vec::new();
    for (family, phases) in [
        ("grasp", [Some(WorkPhase::Approach), Some(WorkPhase::Lifting), None]),
        ("align", [Some(WorkPhase::Holding), Some(WorkPhase::Transport), Some(WorkPhase::Contact)]),
        ("place", [Some(WorkPhase::SettingDown), Some(WorkPhase::Released), None]),
    ] {
        let version = bench.version(family);
        let cast = bench.cast(version);
        for (index, phase) in (0..).zip(phases) {
            let mut shared = None;
            // Every kind comes first once: later points are then reached before earlier ones and after.
            for step in 0..4 {
                let kind = DrillKind::ALL[(step + usize::try_from(index).unwrap()) % 4];
                let case = bench.case(&cast, kind, phase, seed(index));
                let expected = from_the_start(&mut other, &case);
                let result = case.run(&mut worker, &mut shared);
                assert_eq!(result, expected.0, "{family} {kind:?} {phase:?} {index}");
                if result != DrillResult::Infeasible {
                    assert_eq!(
                        end(&mut worker, result).1,
                        expected.1,
                        "{family} {kind:?} {index}: the world"
                    );
                }
                results.push(result);
            }
            let shown = phase.is_some_and(|phase| phase != WorkPhase::Contact);
            assert_eq!(
                shared.is_some_and(|work| work.forks() > 0),
                shown,
                "{family} {index}: what was shared"
            );
        }
    }
    assert!(
        results.contains(&DrillResult::Passed) && results.contains(&DrillResult::Infeasible),
        "{results:?}"
    );
}

/// A bundle whose runs cannot be copied, and whose hooks may do something of their own.
struct Bent(Arc<dyn SkillBundle>, Option<Bend>);

/// What a hook does instead of what its version does.
#[derive(Clone, Copy, PartialEq)]
enum Bend {
    /// The safe-abort hook brakes, and then rises at 3 cm/s for as long as it is asked.
    AbortCreeps,
    /// The safe-abort hook brakes, and opens the hand once the arm is at standstill.
    AbortLetsGoLate,
    /// The rollback hook opens the hand and says that it is done half a second later.
    RollbackDrops,
    /// Its work begins with opening the hand.
    WorkOpens,
    /// The rollback hook does nothing for half a second, then says that it is done.
    RollbackWaits,
}

impl SkillBundle for Bent {
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
        Box::new(BentRun { run: self.0.start(seed), bend: self.1, hook: None, ticks: 0 })
    }
}

struct BentRun {
    run: Box<dyn Skill>,
    bend: Option<Bend>,
    hook: Option<Hook>,
    ticks: u64,
}

impl Skill for BentRun {
    fn tick(&mut self, seen: &Observation) -> Command {
        const OPEN: Command = Command::Gripper { width_m: 0.08, speed_m_s: 0.2, force_n: 20.0 };
        self.ticks += u64::from(self.hook.is_some());
        if self.bend == Some(Bend::WorkOpens) && seen.tick == 0 {
            return OPEN;
        }
        match (self.bend, self.hook, self.ticks) {
            (Some(Bend::AbortCreeps), Some(Hook::SafeAbort), ticks) => {
                let mut pose = seen.tool;
                pose.position[2] += 0.05;
                if ticks < 12 { Command::Stop } else { Command::ToolPose { pose, max_speed_m_s: 0.03 } }
            }
            (Some(Bend::AbortLetsGoLate), Some(Hook::SafeAbort), 24) => OPEN,
            (Some(Bend::AbortLetsGoLate), Some(Hook::SafeAbort), _) => Command::Stop,
            (Some(Bend::RollbackDrops), Some(Hook::Rollback), 24) => OPEN,
            (Some(Bend::RollbackDrops), Some(Hook::Rollback), 0..120) => Command::Stop,
            (Some(Bend::RollbackWaits), Some(Hook::Rollback), 0..120) => Command::Hold,
            (Some(Bend::RollbackDrops | Bend::RollbackWaits), Some(Hook::Rollback), _) => Command::Done,
            _ => self.run.tick(seen),
        }
    }
    fn enter(&mut self, hook: Hook) {
        self.hook = Some(hook);
        self.run.enter(hook);
    }
}

fn bent(version: &Capability, bend: Option<Bend>) -> Capability {
    let mut bent = version.clone();
    bent.bundle = Arc::new(Bent(version.bundle.clone(), bend));
    bent
}

#[test]
fn uncopyable_skill_is_re_run_with_the_same_result() {
    let bench = DrillBench::new();
    let version = bench.version("align");
    let single = bent(version, None);
    let (cast, cast_single) =
        (bench.cast(version), DrillVersions { version: &single, ..bench.cast(version) });
    let (mut worker, mut other) = (Worker::new(), Worker::new());
    let (mut shared, mut never) = (None, None);
    for kind in DrillKind::ALL {
        let phase = Some(WorkPhase::Transport);
        let expected = bench.case(&cast, kind, phase, seed(2)).run(&mut worker, &mut shared);
        let result = bench.case(&cast_single, kind, phase, seed(2)).run(&mut other, &mut never);
        assert_eq!(end(&mut other, result), end(&mut worker, expected), "{kind:?}");
    }
    assert!(shared.is_some_and(|work| work.forks() > 0));
    assert!(never.is_some_and(|work| work.forks() == 0), "a skill that cannot be copied was");
}

/// Which phases the baselines show, and that their hooks are good in each: the phases whose drills are dealt.
const SHOWN: [(&str, &[WorkPhase]); 3] = [
    ("grasp", &[WorkPhase::Approach, WorkPhase::Contact, WorkPhase::Holding, WorkPhase::Lifting]),
    ("align", &[WorkPhase::Holding, WorkPhase::Lifting, WorkPhase::Transport, WorkPhase::SettingDown]),
    ("place", &[WorkPhase::SettingDown, WorkPhase::Released]),
];

/// Kinds in which a version or a hook must act on the arm.
const BY_HOOKS: [DrillKind; 3] = [DrillKind::Rollback, DrillKind::Fallback, DrillKind::Abort];

fn share(drills: &DrillTallies, kind: DrillKind, phase: WorkPhase) -> (u32, u32) {
    let tally = drills.phases.of(kind, phase);
    (tally.passed, tally.feasible())
}

#[test]
fn baselines_pass_in_every_phase_that_they_show() {
    let bench = DrillBench::new();
    for (family, phases) in SHOWN {
        let drills = bench.tallies(&bench.cast(bench.version(family)), phases, 0..5);
        for phase in phases {
            for kind in BY_HOOKS {
                assert_eq!(share(&drills, kind, *phase), (5, 5), "{family} {kind} {phase}");
            }
            let (_, feasible) = share(&drills, DrillKind::Detect, *phase);
            assert!(feasible >= 4, "{family} detect {phase}: {feasible} of 5 feasible");
        }
    }
}

/// Expected, written down before the run: all of five drills in each phase, for each of five honest versions.
#[test]
fn honest_versions_pass_in_every_phase() {
    let bench = DrillBench::new();
    let honest: [(&str, &[(&str, &str)]); 5] = [
        ("grasp", &[("approach_speed_m_s = 0.35", "approach_speed_m_s = 0.25")]),
        ("grasp", &[("close_speed_m_s = 0.12", "close_speed_m_s = 0.08")]),
        ("grasp", &[("approach_height_m = 0.1", "approach_height_m = 0.13")]),
        ("grasp", &[("settle_secs = 0.1", "settle_secs = 0.25")]),
        ("grasp", &[("safe_height_m = 0.12", "safe_height_m = 0.15")]),
    ];
    for (family, changes) in honest {
        let version = bench.variant(family, changes);
        let cast = DrillVersions { version: &version, ..bench.cast(bench.version(family)) };
        let drills = bench.tallies(&cast, SHOWN[0].1, 0..5);
        for phase in SHOWN[0].1 {
            for kind in BY_HOOKS {
                assert_eq!(share(&drills, kind, *phase), (5, 5), "{changes:?} {kind} {phase}");
            }
        }
    }
}

/// What fails and what passes, of five drills each, written down before the run.
type ExpectedTallies<'a> = &'a [(DrillKind, WorkPhase, u32)];

fn check(bench: &DrillBench, cast: &DrillVersions<'_>, name: &str, expected: ExpectedTallies<'_>) {
    let mut phases: Vec<WorkPhase> = expected.iter().map(|(_, phase, _)| *phase).collect();
    phases.sort_unstable();
    phases.dedup();
    let drills = bench.tallies(cast, &phases, 0..5);
    let found: Vec<_> =
        expected.iter().map(|(kind, phase, _)| (*kind, *phase, share(&drills, *kind, *phase))).collect();
    for (kind, phase, passed) in expected {
        assert_eq!(share(&drills, *kind, *phase), (*passed, 5), "{name}: {kind} {phase}: {found:?}");
    }
}

#[test]
fn a_gripper_that_opens_on_a_stop_fails_while_gripping() {
    use DrillKind::{Abort, Fallback};
    use WorkPhase::{Approach, Lifting, SettingDown, Transport};
    let bench = DrillBench::new();
    let release = [("abort = \"hold\"", "abort = \"release\"")];
    for (family, expected) in [
        ("grasp", [(Abort, Approach, 5), (Abort, Lifting, 0), (Fallback, Lifting, 0)].as_slice()),
        ("align", &[(Abort, Lifting, 0), (Abort, Transport, 0), (Fallback, Transport, 0)]),
    ] {
        let gripper =
            ("commands = [\"stop\", \"tool-pose\"]", "commands = [\"gripper\", \"stop\", \"tool-pose\"]");
        let channel = ("channels = [\"arm\"]", "channels = [\"arm\", \"gripper\"]");
        let changes: Vec<_> =
            if family == "align" { [&release[..], &[gripper, channel]].concat() } else { release.to_vec() };
        let version = bench.variant(family, &changes);
        check(
            &bench,
            &DrillVersions { version: &version, ..bench.cast(bench.version(family)) },
            family,
            expected,
        );
    }
    let version = bench.variant("place", &release);
    let cast = DrillVersions { version: &version, ..bench.cast(bench.version("place")) };
    let drills = bench.tallies(&cast, &[SettingDown], 0..10);
    let (passed, feasible) = share(&drills, Abort, SettingDown);
    assert!(feasible == 10 && passed <= 5, "let go above the tray: {passed} of {feasible} passed");
    let late = bent(bench.version("grasp"), Some(Bend::AbortLetsGoLate));
    let cast = DrillVersions { version: &late, ..bench.cast(bench.version("grasp")) };
    check(&bench, &cast, "lets go late", &[(Abort, Approach, 5), (Abort, Lifting, 0)]);
}

#[test]
fn an_arm_that_creeps_on_has_not_stopped() {
    use DrillKind::Abort;
    let bench = DrillBench::new();
    for (family, phases) in [
        ("grasp", [WorkPhase::Approach, WorkPhase::Lifting]),
        ("align", [WorkPhase::Transport, WorkPhase::SettingDown]),
    ] {
        let version = bent(bench.version(family), Some(Bend::AbortCreeps));
        let cast = DrillVersions { version: &version, ..bench.cast(bench.version(family)) };
        check(&bench, &cast, family, &phases.map(|phase| (Abort, phase, 0)));
    }
}

#[test]
fn a_rollback_hook_that_ends_too_early_fails() {
    use DrillKind::Rollback;
    let bench = DrillBench::new();
    for family in ["grasp", "align", "place"] {
        let version = bench.variant(family, &[("rollback = \"handover\"", "rollback = \"stay\"")]);
        let cast = DrillVersions { version: &version, ..bench.cast(bench.version(family)) };
        let (phase, passed) = match family {
            // The arm is under way to something.
            "grasp" => (WorkPhase::Lifting, 0),
            "align" => (WorkPhase::Transport, 0),
            _ => (WorkPhase::SettingDown, 0),
        };
        check(&bench, &cast, family, &[(Rollback, phase, passed)]);
    }
    // Also if it waits before it says so: a grasp goes on with the object in its hand.
    let waits = bent(bench.version("grasp"), Some(Bend::RollbackWaits));
    let cast = DrillVersions { version: &waits, ..bench.cast(bench.version("grasp")) };
    check(&bench, &cast, "waits", &[(Rollback, WorkPhase::Contact, 0)]);
}

/// The code's own hook was called whatever the manifest named, and a version whose hook is not there was confirmed.
#[test]
fn hook_missing_in_the_code_fails_its_drills() {
    use DrillKind::{Abort, Rollback};
    let bench = DrillBench::new();
    let named = [
        ("rollback_hook = \"rollback\"", "rollback_hook = \"retreat\""),
        ("hook = \"safe-abort\"", "hook = \"brake\""),
    ];
    let version = bench.variant("grasp", &named);
    assert!(!version.has_rollback_hook() && version.abort_secs() == 0.0);
    let own = bench.version("grasp");
    assert!(own.has_rollback_hook() && own.abort_secs() > 0.0);
    let cast = DrillVersions { version: &version, ..bench.cast(own) };
    check(&bench, &cast, "grasp", &[(Rollback, WorkPhase::Lifting, 0), (Abort, WorkPhase::Lifting, 0)]);
}

#[test]
fn a_rollback_hook_that_drops_the_object_fails() {
    use DrillKind::Rollback;
    let bench = DrillBench::new();
    for family in ["grasp", "place"] {
        let version = bent(bench.version(family), Some(Bend::RollbackDrops));
        let cast = DrillVersions { version: &version, ..bench.cast(bench.version(family)) };
        let phase = if family == "grasp" { WorkPhase::Lifting } else { WorkPhase::SettingDown };
        check(&bench, &cast, family, &[(Rollback, phase, 0)]);
    }
}

#[test]
fn a_fallback_that_cannot_take_over_the_object_fails() {
    use DrillKind::Fallback;
    let bench = DrillBench::new();
    for (family, phase) in [("grasp", WorkPhase::Lifting), ("align", WorkPhase::Transport)] {
        let opens = bent(bench.version("grasp"), Some(Bend::WorkOpens));
        let cast = DrillVersions { fallback: Some(&opens), ..bench.cast(bench.version(family)) };
        check(&bench, &cast, family, &[(Fallback, phase, 0)]);
    }
    // An align is not admitted to an empty hand.
    let cast = DrillVersions { fallback: Some(bench.version("align")), ..bench.cast(bench.version("grasp")) };
    check(&bench, &cast, "not admitted", &[(Fallback, WorkPhase::Approach, 0)]);
    let cast = DrillVersions { fallback: None, ..bench.cast(bench.version("grasp")) };
    check(&bench, &cast, "none", &[(Fallback, WorkPhase::Approach, 0)]);
}
