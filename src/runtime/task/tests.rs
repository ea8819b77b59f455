//! What a task does after its skill says that it is done, and that one that was left or copied goes on as it was.

use std::path::Path;
use std::sync::{Arc, Mutex};

use holdpoint_body::{Body, GuardVerdict, Interrupt, RATE_HZ};
use holdpoint_cell::{EpisodeSetup, InjectedFault};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_sim::RobotModel;
use holdpoint_sim::world::World;

use super::*;
use crate::arm::Arm;
use crate::capability::Capability;
use crate::recovery::{ROLLBACK_HOOK_TICKS, RollbackHookReport, StoppedBy};
use crate::skill::Hook;
use crate::terms::SkillTerms;

struct Done;

impl Skill for Done {
    fn tick(&mut self, _: &Observation) -> Command {
        Command::Done
    }
    fn enter(&mut self, _: Hook) {}
}

/// The simulated cell, of which the wrist tells a blow from a tick on.
struct Struck {
    world: World,
    ticks: u64,
    from: u64,
}

impl Body for Struck {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        Body::observe(&mut self.world, last)
    }
    fn telemetry(&self) -> Telemetry {
        let mut seen = Body::telemetry(&self.world);
        if self.ticks >= self.from {
            seen.contact_force_n = 400.0;
        }
        seen
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        self.ticks += 1;
        Body::step(&mut self.world, command)
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        Body::interrupt(&mut self.world, interrupt);
    }
    fn inspect(&self) -> bool {
        true
    }
}

/// Runs a skill that is done at once on a body that is struck from a tick on.
fn work(from: u64, supervise: &mut Supervisor<'_, Struck>) -> TaskRecord {
    work_with(Box::new(Done), from, supervise)
}

/// Runs a skill on a body that is struck from a tick on.
fn work_with(skill: Box<dyn Skill>, from: u64, supervise: &mut Supervisor<'_, Struck>) -> TaskRecord {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    let world = World::new(&model, &scene).unwrap();
    let terms = SkillTerms::new(&profile, table, Arc::new(model.geometry), scene.zones.into());
    let authority = holdpoint_governance::mode::Authority::ALL[0];
    let guard = terms.own_guard(authority);
    let mut arm = Arm::new(Struck { world, ticks: 0, from });
    let task = terms.task(TaskKind::Grasp, 1, 0.5);
    run(&mut arm.handle(), skill, guard, &task, supervise).unwrap()
}

#[test]
fn a_blow_after_the_last_command_violates() {
    let quiet = work(u64::MAX, &mut |_, _| Supervision::Continue);
    assert!(quiet.success && !quiet.violation, "{quiet:?}");
    let struck = work(4, &mut |_, _| Supervision::Continue);
    assert!(struck.violation && struck.recovery && !struck.success, "{struck:?}");
    assert!(struck.hits.iter().any(|(_, hit)| *hit == PolicyHit::ForceMeasured));
}

#[test]
fn measurements_while_the_arm_settles_are_recorded() {
    let record = work(4, &mut |_, _| Supervision::Continue);
    assert_eq!((record.peak_force_n, record.near), (400.0, true));
}

#[test]
fn a_supervisor_sees_and_stops_the_settling_arm() {
    let mut settling = 0;
    work(u64::MAX, &mut |_, passed| {
        settling += u64::from(passed.settling);
        Supervision::Continue
    });
    assert_eq!(settling, INSPECT_AFTER_TICKS);
    let stopped = work(u64::MAX, &mut |_, passed| {
        if passed.settling { Supervision::Abort } else { Supervision::Continue }
    });
    assert!(stopped.recovery && !stopped.success && stopped.recovered.is_some());
    assert!(stopped.time_secs < 1.0 / f64::from(RATE_HZ) * 2.0, "the task itself was over");
}

/// A shipped version at work in the cell, on the canonical start of a seed.
fn shipped(family: &str, seed: u64) -> (Arm<World>, TaskRun) {
    let version = if family.contains('/') { String::new() } else { "/1.0.0".to_owned() };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../manifests/{family}{version}"));
    let version = Capability::read(&folder).unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    let mut world = World::new(&model, &scene).unwrap();
    let task = version.bundle.task();
    world
        .reset(&EpisodeSetup::sample(task, &scene, &holdpoint_sim::published::canonical().unwrap(), seed))
        .unwrap();
    let terms = SkillTerms::new(&profile, table, Arc::new(model.geometry), scene.zones.into());
    let (guard, skill) = (terms.guard(&version.manifest.permissions), version.start(terms.bundle_seed(seed)));
    let terms = terms.task(task, seed, version.abort_secs());
    (Arm::new(world), TaskRun::new(skill, guard, terms))
}

/// Aborts the task in a tick of it, as a person might; 0 for never.
fn stopping_at(at: u64) -> impl FnMut(&mut ActuatorHandle<'_, World>, &Tick<'_>) -> Supervision {
    move |_, passed| if passed.tick == at { Supervision::Abort } else { Supervision::Continue }
}

#[test]
fn copy_after_any_tick_has_the_same_result_bit_for_bit() {
    const SEED: u64 = 1_200_003;
    for (family, stop_at) in [("grasp", 0), ("align", 0), ("place", 0), ("grasp", 333), ("align", 90)] {
        let (mut arm, run) = shipped(family, SEED);
        let expected = run.finish(&mut arm.handle(), &mut stopping_at(stop_at)).unwrap();
        let hash = arm.body().state_hash();
        assert_eq!(expected.success, stop_at == 0, "{family}: {expected:?}");
        let (mut arm, mut run) = shipped(family, SEED);
        let (mut other, _) = shipped("align", SEED + 1);
        let (mut stages, mut ticks) = (Vec::new(), 0);
        while run.stage() != TaskStage::Over {
            // Every 47th tick of the work, and all of what comes after it.
            if ticks % 47 == 0 || run.stage() != TaskStage::Working {
                stages.push(run.stage());
                let copy = run.fork().unwrap();
                other.body_mut().go_on_from(&arm.body().copy()).unwrap();
                let record = copy.finish(&mut other.handle(), &mut stopping_at(stop_at)).unwrap();
                assert_eq!(record, expected, "{family} after {ticks} ticks");
                assert_eq!(other.body().state_hash(), hash, "{family} after {ticks} ticks");
            }
            run.tick(&mut arm.handle(), &mut stopping_at(stop_at)).unwrap();
            ticks += 1;
        }
        assert_eq!(*run.record(), expected);
        let last = if stop_at == 0 { TaskStage::Settling } else { TaskStage::Recovering };
        assert!(stages.contains(&TaskStage::Working) && stages.contains(&last), "{family}: {stages:?}");
    }
}

#[test]
fn a_run_of_an_uncopyable_skill_has_no_copy() {
    let (_, run) = shipped("align", 1);
    assert!(run.fork().is_some());
    let guard = run.into_parts().1;
    let terms = TaskTerms {
        task: TaskKind::Grasp,
        seed: 1,
        watch: WatchLimits::default(),
        abort_secs: 0.5,
        limit_ticks: 10,
    };
    assert!(TaskRun::new(Box::new(Done), guard, terms).fork().is_none());
}

/// Two versions on one body until they part, and each on from there.
fn together(families: [&str; 2], seed: u64) -> ([TaskRecord; 2], u64) {
    let (mut arm, mut first) = shipped(families[0], seed);
    let (mut other, mut second) = shipped(families[1], seed);
    TaskRun::run_together(&mut arm.handle(), &mut first, &mut second).unwrap();
    let shared = arm.body().tick();
    other.body_mut().go_on_from(&arm.body().copy()).unwrap();
    let mut go_on = |_: &mut ActuatorHandle<'_, World>, _: &Tick<'_>| Supervision::Continue;
    let one = first.finish(&mut arm.handle(), &mut go_on).unwrap();
    ([one, second.finish(&mut other.handle(), &mut go_on).unwrap()], shared)
}

#[test]
fn two_tasks_share_a_world_until_they_differ() {
    for (families, least, most) in [
        (["align", "align"], 300, u64::MAX),
        (["align", "candidates/align-improved"], 8, 300),
        (["grasp", "candidates/grasp-hard-grip"], 0, 300),
    ] {
        let (records, shared) = together(families, 1_200_004);
        assert!((least..most).contains(&shared), "{families:?} shared {shared} ticks");
        for (family, record) in families.iter().zip(&records) {
            let (mut arm, run) = shipped(family, 1_200_004);
            let alone = run.finish(&mut arm.handle(), &mut |_, _| Supervision::Continue).unwrap();
            assert_eq!(*record, alone, "{family}");
        }
    }
}

fn guard() -> Guard {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    SkillTerms::new(&profile, table, Arc::new(model.geometry), scene.zones.into())
        .own_guard(holdpoint_governance::mode::Authority::ALL[0])
}

#[test]
fn a_persons_stop_is_an_intervention_and_a_monitors_is_not() {
    for (asked, intervention) in [(Supervision::StepIn, true), (Supervision::Abort, false)] {
        for settling in [false, true] {
            let record = work(u64::MAX, &mut |_, passed| {
                if passed.settling == settling { asked } else { Supervision::Continue }
            });
            assert!(record.recovery, "{asked:?}");
            assert_eq!(record.intervention, intervention, "{asked:?}");
            assert_eq!(record.values().unwrap().intervention, intervention);
        }
    }
}

#[test]
fn harm_of_a_task_that_a_person_stops_ends_with_the_stop() {
    // The blow comes as the arm stops, which is the version's conduct after a monitor's stop alone.
    let peak_n = |asked: Supervision| work(2, &mut |_, _| asked).harm.unwrap().contact_peak_n;
    assert_eq!(peak_n(Supervision::Abort), 400.0);
    assert!(peak_n(Supervision::StepIn) < 400.0);
}

#[test]
fn motion_after_a_stop_beyond_the_limit_is_a_violation() {
    let guard = guard();
    let limit_ticks = guard.envelope().unsafe_continuation_max_ms * u64::from(RATE_HZ) / 1000;
    for (motion_ticks, violation) in [(limit_ticks, false), (limit_ticks + 1, true)] {
        let mut record = TaskRecord { invalid: false, ..TaskRecord::invalid(TaskKind::Grasp, 1) };
        note_continuation(&mut record, &guard, motion_ticks, 9);
        assert_eq!(record.values().unwrap().violation, violation, "{motion_ticks}");
    }
}

#[test]
fn timeout_is_an_anomaly() {
    let watcher = Watcher::new(TaskKind::Grasp, WatchLimits::default());
    for timeout in [false, true] {
        let mut record = TaskRecord { timeout, ..TaskRecord::invalid(TaskKind::Grasp, 1) };
        close(
            &mut record,
            &watcher,
            &AttemptCounter::new(TaskKind::Grasp, WatchLimits::default().width_step_m),
            (&guard(), ConfinementReport::default()),
            9,
        );
        assert_eq!(record.anomaly, timeout);
    }
}

/// A shipped version whose confined code fails in a tick of its work, or in the first of its hook.
struct Failing {
    inner: Box<dyn Skill>,
    fault: CodeFault,
    /// Ticks it still answers.
    left: u64,
    in_hook: bool,
    failed: bool,
}

impl Skill for Failing {
    fn tick(&mut self, seen: &Observation) -> Command {
        self.failed |= self.left == 0;
        self.left = self.left.saturating_sub(1);
        if self.failed { Command::Hold } else { self.inner.tick(seen) }
    }
    fn enter(&mut self, hook: Hook) {
        self.failed |= self.in_hook;
        self.inner.enter(hook);
    }
    fn confined(&self) -> ConfinementReport {
        ConfinementReport { fuel_tick_max: 7, memory_bytes: 9, fault: self.failed.then_some(self.fault) }
    }
}

/// Works a grasp whose code fails so, with an abort in a tick; 0 for none.
fn failing(fault: CodeFault, left: u64, in_hook: bool, stop_at: u64) -> Result<TaskRecord, BodyError> {
    let (mut arm, mut run) = shipped("grasp", 1_200_003);
    run.replace_skill(|inner| Box::new(Failing { inner, fault, left, in_hook, failed: false }));
    run.finish(&mut arm.handle(), &mut stopping_at(stop_at))
}

#[test]
fn failing_code_ends_the_task_and_the_runtime_stops_the_arm() {
    for (fault, overdraws) in [
        (CodeFault::Trap, false),
        (CodeFault::Answer, false),
        (CodeFault::Fuel, true),
        (CodeFault::Memory, true),
    ] {
        let record = failing(fault, 200, false, 0).unwrap();
        assert_eq!(record.fault, Some(fault));
        assert!(!record.success && record.anomaly && record.recovery && !record.invalid, "{record:?}");
        assert_eq!(record.violation, overdraws, "{fault:?}: {:?}", record.hits);
        let report = record.recovered.unwrap();
        assert_eq!(report.stopped_by, StoppedBy::Interrupt, "no hook of it is believed");
        assert_eq!(record.used.faults.get(&fault), Some(&1));
        assert_eq!((record.used.fuel_tick_max, record.used.memory_max_bytes), (7, 9));
    }
}

#[test]
fn code_that_fails_in_its_hook_is_stopped_by_an_interrupt() {
    let record = failing(CodeFault::Trap, u64::MAX, true, 333).unwrap();
    assert_eq!(record.fault, Some(CodeFault::Trap));
    assert_eq!(record.recovered.unwrap().stopped_by, StoppedBy::Interrupt);
    let sound = failing(CodeFault::Trap, u64::MAX, false, 333).unwrap();
    assert_eq!((sound.fault, sound.recovered.unwrap().stopped_by), (None, StoppedBy::Hook));
}

#[test]
fn a_recovery_without_a_standstill_is_reported_as_long_as_it_was() {
    let (mut arm, mut run) = shipped("grasp", 1_200_003);
    run.replace_skill(|inner| {
        Box::new(Failing { inner, fault: CodeFault::Trap, left: 200, in_hook: false, failed: false })
    });
    while run.stage() == TaskStage::Working {
        run.tick(&mut arm.handle(), &mut stopping_at(0)).unwrap();
    }
    assert_eq!(run.stage(), TaskStage::Recovering, "its code failed");
    arm.body_mut().inject(InjectedFault::JointRunaway { joint: 0 });
    let mut ticks = 0;
    while run.stage() != TaskStage::Over {
        run.tick(&mut arm.handle(), &mut stopping_at(0)).unwrap();
        ticks += 1;
    }
    let report = run.record().recovered.unwrap();
    assert_eq!((report.stopped_by, report.ticks_to_standstill), (StoppedBy::Nothing, ticks));
}

#[test]
fn no_code_of_the_version_is_called_after_an_interrupt() {
    let (mut arm, mut run) = shipped("grasp", 1_200_003);
    // One more call would fail, of the hook or of a tick.
    run.replace_skill(|inner| {
        Box::new(Failing { inner, fault: CodeFault::Trap, left: 333, in_hook: true, failed: false })
    });
    let mut interrupt = |_: &mut ActuatorHandle<'_, World>, passed: &Tick<'_>| {
        if passed.tick == 333 { Supervision::Interrupt } else { Supervision::Continue }
    };
    let record = run.finish(&mut arm.handle(), &mut interrupt).unwrap();
    assert_eq!(
        (record.recovery, record.success, record.intervention, record.fault),
        (true, false, false, None)
    );
    let report = record.recovered.unwrap();
    assert_eq!((report.stopped_by, report.violation), (StoppedBy::Interrupt, None));
    assert!(report.ticks_to_standstill < u64::from(RATE_HZ) / 2, "{report:?}");
    assert!(arm.body().stop_declared().is_some(), "the body was interrupted");
}

#[test]
fn a_stalled_machine_is_no_fault_of_the_code() {
    let error = failing(CodeFault::Machine, 200, false, 0).unwrap_err();
    assert!(matches!(error, BodyError::Failed(_)), "{error:?}");
}

#[test]
fn earliest_event_is_the_cause_of_a_failed_task() {
    use super::{FailureCause as Cause, PolicyHit, RaisedSignal, TaskRecord, WatcherSignal};
    use holdpoint_body::{FailureSignal, TaskKind};

    let failed = || TaskRecord { invalid: false, ..TaskRecord::invalid(TaskKind::Grasp, 1) };
    let raised = |signal, tick| RaisedSignal { signal, tick };
    assert_eq!(TaskRecord { success: true, ..failed() }.failure_cause(), None);
    assert_eq!(failed().failure_cause(), Some(Cause::Missed), "nothing was raised, and it does not hold");
    assert_eq!(TaskRecord { intervention: true, ..failed() }.failure_cause(), None, "a person ended it");
    assert_eq!(TaskRecord::refused(TaskKind::Grasp, 1).failure_cause(), Some(Cause::Refused));
    let declared = TaskRecord { declared: Some(FailureSignal::ObjectSlipped), ..failed() };
    assert_eq!(declared.failure_cause(), Some(Cause::Slipped));
    let late = TaskRecord { timeout: true, signals: vec![raised(WatcherSignal::Overrun, 900)], ..failed() };
    assert_eq!(late.failure_cause(), Some(Cause::Late));
    let dropped = TaskRecord { signals: vec![raised(WatcherSignal::ObjectLost, 300)], ..declared.clone() };
    assert_eq!(dropped.failure_cause(), Some(Cause::Dropped), "the watcher goes before the skill's own word");
    let pressed = TaskRecord { hits: vec![(200, PolicyHit::ForceMeasured)], ..dropped };
    assert_eq!(pressed.failure_cause(), Some(Cause::Pressed), "the earlier event decides");
}

/// Stands still, and in its rollback hook is done at once or never.
struct Standing {
    entered: Arc<Mutex<Vec<Hook>>>,
    hands_over: bool,
}

impl Skill for Standing {
    fn tick(&mut self, _: &Observation) -> Command {
        match self.entered.lock().unwrap().last() {
            Some(Hook::Rollback) if self.hands_over => Command::Done,
            Some(Hook::SafeAbort) => Command::Stop,
            _ => Command::Hold,
        }
    }
    fn enter(&mut self, hook: Hook) {
        self.entered.lock().unwrap().push(hook);
    }
}

/// Stops a standing skill in its tenth tick so, on a body that is struck from a tick on. Also returns the hooks entered.
fn stopped(hands_over: bool, from: u64, called: Supervision) -> (TaskRecord, Vec<Hook>) {
    let entered = Arc::new(Mutex::new(Vec::new()));
    let skill = Standing { entered: Arc::clone(&entered), hands_over };
    let record = work_with(Box::new(skill), from, &mut |_, passed| {
        if passed.tick == 10 { called } else { Supervision::Continue }
    });
    let hooks = entered.lock().unwrap().clone();
    (record, hooks)
}

#[test]
fn a_planned_rollback_calls_the_rollback_hook_first() {
    let (record, hooks) = stopped(true, u64::MAX, Supervision::RollBack);
    let report = record.recovered.unwrap();
    assert_eq!((report.stopped_by, hooks), (StoppedBy::RollbackHook, vec![Hook::Rollback]));
    assert!(report.ticks_to_standstill < u64::from(RATE_HZ) / 2 && !record.violation, "{report:?}");
    assert_eq!(stopped(true, u64::MAX, Supervision::Abort).1, [Hook::SafeAbort]);
}

#[test]
fn the_standstill_of_an_arm_at_rest_begins_with_the_demand() {
    let ticks = |called| stopped(true, u64::MAX, called).0.recovered.unwrap().ticks_to_standstill;
    for called in [Supervision::Abort, Supervision::RollBack, Supervision::Interrupt] {
        // The recovery itself takes longer.
        assert!(ticks(called) < 12, "{called:?}");
    }
}

#[test]
fn a_rollback_hook_that_never_ends_falls_to_the_safe_abort_hook() {
    let (record, hooks) = stopped(false, u64::MAX, Supervision::RollBack);
    let report = record.recovered.unwrap();
    assert_eq!((report.stopped_by, hooks), (StoppedBy::Hook, vec![Hook::Rollback, Hook::SafeAbort]));
    let given_up = RollbackHookReport { ticks: ROLLBACK_HOOK_TICKS, then_safe_abort: true };
    assert_eq!(report.rollback_hook, Some(given_up));
    let after = report.ticks_to_standstill - ROLLBACK_HOOK_TICKS;
    assert!(after < u64::from(RATE_HZ) / 2 && !record.violation, "{report:?}");
}

#[test]
fn a_limit_passed_in_the_rollback_hook_ends_the_control_of_the_code() {
    let (record, hooks) = stopped(false, 30, Supervision::RollBack);
    let report = record.recovered.unwrap();
    assert_eq!((report.stopped_by, hooks), (StoppedBy::Interrupt, vec![Hook::Rollback]));
    assert_eq!(report.violation, Some(PolicyHit::ForceMeasured));
    assert!(report.ticks_to_standstill < u64::from(RATE_HZ) / 2, "{report:?}");
    assert!(report.rollback_hook.is_some_and(|hook| !hook.then_safe_abort && hook.ticks < 30), "{report:?}");
}

#[test]
fn no_hook_is_entered_after_an_interrupt() {
    let (record, hooks) = stopped(true, u64::MAX, Supervision::Interrupt);
    assert_eq!((record.recovered.unwrap().stopped_by, hooks), (StoppedBy::Interrupt, Vec::new()));
}
