//! A question is answered and asked again; an alarm is closed once what it was raised for is over.

use crate::pipeline::live::LiveFault;
use crate::pipeline::manager::UpgradeManager;
use crate::pipeline::paced::Timing;
use crate::pipeline::stages::rollback::tests::Bench;
use holdpoint_governance::alarms::AlarmState;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::profile::AlarmPriority;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::AuditFilter;

fn go_on(id: &CapabilityId) -> Command {
    Command::Continue(Operation {
        version: id.clone(),
        by: "ada".to_owned(),
        reason: "the link is known".to_owned(),
    })
}

fn records(manager: &UpgradeManager, kind: RecordKind) -> usize {
    let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
    manager.ledger.store().views().unwrap().audit(&filter).unwrap().len()
}

fn wait_for_a_question(manager: &mut UpgradeManager) {
    let next_ms = manager.next_deadline_ms().expect("silence has a deadline");
    manager.jump_to(next_ms);
    assert!(manager.look_at_monitors().unwrap(), "due at {next_ms}");
}

#[test]
fn a_question_is_answered_and_may_come_again() {
    let mut bench = Bench::new();
    let id = bench.activate("align-improved");
    let manager = &mut bench.manager;
    assert!(manager.questions().is_empty());
    assert!(matches!(manager.command(go_on(&id)), Reply::Refused { code: Refusal::NotNow, .. }));
    manager.live.set_fault(Some(LiveFault::TelemetryLost));
    wait_for_a_question(manager);
    let asked = manager.questions();
    assert_eq!(asked.len(), 1);
    assert_eq!(asked[0].version, id);
    assert!(!asked[0].reasons.is_empty());
    assert!(asked[0].deadline_ms > manager.clock().now_ms());
    manager.drain_events();

    let reply = manager.command(go_on(&id));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    assert!(manager.questions().is_empty());
    assert_eq!(records(manager, RecordKind::MonitorAnswer), 1);
    let events = manager.drain_events();
    assert!(events.iter().any(|event| matches!(event, EventKind::Continued { by, .. } if by == "ada")));
    let alarm = manager.alarm_book().get(&format!("escalated:{id}")).unwrap();
    assert!(!alarm.condition, "what was asked is answered");
    assert_eq!(manager.watches[&id.family].told, MonitorAction::Continue);

    // The link is still down: people are asked anew, with the alarm, and again after a restriction.
    for _ in 0..2 {
        manager.look_at_monitors().unwrap();
        if manager.questions().is_empty() {
            wait_for_a_question(manager);
        }
        assert_eq!(manager.questions().len(), 1);
        let told = manager.drain_events();
        assert!(told.iter().any(|event| matches!(event, EventKind::Monitor { .. })), "{told:?}");
        assert!(told.iter().any(|event| matches!(event, EventKind::Alarm { .. })), "{told:?}");
        assert!(matches!(manager.command(go_on(&id)), Reply::Accepted { .. }));
    }
    assert_eq!(manager.holding(), None);
}

#[test]
fn a_late_answer_is_none() {
    let mut bench = Bench::new();
    let id = bench.activate("align-improved");
    let manager = &mut bench.manager;
    manager.live.set_fault(Some(LiveFault::TelemetryLost));
    wait_for_a_question(manager);
    let deadline_ms = manager.questions()[0].deadline_ms;
    manager.jump_to(deadline_ms);
    assert!(matches!(manager.command(go_on(&id)), Reply::Refused { code: Refusal::NotNow, .. }));
}

#[test]
fn an_alarm_is_closed_once_it_is_over() {
    let mut bench = Bench::new();
    let id = bench.activate("align-improved");
    bench.by_operator(&id);
    let manager = &mut bench.manager;
    let key = format!("rolled-back:{id}");
    let reset = Command::ResetAlarm { alarm: key.clone(), by: "ada".to_owned(), reason: "looked".to_owned() };
    assert!(matches!(manager.command(reset.clone()), Reply::Accepted { .. }));
    let open = |manager: &UpgradeManager| manager.alarm_book().open().iter().any(|alarm| alarm.key == key);
    assert!(!open(manager));
    assert_eq!(records(manager, RecordKind::AlarmReset), 1);
    assert!(matches!(manager.command(reset), Reply::Refused { code: Refusal::NotNow, .. }));
    assert_eq!(manager.holding(), None);
}

#[test]
fn an_alarm_is_set_aside_for_a_time() {
    let mut bench = Bench::new();
    let manager = &mut bench.manager;
    manager.raise("test", "test", AlarmPriority::Low, false, "a test");
    let shelve = |for_ms: u64, reason: &str| Command::ShelveAlarm {
        alarm: "test".to_owned(),
        by: "ada".to_owned(),
        for_ms,
        reason: reason.to_owned(),
    };
    for bad in [shelve(0, "known"), shelve(9 * 3_600_000, "known"), shelve(60_000, " ")] {
        let reply = manager.command(bad.clone());
        assert!(matches!(reply, Reply::Refused { code: Refusal::BadInput, .. }), "{bad:?}: {reply:?}");
    }
    assert!(matches!(manager.command(shelve(60_000, "known")), Reply::Accepted { .. }));
    let state = |manager: &UpgradeManager| manager.alarm_book().get("test").unwrap().state();
    assert_eq!(state(manager), AlarmState::Shelved);
    let unshelve = Command::UnshelveAlarm { alarm: "test".to_owned(), by: "ada".to_owned() };
    assert!(matches!(manager.command(unshelve.clone()), Reply::Accepted { .. }));
    assert_eq!(state(manager), AlarmState::Unacknowledged);
    assert!(matches!(manager.command(unshelve), Reply::Refused { code: Refusal::NotNow, .. }));
    assert_eq!(manager.holding(), None);
}

#[test]
fn a_question_is_told_while_its_sequence_still_runs() {
    let mut bench = Bench::new();
    let id = bench.activate("grasp-improved");
    let manager = &mut bench.manager;
    manager.clock = Clock::real(0);
    manager.live.set_fault(Some(LiveFault::TelemetryLost));
    // A watch that was never read is silent from the start, so its first task raises the question.
    manager.pace_live_world(Some(1.0), std::sync::Arc::new(|_| {}));
    let until = std::time::Instant::now() + std::time::Duration::from_mins(1);
    while manager.questions().is_empty() && !manager.watches.is_empty() {
        assert!(std::time::Instant::now() < until, "nobody asks");
        manager.advance();
        std::thread::yield_now();
    }
    assert!(manager.has_question(&id));
    let out = manager.is_out();
    let told = manager.drain_events();
    assert!(told.iter().any(|event| matches!(event, EventKind::Monitor { .. })), "{told:?}");
    assert_eq!(manager.timing(&go_on(&id)), if out { Timing::Stop } else { Timing::Now });
    manager.end();
    assert!(!manager.is_out());
}
