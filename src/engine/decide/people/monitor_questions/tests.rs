//! A question is answered and asked again; an alarm is closed once what it was raised for is over.

use std::sync::Arc;

use crate::decide::pipeline::Pipeline;
use crate::decide::pipeline::concurrent::CommandTiming;
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::live::station::LiveFault;
use holdpoint_governance::alarms::{AlarmKey, AlarmState, Priority};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::AuditFilter;

fn go_on(id: &CapabilityId) -> Command {
    Command::Continue(Operation {
        version: id.clone(),
        by: "ada".to_owned(),
        reason: "the link is known".to_owned(),
    })
}

fn records(pipeline: &Pipeline, kind: RecordKind) -> usize {
    let filter = AuditFilter { kind: Some(kind), ..AuditFilter::default() };
    pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap().len()
}

fn wait_for_a_question(pipeline: &mut Pipeline) {
    let next_ms = pipeline.next_deadline_ms().expect("silence has a deadline");
    pipeline.jump_to(next_ms);
    assert!(pipeline.live().look_at_monitors().unwrap(), "due at {next_ms}");
}

#[test]
fn escalation_is_answered_and_may_be_raised_again() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let pipeline = &mut bench.pipeline;
    assert!(pipeline.live().monitors.questions().is_empty());
    assert!(matches!(pipeline.command(go_on(&id)), Reply::Refused { code: Refusal::NotNow, .. }));
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    wait_for_a_question(pipeline);
    let questions = pipeline.live().monitors.questions();
    assert_eq!(questions.len(), 1);
    assert_eq!(questions[0].version, id);
    assert!(!questions[0].reasons.is_empty());
    assert!(questions[0].deadline_ms > pipeline.record().now_ms());
    pipeline.drain_events();

    let reply = pipeline.command(go_on(&id));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    assert!(pipeline.live().monitors.questions().is_empty());
    assert_eq!(records(pipeline, RecordKind::MonitorAnswer), 1);
    let events = pipeline.drain_events();
    assert!(events.iter().any(|event| matches!(event, EventKind::Continued { by, .. } if by == "ada")));
    let alarm = pipeline.record().alarms().get(&AlarmKey::Escalated(id.clone())).unwrap();
    assert!(!alarm.condition, "what was asked is answered");
    assert_eq!(pipeline.live().monitors.of(&id).unwrap().announced, MonitorAction::Continue);

    // The link is still down: the monitor asks again, with the alarm, and once more after a restriction.
    for _ in 0..2 {
        pipeline.live().look_at_monitors().unwrap();
        if pipeline.live().monitors.questions().is_empty() {
            wait_for_a_question(pipeline);
        }
        assert_eq!(pipeline.live().monitors.questions().len(), 1);
        let new_events = pipeline.drain_events();
        assert!(new_events.iter().any(|event| matches!(event, EventKind::Monitor { .. })), "{new_events:?}");
        assert!(new_events.iter().any(|event| matches!(event, EventKind::Alarm { .. })), "{new_events:?}");
        assert!(matches!(pipeline.command(go_on(&id)), Reply::Accepted { .. }));
    }
    assert_eq!(pipeline.record().holding(), None);
}

#[test]
fn telemetry_silence_has_its_own_alarm_priority() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let pipeline = &mut bench.pipeline;
    Arc::make_mut(&mut pipeline.context_mut().profile).alarms.telemetry_silent = Priority::Low;
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    wait_for_a_question(pipeline);
    let alarm = pipeline.record().alarms().get(&AlarmKey::Escalated(id)).unwrap();
    assert_eq!(alarm.priority, Priority::Low);
}

#[test]
fn refusals_change_no_evidence_file() {
    let (mut bench, active) = RollbackBench::resting_with_active("align-improved");
    let unknown: CapabilityId = "align@9.9.9".parse().unwrap();
    let pipeline = &mut bench.pipeline;
    pipeline.live().evidence_files.edit(&active).held = true;
    let before = pipeline.live().evidence_files.of(&active).cloned();
    for version in [&unknown, &active] {
        let (version, by) = (version.clone(), "ada".to_owned());
        let operation = Operation { version, by, reason: "looked".to_owned() };
        for command in [
            Command::Resume(operation.clone()),
            Command::Repeat { operation: operation.clone(), stage: Stage::Shadow },
        ] {
            let reply = pipeline.command(command.clone());
            assert!(matches!(reply, Reply::Refused { .. }), "{command:?}: {reply:?}");
        }
    }
    assert!(pipeline.live().evidence_files.of(&unknown).is_none(), "an unknown version has no dossier");
    assert_eq!(pipeline.live().evidence_files.of(&active), before.as_ref());
    // A superseded version is not demoted.
    let superseded: CapabilityId = "align@1.0.0".parse().unwrap();
    let (version, by) = (superseded.clone(), "ada".to_owned());
    let operation = Operation { version, by, reason: "looked".to_owned() };
    let before = pipeline.live().evidence_files.of(&superseded).cloned();
    let reply = pipeline.command(Command::Demote { operation, profiles: Vec::new() });
    assert!(matches!(reply, Reply::Refused { .. }), "{reply:?}");
    assert_eq!(pipeline.live().evidence_files.of(&superseded), before.as_ref());
}

#[test]
fn answer_after_the_deadline_is_refused() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let pipeline = &mut bench.pipeline;
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    wait_for_a_question(pipeline);
    let deadline_ms = pipeline.live().monitors.questions()[0].deadline_ms;
    pipeline.jump_to(deadline_ms);
    assert!(matches!(pipeline.command(go_on(&id)), Reply::Refused { code: Refusal::NotNow, .. }));
}

#[test]
fn alarm_returns_to_normal_when_its_cause_ends() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    bench.by_operator(&id);
    let pipeline = &mut bench.pipeline;
    let key = AlarmKey::RolledBack(id.clone());
    let reset =
        Command::ResetAlarm { alarm: key.to_string(), by: "ada".to_owned(), reason: "looked".to_owned() };
    assert!(matches!(pipeline.command(reset.clone()), Reply::Accepted { .. }));
    let open = |pipeline: &Pipeline| pipeline.record().alarms().open().iter().any(|alarm| alarm.key == key);
    assert!(!open(pipeline));
    assert_eq!(records(pipeline, RecordKind::AlarmReset), 1);
    assert!(matches!(pipeline.command(reset), Reply::Refused { code: Refusal::NotNow, .. }));
    assert_eq!(pipeline.record().holding(), None);
}

#[test]
fn alarm_is_shelved_for_a_limited_time() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let pipeline = &mut bench.pipeline;
    let key = AlarmKey::Approval("align@1.1.0".parse().unwrap());
    pipeline.live().record.raise(key.clone(), Priority::Low, false, Notice::SocketNameTaken { times: 1 });
    let shelve = |for_ms: u64, reason: &str| Command::ShelveAlarm {
        alarm: key.to_string(),
        by: "ada".to_owned(),
        for_ms,
        reason: reason.to_owned(),
    };
    for bad in [shelve(0, "known"), shelve(9 * 3_600_000, "known"), shelve(60_000, " ")] {
        let reply = pipeline.command(bad.clone());
        assert!(matches!(reply, Reply::Refused { code: Refusal::BadInput, .. }), "{bad:?}: {reply:?}");
    }
    assert!(matches!(pipeline.command(shelve(60_000, "known")), Reply::Accepted { .. }));
    let state = |pipeline: &Pipeline| pipeline.record().alarms().get(&key).unwrap().state();
    assert_eq!(state(pipeline), AlarmState::Shelved);
    let unshelve = Command::UnshelveAlarm { alarm: key.to_string(), by: "ada".to_owned() };
    assert!(matches!(pipeline.command(unshelve.clone()), Reply::Accepted { .. }));
    assert_eq!(state(pipeline), AlarmState::Unacknowledged);
    assert!(matches!(pipeline.command(unshelve), Reply::Refused { code: Refusal::NotNow, .. }));
    assert_eq!(pipeline.record().holding(), None);
}

#[test]
fn a_question_is_shown_during_its_sequence() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    let pipeline = &mut bench.pipeline;
    pipeline.live().record.set_clock(Clock::real(0));
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    // A watch that was never read is silent from the start, so its first task raises the question.
    pipeline.pace_live_world(Some(1.0), Arc::new(|_| {}));
    let until = std::time::Instant::now() + std::time::Duration::from_mins(1);
    while pipeline.live().monitors.questions().is_empty() && pipeline.live().monitors.iter().next().is_some()
    {
        assert!(std::time::Instant::now() < until, "the monitor does not ask");
        pipeline.advance();
        std::thread::yield_now();
    }
    assert!(pipeline.live().monitors.has_question(&id));
    let running = pipeline.live().world.is_running();
    let events = pipeline.drain_events();
    assert!(events.iter().any(|event| matches!(event, EventKind::Monitor { .. })), "{events:?}");
    assert_eq!(pipeline.timing(&go_on(&id)), if running { CommandTiming::Stop } else { CommandTiming::Now });
    pipeline.end();
    assert!(!pipeline.live().world.is_running());
}

/// Each answer restarts the charts: one person could keep a version of their own in control that gets worse.
#[test]
fn authors_neither_answer_for_their_own_version_nor_lift_its_restriction() {
    let mut bench = RollbackBench::resting(ProfileName::Real);
    let id = bench.activate("align-improved");
    let pipeline = &mut bench.pipeline;
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    wait_for_a_question(pipeline);
    let now_ms = pipeline.record().now_ms();
    pipeline.live().record.set_clock(Clock::real(now_ms));
    let operation =
        |by: &str| Operation { version: id.clone(), by: by.to_owned(), reason: "a test".to_owned() };
    let release = |by: &str| Command::Release { operation: operation(by), profiles: Vec::new() };
    let refused = |reply: &Reply| matches!(reply, Reply::Refused { code: Refusal::NotAllowed, .. });
    let reply = pipeline.command(Command::Continue(operation("skill-lab")));
    assert!(refused(&reply), "{reply:?}");
    let reply = pipeline.command(Command::Continue(operation("ada")));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    let reply = pipeline.command(Command::Restrict(operation("ada")));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    let reply = pipeline.command(release("skill-lab"));
    assert!(refused(&reply), "{reply:?}");
    let reply = pipeline.command(release("ada"));
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
}
