//! An event that stops a version: where the version compared with has the same, it speaks against neither. A live event
//! without a comparison is not final.

use std::path::Path;

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, Stage, State};
use holdpoint_governance::monitor::{MonitorDecision, Rate, SafetyEvent, roll_back, safety_trip};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::rollback::{PostStatus, RollbackRecord, Rung, TriggerKind};
use holdpoint_governance::shared_event::{SceneKind, StoppingEvent, UncomparedReason};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::{self, Capability};

use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::monitoring::tell_monitor;
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::decide::stages::rollback::{begin, trigger};
use crate::live::listener::NoListener;
use holdpoint_record::version_table::TransitionNote;

/// A version under the next number, with nothing else changed.
fn renumbered(folder: &str, from: &str, to: &str) -> Package {
    let mut package = capability::read(&Path::new(crate::MANIFESTS).join(folder)).unwrap();
    package.manifest = package.manifest.replacen(from, to, 1);
    package
}

/// Confirms an activated version without its window.
fn confirm(bench: &mut RollbackBench, id: &CapabilityId) {
    let version = bench.pipeline.record().version_table().version(id).unwrap().0;
    let note = TransitionNote::because(Notice::StageBegins);
    let live = bench.pipeline.live();
    live.record.transition(&id.family, LifecycleEvent::Confirm { version }, note).unwrap();
}

/// Runs until a version is rolled back.
pub(super) fn rollback_of(bench: &mut RollbackBench, id: &CapabilityId) -> RollbackRecord {
    for _ in 0..60 {
        for event in bench.pipeline.drain_events() {
            if let EventKind::RolledBack { version, record, .. } = event
                && version == *id
            {
                return *record;
            }
        }
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
    }
    panic!("{id} was not rolled back");
}

/// Whether a person can have a version evaluated again.
pub(super) fn may_retry(bench: &mut RollbackBench, id: &CapabilityId) -> bool {
    let operation = Operation { version: id.clone(), by: "ann".to_owned(), reason: "again".to_owned() };
    let repeat = Command::Repeat { operation, stage: Stage::Sandbox };
    matches!(bench.pipeline.command(repeat), Reply::Accepted { .. })
}

#[test]
fn version_whose_rollback_target_has_the_same_event_is_demoted() {
    // It flies low, among the live cell's clutter.
    let (mut bench, before) = RollbackBench::with_active("align-low-transit");
    confirm(&mut bench, &before);
    let again = renumbered("candidates/align-low-transit", "1.1.1", "1.1.2");
    let id = bench.activate_package(again, &[]);
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.trigger.kind, record.post_status), (TriggerKind::SafetyEvent, PostStatus::Demoted));
    assert!(record.time_to_safe_ticks.is_some(), "the arm is made safe first");
    let shared = record.shared.unwrap();
    assert_eq!(shared.scene, SceneKind::Live);
    assert_eq!(Some(shared.event), record.trigger.event.map(StoppingEvent::Safety));
    let version_table = bench.pipeline.record().version_table();
    assert_eq!(version_table.version(&id).unwrap().1.state, State::Demoted);
    let alarm = bench.pipeline.record().alarms().get(&AlarmKey::SharedEvent(before));
    assert!(alarm.is_some(), "{:?}", bench.pipeline.record().alarms());
    assert!(may_retry(&mut bench, &id), "a shared event is not final");
}

#[test]
fn version_whose_rollback_target_is_safe_in_the_same_task_is_rolled_back() {
    let (mut bench, id) = RollbackBench::with_active("align-low-transit");
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.post_status, record.shared), (PostStatus::RolledBack, None));
    assert_eq!(bench.pipeline.record().version_table().version(&id).unwrap().1.state, State::RolledBack);
    assert!(!may_retry(&mut bench, &id), "an event of its own is final");
}

#[test]
fn version_is_on_hold_where_its_rollback_target_is_not_compared() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    // No state at the start of a task comes with it.
    let cause = trigger(bench.pipeline.record(), TriggerKind::SafetyEvent, Notice::StageBegins);
    bench.pipeline.live().deactivate(&id, cause, None, DeactivationKind::RolledBack).unwrap();
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.post_status, record.shared), (PostStatus::Demoted, None));
    assert_eq!(record.uncompared, Some(UncomparedReason::NoStart));
    let version_table = bench.pipeline.record().version_table();
    assert_eq!(version_table.version(&id).unwrap().1.state, State::Demoted);
    let active = bench.pipeline.record().active_of(&id.family).map(|active| active.id());
    assert_eq!(active, record.predecessor, "the rollback target has control");
    assert!(may_retry(&mut bench, &id), "an event without a difference is not final");
}

/// Begins a rollback by the monitor, or as an older build did for a person. Ends the engine in the ladder, and starts the next
/// one.
fn interrupted(mut bench: RollbackBench, id: &CapabilityId, by: Option<&MonitorDecision>) -> RollbackBench {
    let version = bench.pipeline.record().version_table().version(id).unwrap().0;
    let live = bench.pipeline.live();
    if let Some(decision) = by {
        tell_monitor(live.record, id, decision.action, &decision.reasons).unwrap();
    }
    let note = TransitionNote::because(Notice::StageBegins);
    live.record.transition(&id.family, LifecycleEvent::BeginRollback { version }, note).unwrap();
    bench.restart()
}

#[test]
fn interrupted_rollback_is_final_only_for_a_recorded_decision_on_the_conduct() {
    let event = safety_trip(SafetyEvent::ForceLimit, 0);
    let found = |finding| roll_back(vec![Reason::new(Dimension::Monitor, finding)], 0);
    let rate = found(Finding::RateWorse { rate: Rate::Failure });
    let silence = found(Finding::EscalationUnanswered);
    for (by, kind, status, uncompared) in [
        (Some(&event), TriggerKind::SafetyEvent, PostStatus::Demoted, Some(UncomparedReason::Interrupted)),
        (Some(&rate), TriggerKind::Restart, PostStatus::Demoted, Some(UncomparedReason::Interrupted)),
        (Some(&silence), TriggerKind::Restart, PostStatus::RolledBack, None),
        (None, TriggerKind::Restart, PostStatus::Demoted, None),
    ] {
        let (bench, id) = RollbackBench::resting_with_active("align-improved");
        let mut bench = interrupted(bench, &id, by);
        let record = rollback_of(&mut bench, &id);
        assert_eq!((record.trigger.kind, record.post_status, record.uncompared), (kind, status, uncompared));
        assert_eq!(may_retry(&mut bench, &id), status == PostStatus::Demoted);
    }
}

/// It became a demotion, after which the version could be tried again.
#[test]
fn interrupted_rollback_of_a_person_ends_as_the_person_decided() {
    for (leave, status) in [
        (DeactivationKind::RolledBack, PostStatus::RolledBack),
        (DeactivationKind::Demoted, PostStatus::Demoted),
    ] {
        let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
        let text = Notice::OperatorRollback { by: "ann".to_owned(), reason: "drill".to_owned() };
        let live = bench.pipeline.live();
        let cause = trigger(live.record, TriggerKind::Operator, text.clone());
        begin(live.record, &id, &cause, leave).unwrap();
        let mut bench = bench.restart();
        let record = rollback_of(&mut bench, &id);
        assert_eq!((record.trigger.kind, record.post_status), (TriggerKind::Operator, status));
        assert_eq!(record.trigger.text, NoticeOrText::from(text));
        let by_version = [Rung::RollbackHook, Rung::SafeAbort];
        assert!(
            !record.rungs.iter().any(|rung| by_version.contains(&rung.rung)),
            "no code of it moves the arm"
        );
        assert_eq!(may_retry(&mut bench, &id), status == PostStatus::Demoted);
    }
}

#[test]
fn safety_event_of_an_earlier_activation_did_not_begin_an_interrupted_rollback() {
    let mut bench = RollbackBench::new();
    let id = bench.pass("align-improved", &Stage::ALL);
    let earlier = safety_trip(SafetyEvent::ForceLimit, 0);
    tell_monitor(bench.pipeline.live().record, &id, earlier.action, &earlier.reasons).unwrap();
    bench.enter(&id, |version| LifecycleEvent::Activate { version });
    let mut bench = interrupted(bench, &id, None);
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.trigger.kind, record.post_status), (TriggerKind::Restart, PostStatus::Demoted));
}

/// Flags that changed while the rollback was pending once hid the event that began it.
#[test]
fn flags_that_change_during_a_rollback_do_not_hide_what_began_it() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
    let event = safety_trip(SafetyEvent::ForceLimit, 0);
    let live = bench.pipeline.live();
    tell_monitor(live.record, &id, event.action, &event.reasons).unwrap();
    for event in [LifecycleEvent::BeginRollback { version }, LifecycleEvent::Pause { version }] {
        let note = TransitionNote::because(Notice::StageBegins);
        live.record.transition(&id.family, event, note).unwrap();
    }
    let mut bench = bench.restart();
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.trigger.kind, record.post_status), (TriggerKind::SafetyEvent, PostStatus::Demoted));
}

/// A task with a refused start is not in the report of its sequence.
#[test]
fn decision_of_a_monitor_counts_without_its_task_in_the_report() {
    // It flies low, among the live cell's clutter.
    let (mut bench, id) = RollbackBench::with_active("align-low-transit");
    for _ in 0..40 {
        let mut live = bench.pipeline.live();
        let mut worked = live.begin_sequence().unwrap().run(&mut NoListener);
        worked.report.tasks.retain(|done| done.id != id);
        live.end_sequence(worked).unwrap();
        let state = bench.pipeline.record().version_table().version(&id).unwrap().1.state;
        if state != State::Active {
            assert_eq!(state, State::Demoted, "no task shows a difference");
            return;
        }
    }
    panic!("{id} is still active");
}

/// Regression: on this run seed, a person reaches onto the arm in one of the episodes under stress, and the commissioned
/// version under another number was rejected for it.
#[test]
fn commissioned_version_is_not_rejected_for_a_person_who_reaches_onto_the_arm() {
    let mut bench = RollbackBench::seeded(55);
    let package = renumbered("grasp/1.0.0", "1.0.0", "1.0.1");
    let id = Capability::load("test", package.clone()).unwrap().id();
    let reply = bench.pipeline.command(Command::Register { package, name: "again".to_owned(), by: None });
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    for _ in 0..60 {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        let evidence_file = bench.pipeline.live().evidence_files.of(&id).cloned().unwrap_or_default();
        if evidence_file.modes.len() == 2 {
            assert!(evidence_file.hard_stops.is_empty(), "{:?}", evidence_file.hard_stops);
            assert_eq!(evidence_file.unsafe_under_stress, 0, "the commissioned version does the same");
            return;
        }
    }
    panic!("the modes did not run");
}
