//! People's deadlines by a wall clock that a test sets: while no engine runs, and while one does.

use std::path::Path;
use std::sync::{Arc, Mutex};

use holdpoint_approvals::Identity;
use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_governance::alarms::AlarmState;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::profile::{FreezeWindow, Profile, ProfileName};
use holdpoint_governance::wall_time::ClockReading;
use holdpoint_protocol::command::{Command, Operation};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::ApprovalRequestView;

use super::*;
use crate::decide::people::persons::enrolled;
use crate::decide::people::signers::tests::{question, signed};
use crate::decide::pipeline::Pipeline;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline_by;
use crate::tests::{assert_accepted, at_the_gate, awaiting_approval};
use holdpoint_record::wall_clock::{Clocks, WallClock};

const MINUTE_MS: i64 = 60_000;
const DAY_MS: i64 = 24 * 60 * MINUTE_MS;

/// The clocks of a machine, as a test sets them.
#[derive(Clone)]
struct MachineClock(Arc<Mutex<ClockReading>>);

impl Clocks for MachineClock {
    fn read(&self) -> ClockReading {
        *self.0.lock().unwrap()
    }

    fn boot(&self) -> String {
        "one start".to_owned()
    }
}

impl MachineClock {
    fn new() -> Self {
        let wall: WallTime = "2026-11-25T16:00:00Z".parse().unwrap();
        Self(Arc::new(Mutex::new(ClockReading { wall, boot_ms: 5_000 })))
    }

    /// Sets the wall clock.
    fn set(&self, by_ms: i64) {
        let mut now = self.0.lock().unwrap();
        now.wall = WallTime::from_ms(now.wall.ms() + by_ms);
    }

    /// Time passes on both clocks, awake or suspended.
    fn pass(&self, ms: i64) {
        self.set(ms);
        self.0.lock().unwrap().boot_ms += ms.unsigned_abs();
    }

    fn wall_time(&self) -> WallTime {
        self.read().wall
    }
}

fn engine(folder: &Path, profile: &Profile, machine: &MachineClock) -> Pipeline {
    let (jump_max_s, clocks) = (profile.clock.jump_max_s, Box::new(machine.clone()));
    resting_pipeline_by(folder, profile.clone(), |newest| WallClock::of_machine(clocks, newest, jump_max_s))
}

fn builtin(name: ProfileName) -> Profile {
    Profile::builtin(name).unwrap()
}

/// Runs until the version is active, or nothing more can happen.
fn work(pipeline: &mut Pipeline, id: &CapabilityId) {
    for _ in 0..6 {
        if state(pipeline, id) != State::Active {
            pipeline.advance();
        }
    }
    assert_eq!(pipeline.record().holding(), None);
}

fn state(pipeline: &Pipeline, id: &CapabilityId) -> State {
    pipeline.record().version_table().version(id).unwrap().1.state
}

/// Why the gate holds a version.
fn hold_reasons(pipeline: &Pipeline, id: &CapabilityId) -> Vec<ReasonCode> {
    let snapshot = pipeline.snapshot();
    let found = snapshot.candidates.iter().find(|one| one.version == *id).unwrap();
    assert!(found.held, "{found:?}");
    found.reasons.iter().map(|reason| reason.code).collect()
}

fn resume(pipeline: &mut Pipeline, id: &CapabilityId) {
    let operation = Operation { version: id.clone(), by: "ana".to_owned(), reason: "a test".to_owned() };
    assert_accepted(&pipeline.command(Command::Resume(operation)));
}

fn confirm(pipeline: &mut Pipeline, time: WallTime) -> Reply {
    let (by, reason) = ("ana".to_owned(), "compared with the hall's clock".to_owned());
    pipeline.command(Command::ConfirmTime { by, reason, time })
}

fn approve(pipeline: &mut Pipeline, open: &ApprovalRequestView, who: &Identity) {
    let command = signed(pipeline, open, who, ApprovalDecision::Approve).unwrap();
    assert_accepted(&pipeline.command(command));
}

fn alarm(pipeline: &Pipeline) -> Option<AlarmState> {
    pipeline.record().alarms().get(&AlarmKey::ClockDoubted).map(holdpoint_governance::alarms::Alarm::state)
}

/// Nine days later, after a restart, the second approval made the first one count.
#[test]
fn approval_expires_while_no_engine_runs() {
    let folder = quick_folder();
    let (machine, human) = (MachineClock::new(), builtin(ProfileName::Human));
    let mut first = engine(folder.path(), &human, &machine);
    // A review takes two people.
    let id = awaiting_approval(&mut first, PolicyOutcome::Review, Vec::new());
    let [ana, ben] =
        ["ana", "ben"].map(|name| enrolled(first.live().record, name, Role::Safety, KeyEncoding::Plain));
    let question = first.snapshot().prompts.remove(0);
    assert_eq!(question.until, machine.wall_time().plus_secs(human.approval.timeout_s));
    approve(&mut first, &question, &ana);
    let late = signed(&mut first, &question, &ben, ApprovalDecision::Approve).unwrap();
    drop(first);

    machine.pass(9 * DAY_MS);
    let mut second = engine(folder.path(), &human, &machine);
    work(&mut second, &id);
    assert!(second.snapshot().prompts.is_empty(), "no approver answered in time");
    assert_eq!(alarm(&second), None, "the machine was off, or suspended; its clock was not set");
    assert!(matches!(second.command(late), Reply::Refused { .. }));
    resume(&mut second, &id);
    work(&mut second, &id);
    let again = second.snapshot().prompts.remove(0);
    assert!(again.approved_by.is_empty(), "{:?}", again.approved_by);
    approve(&mut second, &again, &ben);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Shadowed, "one of two has approved");
    approve(&mut second, &again, &ana);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Active);
}

/// An answer in time counts until it expires, whatever the engine's clock says.
#[test]
fn a_first_answer_runs_out_before_the_second() {
    let folder = quick_folder();
    let machine = MachineClock::new();
    let mut human = builtin(ProfileName::Human);
    human.approval.timeout_s = 3_600.0;
    let mut first = engine(folder.path(), &human, &machine);
    let id = awaiting_approval(&mut first, PolicyOutcome::Review, Vec::new());
    let [ana, ben] =
        ["ana", "ben"].map(|name| enrolled(first.live().record, name, Role::Safety, KeyEncoding::Plain));
    let first_request = first.snapshot().prompts.remove(0);
    approve(&mut first, &first_request, &ana);
    drop(first);
    machine.pass(20 * MINUTE_MS);
    let mut second = engine(folder.path(), &human, &machine);
    work(&mut second, &id);
    let open = second.snapshot().prompts.remove(0);
    assert_eq!((open.until, open.asked), (first_request.until, first_request.asked), "it is open, unchanged");
    approve(&mut second, &open, &ben);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Shadowed, "the first has run out after 900 s");
    // No one signs for longer than the profile lets an approval count.
    let mut longer = question(&mut second, &open, "ana").unwrap();
    longer.valid_until = machine.wall_time().plus_secs(human.approval.valid_s + 1.0);
    let reply = second.command(longer.answer(&ana, ApprovalDecision::Approve, "read").unwrap());
    assert!(matches!(&reply, Reply::Refused { code: Refusal::Stale, .. }), "{reply:?}");
}

#[test]
fn a_freeze_holds_and_ends_by_wall_time_alone() {
    let folder = quick_folder();
    let machine = MachineClock::new();
    let mut sim = builtin(ProfileName::Sim);
    let until = machine.wall_time().plus_ms(DAY_MS.unsigned_abs());
    sim.freeze =
        vec![FreezeWindow { from: machine.wall_time(), until, reason: "the hall is rebuilt".to_owned() }];
    let mut first = engine(folder.path(), &sim, &machine);
    let id = at_the_gate(&mut first);
    work(&mut first, &id);
    assert!(hold_reasons(&first, &id).contains(&ReasonCode::GateFrozen));
    // The engine's clock ends no freeze; an editor could advance it by four days.
    first.jump_to(9 * DAY_MS.unsigned_abs());
    resume(&mut first, &id);
    work(&mut first, &id);
    assert!(hold_reasons(&first, &id).contains(&ReasonCode::GateFrozen));
    drop(first);

    machine.pass(DAY_MS);
    let mut second = engine(folder.path(), &sim, &machine);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Active, "the freeze ended while no engine ran");
}

#[test]
fn a_clock_that_was_set_holds_the_gate_until_a_person_confirms_the_time() {
    let folder = quick_folder();
    let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
    let mut first = engine(folder.path(), &sim, &machine);
    let id = at_the_gate(&mut first);
    machine.set(3 * DAY_MS);
    work(&mut first, &id);
    assert!(hold_reasons(&first, &id).contains(&ReasonCode::GateClockDoubted));
    assert_eq!(alarm(&first), Some(AlarmState::Unacknowledged));
    let jumped = ClockMismatch::Jumped { by_ms: 3 * DAY_MS };
    assert_eq!(first.snapshot().clock_doubt.map(|doubt| doubt.doubt), Some(jumped));
    // A clock that was set back is a mismatch as well, also for the next engine.
    machine.set(-3 * DAY_MS);
    resume(&mut first, &id);
    work(&mut first, &id);
    assert!(hold_reasons(&first, &id).contains(&ReasonCode::GateClockDoubted));
    drop(first);
    machine.pass(MINUTE_MS);
    let mut second = engine(folder.path(), &sim, &machine);
    assert_eq!(second.snapshot().clock_doubt.map(|doubt| doubt.doubt), Some(jumped));
    work(&mut second, &id);
    assert!(hold_reasons(&second, &id).contains(&ReasonCode::GateClockDoubted));

    let another = confirm(&mut second, machine.wall_time().plus_ms(10 * 60_000));
    assert!(matches!(&another, Reply::Refused { code: Refusal::Stale, .. }), "{another:?}");
    second.drain_events();
    assert_accepted(&confirm(&mut second, machine.wall_time()));
    let published = second.drain_events().into_iter().filter_map(|event| match event {
        EventKind::Recorded { kind, .. } => kind.known().copied(),
        _ => None,
    });
    assert_eq!(published.collect::<Vec<_>>(), [RecordKind::ClockConfirmed]);
    assert_eq!(second.snapshot().time, machine.wall_time(), "it may go back by no more");
    resume(&mut second, &id);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Active);
    let once = confirm(&mut second, machine.wall_time());
    assert!(matches!(&once, Reply::Refused { code: Refusal::NotNow, .. }), "{once:?}");
    drop(second);
    assert_eq!(engine(folder.path(), &sim, &machine).snapshot().clock_doubt, None);
}

#[test]
fn clock_behind_the_newest_record_is_a_mismatch() {
    let folder = quick_folder();
    let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
    let mut first = engine(folder.path(), &sim, &machine);
    machine.pass(10 * MINUTE_MS);
    let id = at_the_gate(&mut first);
    drop(first);
    machine.set(-1_000);
    let mut second = engine(folder.path(), &sim, &machine);
    let mismatch = second.snapshot().clock_doubt.map(|doubt| doubt.doubt);
    assert_eq!(mismatch, Some(ClockMismatch::Behind { by_ms: 1_000 }));
    assert_eq!(alarm(&second), Some(AlarmState::Unacknowledged), "before anything is activated");
    work(&mut second, &id);
    assert!(hold_reasons(&second, &id).contains(&ReasonCode::GateClockDoubted));
    assert_eq!(second.snapshot().time, machine.wall_time().plus_ms(1_000), "no deadline is put off");
    assert_accepted(&confirm(&mut second, machine.wall_time()));
    resume(&mut second, &id);
    work(&mut second, &id);
    assert_eq!(state(&second, &id), State::Active);
}

/// An expired request was open again.
#[test]
fn clock_set_while_no_engine_ran_is_a_mismatch() {
    for set_ms in [-50 * MINUTE_MS, 50 * MINUTE_MS] {
        let folder = quick_folder();
        let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
        let mut first = engine(folder.path(), &sim, &machine);
        // The engine stores the trusted reading where it begins and ends, and where a person confirms the time.
        machine.set(MINUTE_MS);
        assert_accepted(&confirm(&mut first, machine.wall_time()));
        drop(first);
        machine.pass(60 * MINUTE_MS);
        let second = engine(folder.path(), &sim, &machine);
        assert_eq!(second.snapshot().clock_doubt, None, "an hour later");
        drop(second);
        machine.set(set_ms);
        let third = engine(folder.path(), &sim, &machine);
        let mismatch = third.snapshot().clock_doubt.map(|doubt| doubt.doubt);
        assert_eq!(mismatch, Some(ClockMismatch::Jumped { by_ms: set_ms }));
    }
}

/// Errors below the profile's bound at each restart added up to any time.
#[test]
fn trusted_readings_survive_restarts() {
    let folder = quick_folder();
    let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
    let mut first = engine(folder.path(), &sim, &machine);
    machine.set(MINUTE_MS);
    assert_accepted(&confirm(&mut first, machine.wall_time()));
    let reading = first.record().version_table().wall().reading();
    assert!(reading.is_some());
    drop(first);
    // The profile allows five seconds.
    let step_ms = 4_000;
    assert!(sim.clock.jump_max_s < 8.0);
    machine.set(step_ms);
    let second = engine(folder.path(), &sim, &machine);
    assert_eq!(second.snapshot().clock_doubt, None, "slewed within the bound");
    assert_eq!(second.record().version_table().wall().reading(), reading);
    drop(second);
    machine.set(step_ms);
    let third = engine(folder.path(), &sim, &machine);
    let mismatch = third.snapshot().clock_doubt.map(|doubt| doubt.doubt);
    assert_eq!(mismatch, Some(ClockMismatch::Jumped { by_ms: 2 * step_ms }));
}

/// The person who waits for a decision could postpone their own deadline.
#[test]
fn a_requester_cannot_confirm_the_time() {
    let folder = quick_folder();
    let (machine, human) = (MachineClock::new(), builtin(ProfileName::Human));
    let mut pipeline = engine(folder.path(), &human, &machine);
    let id = awaiting_approval(&mut pipeline, PolicyOutcome::Review, Vec::new());
    machine.set(-10 * MINUTE_MS);
    let by = |by: &str| {
        let (by, reason) = (by.to_owned(), "compared with the hall's clock".to_owned());
        Command::ConfirmTime { by, reason, time: machine.wall_time() }
    };
    let refused = pipeline.command(by("rita"));
    let Reply::Refused { code: Refusal::NotAllowed, text, .. } = &refused else { panic!("{refused:?}") };
    assert!(text.contains(&id.to_string()), "{text}");
    assert_accepted(&pipeline.command(by("ana")));
}

/// This bypassed the gate, which meanwhile activates no version.
#[test]
fn no_version_is_reactivated_during_a_mismatch() {
    let folder = quick_folder();
    let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
    let mut pipeline = engine(folder.path(), &sim, &machine);
    let version: CapabilityId = "align@1.0.0".parse().unwrap();
    let operation = Operation { version: version.clone(), by: "ana".to_owned(), reason: "a test".to_owned() };
    assert_accepted(&pipeline.command(Command::Vacate(operation.clone())));
    machine.set(MINUTE_MS);
    let refused = pipeline.command(Command::Rearm(operation.clone()));
    assert!(matches!(refused, Reply::Refused { code: Refusal::NotNow, .. }), "{refused:?}");
    assert_accepted(&confirm(&mut pipeline, machine.wall_time()));
    assert_accepted(&pipeline.command(Command::Rearm(operation)));
    assert_eq!(state(&pipeline, &version), State::Active);
}

/// The time since the machine's start advances while it is suspended.
#[test]
fn suspended_machine_is_no_clock_mismatch() {
    let folder = quick_folder();
    let (machine, sim) = (MachineClock::new(), builtin(ProfileName::Sim));
    let mut pipeline = engine(folder.path(), &sim, &machine);
    let id = at_the_gate(&mut pipeline);
    machine.pass(3 * DAY_MS);
    machine.set(4_000);
    work(&mut pipeline, &id);
    assert_eq!((state(&pipeline, &id), alarm(&pipeline)), (State::Active, None));
}
