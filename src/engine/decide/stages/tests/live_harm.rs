//! Harm of live tasks: what counts for life, and what a danger does to a new version and to a commissioned one.

use holdpoint_body::TaskKind;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, State};
use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::past_limit::LimitedQuantity;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::{PostStatus, RollbackRecord, RungFailure, TriggerKind};
use holdpoint_governance::shared_event::StoppingEvent;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::AuditFilter;

use crate::decide::stages::live_harm::recorded_reasons;
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::listener::NoListener;
use crate::live::sequence::StoppedTask;
use holdpoint_record::version_table::TransitionNote;

fn id(version: &str) -> CapabilityId {
    version.parse().unwrap()
}

fn sim() -> Profile {
    Profile::builtin(ProfileName::Sim).unwrap()
}

/// Runs sequences until an event fits.
fn until<T>(bench: &mut RollbackBench, fits: impl Fn(&EventKind) -> Option<T>) -> T {
    for _ in 0..60 {
        bench.pipeline.live().sequence(None).unwrap();
        let events = bench.pipeline.drain_events();
        if let Some(found) = events.iter().find_map(&fits) {
            return found;
        }
    }
    panic!("no event fits");
}

fn rollback_of(version: &CapabilityId) -> impl Fn(&EventKind) -> Option<RollbackRecord> {
    move |event| match event {
        EventKind::RolledBack { version: of, record, .. } if of == version => Some((**record).clone()),
        _ => None,
    }
}

/// Every task is near enough to a person's zone to be a danger, by either version.
fn always_in_danger() -> RollbackBench {
    let mut profile = sim();
    profile.harm.zone_clearance_m.limit = 2.0;
    profile.live_harm.danger_zone_clearance_m = 2.0;
    RollbackBench::under(profile)
}

#[test]
fn danger_alarms_for_a_commissioned_version_and_rolls_a_new_one_back() {
    let mut bench = always_in_danger();
    let before = id("place@1.0.0");
    let past = until(&mut bench, |event| match event {
        EventKind::HarmPastLimit { version, past, danger: true, tasks_past: 1, .. } if *version == before => {
            Some(past.clone())
        }
        _ => None,
    });
    let clearance = past.iter().find(|past| past.measure == HarmKind::ZoneClearance).unwrap();
    assert!(clearance.value < 2.0 && clearance.limit == 2.0 && clearance.unit == "m", "{clearance:?}");
    let record = bench.pipeline.record();
    assert_eq!(record.active_of(&before.family).map(|active| active.id()), Some(before.clone()));
    assert!(record.alarms().get(&AlarmKey::Harm(before.clone())).is_some(), "{:?}", record.alarms());
    let new = bench.activate("place-refined");
    let rollback = until(&mut bench, rollback_of(&new));
    assert_eq!(rollback.trigger.kind, TriggerKind::SafetyEvent);
    // The rollback target is a danger in a fork of the same task.
    assert_eq!(rollback.post_status, PostStatus::Demoted);
    assert_eq!(rollback.shared.map(|shared| shared.event), Some(StoppingEvent::Safety(SafetyEvent::Danger)));
    assert!(bench.pipeline.record().alarms().get(&AlarmKey::SharedEvent(before)).is_some());
}

/// It was not counted, though it was measured before the person cut the task short.
#[test]
fn danger_in_a_task_that_a_person_cut_short_is_an_event() {
    let mut bench = always_in_danger();
    let mut live = bench.pipeline.live();
    let mut worked = live.begin_sequence().unwrap().run(&mut NoListener);
    worked.stopped = Some(StoppedTask::here(&worked.report, 0));
    let cut = live.end_sequence(worked).unwrap().tasks.last().unwrap().id.clone();
    assert_eq!(live.live_harm.lived(&cut).tasks, 0, "no part of a task counts for a rate");
    let is_danger = |event: &EventKind| matches!(event, EventKind::HarmPastLimit { version, danger: true, .. } if *version == cut);
    assert!(bench.pipeline.drain_events().iter().any(is_danger));
    let filter = AuditFilter { subject: Some(cut.to_string()), ..AuditFilter::newest(RecordKind::LiveHarm) };
    let records = bench.pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap();
    assert!(!recorded_reasons(&records[0].body).is_empty(), "the next engine finds it");
    assert!(bench.pipeline.record().alarms().get(&AlarmKey::Harm(cut)).is_some());
}

/// Each grasp touches faster than allowed and is recorded. Aligning touches nothing, and its tasks are in telemetry alone.
#[test]
fn counts_continue_after_a_restart() {
    let mut profile = sim();
    profile.harm.touch_speed_m_s.limit = 0.01;
    let mut bench = RollbackBench::under(profile.clone());
    for _ in 0..4 {
        bench.pipeline.live().sequence(None).unwrap();
    }
    let (grasp, align) = (id("grasp@1.0.0"), id("align@1.0.0"));
    let counts =
        |bench: &mut RollbackBench| [&grasp, &align].map(|id| bench.pipeline.live().live_harm.lived(id));
    let before = counts(&mut bench);
    assert_eq!((before[0].tasks, before[0].any), (4, 4), "{before:?}");
    assert!(before[1].tasks > 0 && before[1].any < before[1].tasks, "{before:?}");
    let filter = AuditFilter {
        kind: Some(RecordKind::LiveHarm),
        subject: Some(grasp.to_string()),
        ..AuditFilter::default()
    };
    let views = bench.pipeline.record().version_table().store().views().unwrap();
    let records = views.audit(&filter).unwrap();
    drop(views);
    assert_eq!(records.len(), 4);
    let newest: serde_json::Value = serde_json::from_str(&records[3].body).unwrap();
    assert_eq!(newest["harm"]["lived"]["past"]["touch-speed"], 4);
    let mut bench = bench.reopened(profile);
    assert_eq!(counts(&mut bench), before);
    bench.pipeline.live().sequence(None).unwrap();
    assert_eq!(counts(&mut bench)[0].tasks, 5);
    // Under other limits the same tasks are counted again.
    let mut bench = bench.reopened(sim());
    let after = counts(&mut bench);
    assert!(after[0].tasks == 5 && after[0].any < 5, "{after:?}");
}

/// Closing the hand passes the limit of this profile.
#[test]
fn a_violated_limit_is_told_by_value_limit_and_sequence() {
    let mut profile = sim();
    profile.runtime.contact_force_max_n = 1.0;
    let mut bench = RollbackBench::under(profile);
    let grasp = id("grasp@1.0.0");
    let (sequence, past) = until(&mut bench, |event| match event {
        EventKind::Sequence { index, tasks, .. } => {
            let violated = tasks.iter().find(|task| task.version == grasp && task.violation)?;
            Some((*index, violated.past))
        }
        _ => None,
    });
    let past = past.expect("a force was measured");
    assert_eq!((past.quantity, past.limit), (LimitedQuantity::Force, 1.0));
    assert!(past.value > 1.0, "{past:?}");
    let alarm = bench.pipeline.record().alarms().get(&AlarmKey::Violation(grasp.clone())).unwrap();
    let Some(Notice::LimitViolated { version, measured: Some(measured), .. }) = alarm.text.notice() else {
        panic!("{alarm:?}")
    };
    assert_eq!((version, measured.sequence, measured.past), (&grasp, sequence, Some(past)));
}

/// No monitor watches a version whose window had passed before the start.
#[test]
fn confirmed_version_is_rolled_back_for_a_safety_event_after_a_restart() {
    // It flies low, among the live cell's clutter.
    let (mut bench, version) = RollbackBench::with_active("align-low-transit");
    let reference = bench.pipeline.record().version_table().version(&version).unwrap().0;
    let note = TransitionNote::because(Notice::StageBegins);
    let confirm = LifecycleEvent::Confirm { version: reference };
    bench.pipeline.live().record.transition(&version.family, confirm, note).unwrap();
    let mut bench = bench.restart();
    assert!(bench.pipeline.live().monitors.of(&version).is_none());
    let rollback = until(&mut bench, rollback_of(&version));
    assert_eq!((rollback.trigger.kind, rollback.in_flight), (TriggerKind::SafetyEvent, false));
    assert_eq!(rollback.trigger.measured.map(|measured| measured.task), Some(TaskKind::Align));
    let state = bench.pipeline.record().version_table().version(&version).unwrap().1.state;
    assert_eq!(state, State::RolledBack);
}

#[test]
fn rollback_target_that_is_no_safer_is_recorded() {
    let mut bench = RollbackBench::under(sim());
    let before = bench.activate("align-low-transit");
    let version = bench.pipeline.record().version_table().version(&before).unwrap().0;
    let confirm = LifecycleEvent::Confirm { version };
    let note = TransitionNote::because(Notice::StageBegins);
    bench.pipeline.live().record.transition(&before.family, confirm, note).unwrap();
    let id = bench.activate("align-improved");
    let operation = Operation { version: id.clone(), by: "ann".to_owned(), reason: "drill".to_owned() };
    assert!(matches!(bench.pipeline.command(Command::Rollback(operation)), Reply::Accepted { .. }));
    let events = bench.pipeline.drain_events();
    let record_of = |id: &CapabilityId| {
        let mut ends = events.iter().filter_map(|event| match event {
            EventKind::RolledBack { version, record, .. } if version == id => Some((**record).clone()),
            _ => None,
        });
        ends.next().expect("an event reports the rollback")
    };
    let record = record_of(&id);
    assert_eq!(record.recovered, Some(false), "{:?}", record.rungs);
    assert_eq!(record.rungs.last().unwrap().failure, Some(RungFailure::NotRecovered));
    // The target is a danger in its first task, and is rolled back in turn.
    assert_eq!(record_of(&before).trigger.kind, TriggerKind::SafetyEvent);
    let active = bench.pipeline.record().active_of(&id.family).unwrap();
    assert_eq!(active.id().to_string(), "align@1.0.0");
}
