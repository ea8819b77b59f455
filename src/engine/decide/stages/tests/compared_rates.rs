//! Rates that roll a version back: only where the rollback target does better in forks of the same tasks it is for good.

use std::sync::Arc;

use holdpoint_body::TaskKind;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, State};
use holdpoint_governance::monitor::{MonitorAction, Rate, RateTally};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rollback::{PostStatus, RollbackRecord, Trigger, TriggerKind};
use holdpoint_governance::shared_event::UncomparedReason;

use super::shared_events::{may_retry, rollback_of};
use crate::decide::stages::rollback::tests::{GOOD, RollbackBench};
use crate::decide::stages::rollback::trigger;
use crate::live::fake_cell::StubFactory;
use crate::live::monitors::{ActivationMonitor, MonitoredTask};

const FAILED: EpisodeValues = EpisodeValues { success: false, ..GOOD };

/// Has the monitor of a version keep as many grasps with these values, with the state at their start or without.
fn keep(bench: &mut RollbackBench, id: &CapabilityId, count: u64, values: EpisodeValues, has_start: bool) {
    let live = bench.pipeline.live();
    let cell = live.context.cell.live_cell().unwrap();
    let start = has_start.then(|| Arc::new(cell.copy().unwrap()));
    for seed in 0..count {
        let task =
            MonitoredTask { start: start.clone(), task: TaskKind::Grasp, seed, values, tightened: false };
        live.monitors.keep_task(id, task, live.context.profile.monitor.paired_tasks_max());
    }
}

/// Rolls a version back for a rate.
fn rolled_back_for(bench: &mut RollbackBench, id: &CapabilityId, rate: Rate) -> RollbackRecord {
    let rates = vec![rate];
    let cause =
        Trigger { rates, ..trigger(bench.pipeline.record(), TriggerKind::RateTrip, Notice::StageBegins) };
    bench.pipeline.live().deactivate(id, cause, None, DeactivationKind::RolledBack).unwrap();
    rollback_of(bench, id)
}

fn state(bench: &RollbackBench, id: &CapabilityId) -> State {
    bench.pipeline.record().version_table().version(id).unwrap().1.state
}

#[test]
fn version_that_is_bad_where_its_rollback_target_is_good_is_rolled_back_for_good() {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.monitor.paired_tasks = 6.0;
    let mut bench = RollbackBench::resting_under(profile);
    let id = bench.activate("grasp-improved");
    keep(&mut bench, &id, 8, EpisodeValues { violation: true, ..GOOD }, true);
    // The arm of the fork never moves, so the target violates nothing.
    let record = rolled_back_for(&mut bench, &id, Rate::Violation);
    assert_eq!((record.post_status, record.uncompared), (PostStatus::RolledBack, None));
    let compared = record.rates.unwrap();
    assert!(compared.differs());
    let tally = RateTally { rate: Rate::Violation, tasks: 6, version: 6, target: 0 };
    assert_eq!(compared.tallies(), [tally], "the newest tasks are kept");
    assert_eq!(compared.rates[0].tasks[0].seed, 2, "the oldest ones are not");
    assert_eq!(state(&bench, &id), State::RolledBack);
    let target = record.predecessor.unwrap();
    assert!(bench.pipeline.record().alarms().get(&AlarmKey::SharedEvent(target)).is_none());
    assert!(!may_retry(&mut bench, &id), "a difference is final");
}

#[test]
fn version_that_is_bad_where_its_rollback_target_is_bad_too_is_demoted() {
    // Neither gets the arm of this cell to move: every grasp fails.
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    let record = rollback_of(&mut bench, &id);
    assert_eq!((record.trigger.kind, record.post_status), (TriggerKind::RateTrip, PostStatus::Demoted));
    assert!(record.trigger.rates.contains(&Rate::Failure), "{:?}", record.trigger);
    assert!(record.time_to_safe_ticks.is_some(), "the arm is made safe first");
    let compared = record.rates.unwrap();
    assert!(!compared.differs() && record.uncompared.is_none());
    let failed = compared.tallies().into_iter().find(|tally| tally.rate == Rate::Failure).unwrap();
    assert!(
        failed.tasks > 0 && failed.target == failed.tasks && failed.version == failed.tasks,
        "{failed:?}"
    );
    assert_eq!(state(&bench, &id), State::Demoted);
    let target = record.predecessor.unwrap();
    let active = bench.pipeline.record().active_of(&id.family).map(|active| active.id());
    assert_eq!(active.as_ref(), Some(&target), "the rollback target has control");
    let alarm = bench.pipeline.record().alarms().get(&AlarmKey::SharedEvent(target.clone())).unwrap();
    let Some(Notice::SharedRates { version, with, rates }) = alarm.text.notice() else { panic!("{alarm:?}") };
    assert_eq!((version, with, rates), (&target, &id, &compared.tallies()));
    assert!(may_retry(&mut bench, &id), "no difference is final");
}

/// Four tasks alone show no difference, and no cause in common either.
#[test]
fn too_few_tasks_demote_without_an_alarm_about_the_rollback_target() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    keep(&mut bench, &id, 4, EpisodeValues { violation: true, ..GOOD }, true);
    let record = rolled_back_for(&mut bench, &id, Rate::Violation);
    assert_eq!(record.post_status, PostStatus::Demoted);
    assert_eq!(record.rates.map(|compared| compared.rates[0].version_alone), Some(4));
    let target = record.predecessor.unwrap();
    assert!(bench.pipeline.record().alarms().get(&AlarmKey::SharedEvent(target)).is_none());
}

#[test]
fn version_without_the_start_of_a_task_is_demoted_uncompared() {
    for (factory, kept, reason) in [
        (StubFactory::exporting(), 0, UncomparedReason::NoStart),
        (StubFactory::exporting(), 10, UncomparedReason::NoStart),
        (StubFactory::new(), 10, UncomparedReason::NoExport),
    ] {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let mut bench = RollbackBench::in_cell(factory.into_cell(), profile);
        let id = bench.activate("grasp-improved");
        keep(&mut bench, &id, kept, FAILED, false);
        let record = rolled_back_for(&mut bench, &id, Rate::Failure);
        assert_eq!((record.post_status, record.rates), (PostStatus::Demoted, None));
        assert_eq!(record.uncompared, Some(reason), "{kept}");
        assert!(may_retry(&mut bench, &id), "a rate without a difference is not final");
    }
}

#[test]
fn unanswered_question_about_a_rate_is_compared_as_well() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    keep(&mut bench, &id, 3, FAILED, true);
    let now_tick = bench.pipeline.record().now_tick();
    let live = bench.pipeline.live();
    let watched = live.monitors.of_mut(&id).unwrap();
    // Every third task fails: the warning comes before the trip.
    let mut observed =
        (1..=12).map(|task| watched.monitor.observe(if task % 3 == 0 { &FAILED } else { &GOOD }, now_tick));
    let warned = observed.find(|decision| decision.action != MonitorAction::Continue).unwrap();
    assert_eq!(warned.action, MonitorAction::Restrict);
    watched.question.clone_from(&warned.reasons);
    let deadline_ms = live.monitors.questions()[0].deadline_ms;
    bench.pipeline.jump_to(deadline_ms);
    assert!(bench.pipeline.live().look_at_monitors().unwrap(), "due at {deadline_ms}");
    let record = rollback_of(&mut bench, &id);
    assert_eq!(
        (record.trigger.kind, &*record.trigger.rates),
        (TriggerKind::EscalationUnanswered, &[Rate::Failure][..])
    );
    assert_eq!((record.post_status, record.uncompared), (PostStatus::Demoted, None));
    assert_eq!(record.rates.map(|compared| compared.rates[0].target_alone), Some(0));
    let reasons = bench.pipeline.live().evidence_files.of(&id).unwrap().reasons.clone();
    let codes: Vec<ReasonCode> = reasons.iter().map(|reason| reason.code).collect();
    assert_eq!(codes, [ReasonCode::MonitorEscalationUnanswered, ReasonCode::MonitorRateWarning]);
}

#[test]
fn kept_tasks_end_with_their_monitor() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    keep(&mut bench, &id, 3, GOOD, true);
    let live = bench.pipeline.live();
    assert!(
        live.monitors.for_sequence().remove(&id.family).unwrap().tasks.is_empty(),
        "no sequence gets a copy"
    );
    let again = ActivationMonitor::new(&id, live.evidence_files.of(&id), live.context, 0).unwrap();
    live.monitors.insert(again);
    assert!(
        live.monitors.remove(&id.family).unwrap().tasks.is_empty(),
        "another activation has tasks of its own"
    );
    keep(&mut bench, &id, 3, GOOD, true);
    assert!(bench.pipeline.live().monitors.remove(&id.family).is_none(), "nothing is kept without a monitor");
}
