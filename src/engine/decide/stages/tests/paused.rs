//! What a pause, and whatever else changes a version, does to what was under way with it: nothing is lost, and the
//! engine does not hold for it.

use holdpoint_body::disturbance::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State, VersionFlags};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::submission::Risk;
use holdpoint_governance::version_status::{Obstacle, RunningWork, VersionCondition};
use holdpoint_protocol::command::{AuthorityEffect, Command, Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::{is_at_work, waits_its_turn};
use holdpoint_store::{AuditFilter, StoreError};
use holdpoint_wording::command_effect::{EngineEffect, VersionEffect, engine_effect, version_effect};

use crate::decide::pipeline::SliceOutcome;
use crate::decide::stages::activation::tests::{package, request_activation};
use crate::decide::stages::rollback::tests::RollbackBench;
use crate::fault::EngineFault;
use holdpoint_record::version_table::TransitionNote;

const CANDIDATE: &str = "align-improved";

fn operation(version: &CapabilityId) -> Operation {
    Operation { version: version.clone(), by: "ada".to_owned(), reason: "a test".to_owned() }
}

fn done(bench: &mut RollbackBench, command: Command) {
    let reply = bench.pipeline.command(command.clone());
    assert!(matches!(reply, Reply::Accepted { .. }), "{command:?}: {reply:?}");
}

fn pause(bench: &mut RollbackBench, id: &CapabilityId) {
    done(bench, Command::Pause(operation(id)));
}

fn resume(bench: &mut RollbackBench, id: &CapabilityId) {
    done(bench, Command::Resume(operation(id)));
}

fn state_of(bench: &RollbackBench, id: &CapabilityId) -> (State, VersionFlags) {
    let (_, lifecycle, _) = bench.pipeline.record().version_table().version(id).unwrap();
    (lifecycle.state, lifecycle.flags)
}

fn transition(bench: &mut RollbackBench, id: &CapabilityId, event: LifecycleEvent) {
    bench
        .pipeline
        .live()
        .record
        .transition(&id.family, event, TransitionNote::because(Notice::StageBegins))
        .unwrap();
}

/// The pipeline does what it does by itself, and never holds.
fn work(bench: &mut RollbackBench, slices: usize) {
    for _ in 0..slices {
        let progress = bench.pipeline.advance();
        assert_eq!(bench.pipeline.record().holding(), None);
        if progress == (SliceOutcome::Idle { next_ms: None }) {
            break;
        }
    }
}

/// No question is open, neither here nor in the store.
fn no_request_is_open(bench: &RollbackBench) -> bool {
    let open = bench.pipeline.record().version_table().store().views().unwrap().open_requests().unwrap();
    open.is_empty() && bench.pipeline.snapshot().prompts.is_empty()
}

fn begins_the_gate(bench: &mut RollbackBench, id: &CapabilityId) -> bool {
    bench.pipeline.drain_events();
    work(bench, 3);
    let begun = |event: &EventKind| matches!(event, EventKind::StageStarted { version, stage: Stage::Activation, .. } if version == id);
    bench.pipeline.drain_events().iter().any(begun)
}

/// The window of a paused version ended in a confirmation that the lifecycle refuses, and the engine held.
#[test]
fn paused_active_version_keeps_running_and_is_confirmed_on_resume() {
    let (mut bench, id) = RollbackBench::with_active(CANDIDATE);
    let reply = bench.pipeline.command(Command::Pause(operation(&id)));
    let Reply::Accepted { text, .. } = &reply else { panic!("{reply:?}") };
    assert_eq!(*text, version_effect(&id, &VersionEffect::PromotionPaused));
    let over =
        |bench: &mut RollbackBench| bench.pipeline.live().monitors.of(&id).unwrap().monitor.is_confirmed();
    for _ in 0..200 {
        work(&mut bench, 1);
        if over(&mut bench) {
            break;
        }
    }
    assert!(over(&mut bench), "it works on");
    work(&mut bench, 3);
    let (state, flags) = state_of(&bench, &id);
    assert!(state == State::Active && flags.provisional && flags.paused, "{flags:?}");
    resume(&mut bench, &id);
    let (state, flags) = state_of(&bench, &id);
    assert!(state == State::Active && !flags.provisional && !flags.paused, "{flags:?}");
    let is_confirmation =
        |event: &EventKind| matches!(event, EventKind::Confirmed { version, .. } if *version == id);
    assert!(bench.pipeline.drain_events().iter().any(is_confirmation));
}

/// A pause of a confirmed version was accepted and changed nothing.
#[test]
fn pausing_a_confirmed_version_is_refused_with_a_hint() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
    transition(&mut bench, &id, LifecycleEvent::Confirm { version });
    let reply = bench.pipeline.command(Command::Pause(operation(&id)));
    let Reply::Refused { hint: Some(hint), .. } = &reply else { panic!("{reply:?}") };
    assert!(hint.contains("holdpoint stop") && hint.contains("holdpoint version restrict"), "{hint}");
    assert!(!state_of(&bench, &id).1.paused);
}

/// The sandbox of a paused version was worked to its end, which the lifecycle refuses, and the engine held.
#[test]
fn stage_of_a_paused_version_waits_and_resumes() {
    let mut bench = RollbackBench::new();
    let id = bench.pass(CANDIDATE, &Stage::ALL[..1]);
    work(&mut bench, 3);
    assert_eq!(state_of(&bench, &id).1.running, Some(Stage::Sandbox));
    let done = |bench: &RollbackBench| {
        let candidates = bench.pipeline.snapshot().candidates;
        candidates.into_iter().find(|view| view.version == id).unwrap().progress.unwrap().done
    };
    pause(&mut bench, &id);
    let before = done(&bench);
    work(&mut bench, 20);
    assert_eq!(done(&bench), before, "nothing of it is worked while it is paused");
    // Another version does not wait behind it.
    let other = bench.pass("place-refined", &[]);
    work(&mut bench, 1);
    assert_eq!(state_of(&bench, &other).0, State::Validated);
    reject(&mut bench, &other);
    resume(&mut bench, &id);
    for _ in 0..20 {
        work(&mut bench, 1);
    }
    assert!(done(&bench) > before, "it goes on from where it rested");
    assert_eq!(state_of(&bench, &id).1.running, Some(Stage::Sandbox));
}

/// The engine halted, and the arm with it, though the candidate had no authority.
#[test]
fn candidate_whose_refusal_finds_a_full_disk_is_on_hold_and_the_engine_works_on() {
    let mut bench = RollbackBench::new();
    let id = bench.pass(CANDIDATE, &Stage::ALL[..1]);
    work(&mut bench, 3);
    let refuse = |bench: &mut RollbackBench, id: &CapabilityId| {
        let full = EngineFault::Store(StoreError::DiskFull { what: "write" });
        match bench.pipeline.answer(Err(full), AuthorityEffect::TakesAway, Some(id)) {
            Reply::Refused { code, .. } => code,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refuse(&mut bench, &id), Refusal::Store);
    let seen = |bench: &RollbackBench| {
        let now = bench.pipeline.snapshot();
        let view = now.candidates.iter().find(|view| view.version == id).unwrap();
        (now.status(view).condition, view.progress.as_ref().unwrap().done)
    };
    let before = seen(&bench);
    assert_eq!(before.0, VersionCondition::Held);
    work(&mut bench, 20);
    assert_eq!(seen(&bench), before, "its stage makes no progress while it is on hold");
    resume(&mut bench, &id);
    work(&mut bench, 20);
    assert!(seen(&bench).1 > before.1, "a person resumed it");
    // An active version may not run on.
    let active: CapabilityId = "grasp@1.0.0".parse().unwrap();
    assert_eq!(refuse(&mut bench, &active), Refusal::Holding);
    assert!(bench.pipeline.record().holding().is_some());
}

/// Regression: both versions were shown as running, and no word said that the resumed one waits.
#[test]
fn resumed_stage_waits_for_the_stage_that_has_come_meanwhile() {
    let mut bench = RollbackBench::new();
    let first = bench.pass(CANDIDATE, &Stage::ALL[..1]);
    work(&mut bench, 3);
    pause(&mut bench, &first);
    let second = bench.pass("place-refined", &Stage::ALL[..1]);
    for _ in 0..20 {
        if state_of(&bench, &second).1.running.is_none() {
            work(&mut bench, 1);
        }
    }
    assert_eq!(state_of(&bench, &second).1.running, Some(Stage::Sandbox));
    let seen = |bench: &RollbackBench, id: &CapabilityId| {
        let now = bench.pipeline.snapshot();
        let view = now.candidates.iter().find(|view| view.version == *id).unwrap();
        (is_at_work(view), waits_its_turn(view), now.status(view).obstacle)
    };
    assert_eq!(seen(&bench, &first), (false, false, None), "a person has paused it");
    resume(&mut bench, &first);
    let behind = Obstacle::Behind { version: second.clone(), work: RunningWork::Sandbox };
    assert_eq!(seen(&bench, &first), (false, true, Some(behind)));
    assert_eq!(seen(&bench, &second), (true, false, None));
    reject(&mut bench, &second);
    work(&mut bench, 1);
    assert_eq!(seen(&bench, &first), (true, false, None), "its turn has come");
}

fn reject(bench: &mut RollbackBench, id: &CapabilityId) {
    done(bench, Command::Reject(operation(id)));
}

/// Regression: an answer over a changed row was refused, the question was gone, and no one could be asked again.
#[test]
fn a_pause_voids_a_request_and_the_gate_asks_again() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
    assert!(!no_request_is_open(&bench));
    bench.pipeline.drain_events();
    pause(&mut bench, &id);
    assert!(no_request_is_open(&bench));
    let events = bench.pipeline.drain_events();
    let is_void = |event: &EventKind| {
        let EventKind::Voided { reason, .. } = event else { return false };
        matches!(reason.notice(), Some(Notice::RequestVoid { version, .. }) if *version == id)
    };
    assert!(events.iter().any(is_void), "{events:?}");
    assert!(!begins_the_gate(&mut bench, &id), "it is paused");
    resume(&mut bench, &id);
    assert!(begins_the_gate(&mut bench, &id), "the gate checks it again");
}

/// The pause came after the approval and before the end of the sequence: the engine held.
#[test]
fn pause_voids_an_approval_that_waits_for_the_end_of_a_sequence() {
    for by_command in [true, false] {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
        bench.pipeline.activation().approvals.grant_later(&id);
        if by_command {
            pause(&mut bench, &id);
        } else {
            // As if it had changed in the meantime.
            let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
            transition(&mut bench, &id, LifecycleEvent::Pause { version });
            bench.pipeline.activation().take_granted().unwrap();
        }
        work(&mut bench, 5);
        assert!(no_request_is_open(&bench));
        let (state, flags) = state_of(&bench, &id);
        assert!(state == State::Shadowed && flags.paused && !flags.awaiting_approval, "{flags:?}");
        resume(&mut bench, &id);
        assert!(begins_the_gate(&mut bench, &id));
    }
}

/// A block under a profile changes the version's row as well.
#[test]
fn a_block_voids_an_approval_request() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
    done(&mut bench, Command::Demote { operation: operation(&id), profiles: vec![ProfileName::Human] });
    assert!(no_request_is_open(&bench));
    assert!(begins_the_gate(&mut bench, &id), "under another profile it may go on");
}

/// Regression: a request beside the version that took over never ended; at its deadline the engine halted.
#[test]
fn a_request_beside_an_activated_version_is_repeated() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = request_activation(&mut bench.pipeline, package(CANDIDATE, &[]));
    let deadline_ms = bench.pipeline.record().engine_ms_at(bench.pipeline.snapshot().prompts[0].until);
    bench.activate("align-low-transit");
    assert!(bench.pipeline.look_at_deadlines().unwrap());
    assert!(no_request_is_open(&bench));
    assert_eq!(state_of(&bench, &id).1.running, None, "the gate may look at it again");
    bench.pipeline.jump_to(deadline_ms);
    while bench.pipeline.look_at_deadlines().unwrap() {}
    assert_eq!(bench.pipeline.record().holding(), None);
}

/// After a restart, a version of the history had its author's estimate as its risk.
#[test]
fn risk_of_a_rejected_version_stays_the_computed_one_after_a_restart() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass(CANDIDATE, &[]);
    work(&mut bench, 1);
    reject(&mut bench, &id);
    let risk = |bench: &RollbackBench| {
        let candidates = bench.pipeline.snapshot().candidates;
        candidates.into_iter().find(|view| view.version == id).unwrap().risk
    };
    let before = risk(&bench);
    assert_ne!(before, Risk::Low, "the author estimates that");
    assert_eq!(risk(&bench.restart()), before);
}

/// The strip says which stage stopped a version: known at once, and after a restart.
#[test]
fn the_stage_of_a_rejection_is_on_record() {
    for repeated in [Stage::Sandbox, Stage::Shadow] {
        let mut bench = RollbackBench::resting(ProfileName::Sim);
        let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
        done(&mut bench, Command::Repeat { operation: operation(&id), stage: repeated });
        let version = bench.pipeline.record().version_table().version(&id).unwrap().0;
        transition(&mut bench, &id, LifecycleEvent::Reject { version });
        let ran = |bench: &RollbackBench| {
            let candidates = bench.pipeline.snapshot().candidates;
            let view = candidates.into_iter().find(|view| view.version == id).unwrap();
            (view.left, view.ran)
        };
        let left = (Some(State::Demoted), Some(repeated));
        assert_eq!(ran(&bench), left);
        assert_eq!(ran(&bench.restart()), left);
    }
}

/// No engine started on the store any more: a paused version repeats no stage.
#[test]
fn a_paused_retry_does_not_keep_an_engine_from_starting() {
    let mut bench = RollbackBench::new();
    let id = bench.pass(CANDIDATE, &Stage::ALL[..3]);
    let retry = || Command::Repeat { operation: operation(&id), stage: Stage::Sandbox };
    done(&mut bench, retry());
    pause(&mut bench, &id);
    let mut bench = bench.restart();
    let (state, flags) = state_of(&bench, &id);
    assert_eq!((state, flags.paused, flags.running), (State::Demoted, true, None));
    resume(&mut bench, &id);
    done(&mut bench, retry());
}

/// The end of a drift, and of a fault, was answered as if one had set in.
#[test]
fn end_of_a_drift_or_fault_has_its_own_answer() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let mut reply_text = |command: Command| match bench.pipeline.command(command) {
        Reply::Accepted { text, .. } => text,
        other => panic!("{other:?}"),
    };
    let (kind, magnitude) = (Some(DriftKind::SensorNoise), Some(Magnitude::Mild));
    assert_eq!(reply_text(Command::Drift { kind, magnitude }), engine_effect(&EngineEffect::Drift(kind)));
    let ended = Command::Drift { kind: None, magnitude: None };
    assert_eq!(reply_text(ended), engine_effect(&EngineEffect::Drift(None)));
    for fault in [Some(LiveFault::ALL[0]), None] {
        assert_eq!(reply_text(Command::LiveFault { fault }), engine_effect(&EngineEffect::Fault(fault)));
    }
}

/// A reason of zero-width characters passed for a reason.
#[test]
fn every_command_refuses_an_unreadable_reason() {
    let (mut bench, id) = RollbackBench::resting_with_active(CANDIDATE);
    for unseen in ["\u{200b}", " \u{2060}\u{feff}", "\u{3164}", "\t"] {
        let (by, reason) = ("ada".to_owned(), unseen.to_owned());
        let of = || Operation { version: id.clone(), by: by.clone(), reason: reason.clone() };
        let commands = [
            Command::Reject(of()),
            Command::Rollback(of()),
            Command::Vacate(of()),
            Command::Demote { operation: of(), profiles: vec![ProfileName::Real] },
            Command::Release { operation: of(), profiles: Vec::new() },
            Command::Pause(of()),
            Command::Resume(of()),
            Command::Repeat { operation: of(), stage: Stage::Sandbox },
            Command::Restrict(of()),
            Command::Rearm(of()),
            Command::Continue(of()),
            Command::Goal { goal: "grasp".to_owned(), by: by.clone(), reason: reason.clone() },
        ];
        for command in commands {
            let reply = bench.pipeline.command(command.clone());
            let Reply::Refused { code, text, .. } = &reply else { panic!("{command:?}: {reply:?}") };
            assert!(*code == Refusal::BadInput && text.contains("reason"), "{command:?}: {reply:?}");
        }
    }
}

/// Regression: the reason of a pause was nowhere in the store.
#[test]
fn a_pause_and_its_end_are_on_record_with_person_and_reason() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let id = bench.pass(CANDIDATE, &Stage::ALL[..1]);
    pause(&mut bench, &id);
    resume(&mut bench, &id);
    let filter = AuditFilter { kind: Some(RecordKind::PauseSet), ..AuditFilter::default() };
    let found = bench.pipeline.record().version_table().store().views().unwrap().audit(&filter).unwrap();
    let Operation { by, reason, .. } = operation(&id);
    for (record, act) in found.iter().zip(["paused", "resumed"]) {
        let body: serde_json::Value = serde_json::from_str(&record.body).unwrap();
        assert_eq!((&record.subject, &body["act"]), (&id.to_string(), &act.into()), "{body}");
        assert_eq!((&body["by"], &body["reason"]), (&by.as_str().into(), &reason.as_str().into()), "{body}");
    }
    assert_eq!(found.len(), 2);
}
