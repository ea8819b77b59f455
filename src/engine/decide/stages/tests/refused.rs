//! A call that the dispatcher refuses costs its version what a task that was not done costs: before its activation and
//! after.

use std::path::Path;

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_runtime::task::TaskRecord;
use holdpoint_trials::cell::Conditions;
use holdpoint_trials::episodes::{alone, pair};
use holdpoint_trials::undisturbed_run::{TrialCase, UndisturbedRun};
use holdpoint_trials::worker::Worker;

use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::listener::Listener as _;
use crate::live::shadow::Shadow;
use holdpoint_trials::past_limit::MeasuredTask;

/// The most sequences a version may fail in before it is rolled back.
const FEW: usize = 12;

/// A version whose precondition no arm of this cell ever meets.
fn never_admitted(name: &str) -> Package {
    let folder = Path::new(crate::MANIFESTS).join("candidates").join(name);
    let mut package = capability::read(&folder).unwrap();
    let stronger = package.manifest.replace("tool-height]\nmin = 0.06", "tool-height]\nmin = 5.0");
    assert_ne!(stronger, package.manifest);
    package.manifest = stronger;
    package
}

#[test]
fn a_version_whose_calls_are_refused_is_rolled_back() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let checked = Condition::CheckedCall { fields: vec!["tool-height".to_owned()] };
    let id = bench.activate_package(never_admitted("grasp-improved"), &[checked]);
    let (mut alarm_raised, mut failed, mut rollback) = (false, 0, None);
    for sequence in 0..FEW {
        bench.pipeline.advance();
        for event in bench.pipeline.drain_events() {
            match event {
                EventKind::Sequence { tasks, refused, .. } if refused.is_some() => {
                    let task = tasks.last().unwrap();
                    assert!(task.version == id && !task.success, "{task:?}");
                    failed += 1;
                }
                EventKind::Alarm { .. } => alarm_raised = true,
                EventKind::RolledBack { record, .. } => rollback = rollback.or(Some((sequence, record))),
                _ => {}
            }
        }
    }
    let (sequence, record) = rollback.expect("it is rolled back");
    assert!(alarm_raised && failed > 0, "rolled back after {sequence} sequences, {failed} refused");
    assert_eq!(record.candidate, id);
    let version_table = bench.pipeline.record().version_table();
    assert_ne!(version_table.version(&id).unwrap().1.state, State::Active);
}

#[test]
fn refusals_and_simulator_failures_degrade_the_family() {
    for lost in [TaskRecord::refused, TaskRecord::invalid] {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = "align@1.0.0".parse().unwrap();
        let live = bench.pipeline.live();
        for seed in 0..FEW as u64 {
            let done = lost(holdpoint_body::TaskKind::Align, seed);
            let task = MeasuredTask { sequence: seed, record: &done, envelope: None };
            live.health.observe(live.context, live.record, &id, task).unwrap();
        }
        let alarm = live.record.alarms().get(&AlarmKey::Degraded(id));
        assert!(alarm.is_some_and(|alarm| alarm.condition), "{alarm:?}");
    }
}

#[test]
fn sandbox_drill_and_twin_call_the_version_like_the_dispatcher() {
    let mut bench = RollbackBench::new();
    let live = bench.pipeline.live();
    let (cell, terms) = (live.context.cell.clone(), live.context.terms());
    let strict = Capability::load("test", never_admitted("align-improved")).unwrap();
    let align = live.record.active_of(&strict.id().family).unwrap();
    let mut worker = Worker::new();
    let case = |version, seed| TrialCase {
        cell: &cell,
        terms: &terms,
        version,
        conditions: Conditions::Canonical,
        seed,
    };
    let seed = 1_300_001;
    let (one, other) = (case(&strict, seed), case(&align, seed));
    let refused = TaskRecord::refused(align.bundle.task(), seed);
    assert_eq!(alone(&mut worker, one), refused);
    let worked = alone(&mut worker, other);
    assert!(worked.success);
    assert_eq!(pair(&mut worker, [one, other]), [refused.clone(), worked]);
    let mut begun = UndisturbedRun::begin(&mut worker, &one, None).unwrap();
    assert!(begun.reach(&mut worker, &one, 10).unwrap().is_none(), "no tick of it is worked");
    // The active version is always admitted where it begins: the check costs no request that the cell can meet.
    for version in holdpoint_trials::embedded::baselines().unwrap() {
        for conditions in [Conditions::Canonical, Conditions::Sandbox, Conditions::Live] {
            for seed in 1_300_000..1_300_020 {
                let trial = TrialCase { cell: &cell, terms: &terms, version: &version, conditions, seed };
                let arm = worker.arm(&cell, &trial.setup()).unwrap();
                assert!(trial.is_admitted(arm), "{} under {} on {seed}", version.id(), conditions.name());
            }
        }
    }
    // The twin of a candidate in shadow, at a task that the active version did.
    let mut world = cell.trial().unwrap();
    world.reset(&other.setup()).unwrap();
    let mut shadow = Shadow::new(strict, terms.clone(), cell.trial().unwrap());
    shadow.before_task(world.as_ref(), align.bundle.task(), seed);
    let live = TaskRecord { success: true, ..refused.clone() };
    let (trace, fork) = shadow.conclude(Some(&live), seed);
    let trace = trace.unwrap();
    assert_eq!(trace.twin, Some(refused));
    let values = trace.values.unwrap();
    assert!(values.live_success && !values.twin_success && fork.is_some());
}
