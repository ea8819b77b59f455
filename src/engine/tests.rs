//! Restarts, and the identity of a store.

use std::path::Path;
use std::sync::Arc;

use holdpoint_approvals::keyfile::KeyEncoding;
use holdpoint_approvals::{Approval, Nonce};
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_cell::{CellSource as _, CellSpec};
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Kappa;
use holdpoint_governance::evidence::{EpisodeValues, StaleCause};
use holdpoint_governance::gate::ShadowAssessment;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage, State};
use holdpoint_governance::notice::{BoundPart, Notice, NoticeOrText};
use holdpoint_governance::outcome::{
    Assessment, Basis, BehaviorOutcome, CheckResult, InterfaceOutcome, PolicyOutcome, RecoveryOutcome,
};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::profile_downgrade::ProfileRules;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Command, Operation, Refusal, Reply, Request, StopPersistence};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Store;
use holdpoint_runtime::agent::Agent;
use holdpoint_runtime::capability::{self, Capability};
use holdpoint_sim::SimCells;
use holdpoint_store::{AuditFilter, Change, EvidenceKind, StoreError};

use crate::decide::people::persons::enrolled;
use crate::decide::pipeline::{Pipeline, SliceOutcome};
use crate::live::fake_cell::StubFactory;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::{pipeline, resting_pipeline};
use crate::{Config, Engine, StartError};
use holdpoint_record::version_table::TransitionNote;
use holdpoint_text::{ErrorReason, Hint};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

/// The scripted cell of a built-in robot.
fn scripted_cell(robot: &str) -> Cell {
    let scripted = StubFactory::exporting();
    let abilities = scripted.spec.abilities;
    let simulated = SimCells.builtin(Some(robot)).unwrap();
    let spec = Arc::new(CellSpec { abilities, ..CellSpec::clone(simulated.spec()) });
    StubFactory { spec, ..scripted }.into_cell()
}

/// The settings of a script, in the scripted cell of this robot.
pub(crate) fn config<'a>(folder: &'a Path, robot: &str) -> Config<'a> {
    Config {
        data: folder,
        profile: ProfileName::Sim.into(),
        seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(CALIBRATION_FROM_RUN),
        jobs: 1,
        scripted: true,
        cell: scripted_cell(robot),
        cache: EpisodeCache::InStore,
    }
}

fn engine(folder: &Path, robot: &str) -> Result<Engine, StartError> {
    Engine::start(config(folder, robot))
}

/// The change of a script that sets the context of a built-in profile.
pub(crate) fn context_change((profile, policy_digest, json): (ProfileName, Digest, String)) -> Change {
    let built_in = Profile::builtin(profile).unwrap();
    let rules = ProfileRules::of(&built_in, &PolicyTable::builtin(&built_in).unwrap()).unwrap();
    let rules = Some(Box::new(ProfileHistory::default().next(&rules, true)));
    Change::SetContext { profile, policy_digest, json, rules }
}

/// Puts a change into a store, and closes it.
fn commit(store: Store, change: Change) {
    let at_ms = store.opening().head.at_ms;
    let (command_id, audit) = ("test".to_owned(), Vec::new());
    let changes = vec![change];
    store.commit(holdpoint_store::Transaction { command_id, at_ms, wall_ms: 0, changes, audit }).unwrap();
}

pub(crate) fn assert_accepted(reply: &Reply) {
    let done =
        matches!(reply, Reply::Accepted { .. } | Reply::Stopped { kept: StopPersistence::OnRecord, .. });
    assert!(done, "{reply:?}");
}

#[test]
fn open_alarms_survive_a_restart_unchanged() {
    let folder = quick_folder();
    let id: CapabilityId = "grasp@1.0.0".parse().unwrap();
    let mut first = resting_pipeline(folder.path(), ProfileName::Sim);
    let record = &mut *first.live().record;
    let taken_off = AlarmKey::RolledBack(id.clone());
    let notice = Notice::Restricted { version: id.clone(), reason: None };
    record.raise(taken_off.clone(), Priority::Critical, true, notice.clone());
    record.alarm_event(&AlarmEvent::Acknowledge { key: taken_off.clone(), by: "ana".to_owned() });
    record.alarm_event(&AlarmEvent::Clear { key: taken_off });
    record.raise(AlarmKey::Violation(id), Priority::High, true, notice);
    let (alarms, summary) = (first.snapshot().alarms, first.snapshot().alarm_summary);
    assert_eq!((alarms.len(), summary.latched, summary.unacknowledged), (2, 1, [0, 1, 0]));
    drop(first);
    let second = resting_pipeline(folder.path(), ProfileName::Sim);
    assert_eq!(second.snapshot().alarms, alarms);
    assert_eq!(second.snapshot().alarm_summary, summary);
}

#[test]
fn another_robot_is_refused_before_anything_is_written() {
    let folder = quick_folder();
    drop(engine(folder.path(), "arm7").unwrap());
    let head = || Store::open(folder.path()).unwrap().opening().head.seq;
    let before = head();
    let refused = engine(folder.path(), "arm6").err().unwrap();
    assert!(matches!(refused, StartError::OtherRobot { .. }), "{refused}");
    assert!(refused.to_string().contains("arm7") && refused.to_string().contains("arm6"), "{refused}");
    assert!(refused.hint().unwrap().contains("without `--robot`"), "{:?}", refused.hint());
    assert_eq!(head(), before);
    assert_eq!(engine(folder.path(), "arm7").unwrap().snapshot().robot, "arm7");
}

/// The pointer names its robot itself: a context without a robot, as earlier versions wrote it, does not matter.
#[test]
fn a_pointer_of_another_robot_is_refused_under_any_context() {
    let folder = quick_folder();
    drop(engine(folder.path(), "arm7").unwrap());
    let store = Store::open(folder.path()).unwrap();
    let pointers = store.views().unwrap().pointer_robots().unwrap();
    assert_eq!(pointers.len(), store.views().unwrap().families().unwrap().len(), "{pointers:?}");
    let (profile, policy_digest, json) = store.views().unwrap().context().unwrap().unwrap();
    let mut context: serde_json::Value = serde_json::from_str(&json).unwrap();
    context.as_object_mut().unwrap().remove("robot").unwrap();
    let change = context_change((profile, policy_digest, context.to_string()));
    commit(store, change);
    let refused = engine(folder.path(), "arm6").err().unwrap();
    assert!(matches!(refused, StartError::Store(StoreError::OtherRobot { .. })), "{refused}");
    assert!(refused.hint().unwrap().contains("--data"), "{:?}", refused.hint());
    drop(engine(folder.path(), "arm7").unwrap());
}

/// Authority is still taken away where the rows are intact; nothing more is decided or activated.
#[test]
fn store_changed_under_a_running_engine_halts_it() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Sim);
    let other = rusqlite::Connection::open(folder.path().join("holdpoint.db")).unwrap();
    other.execute_batch("UPDATE family SET reason = 'edited' WHERE name = 'align'").unwrap();
    let version: CapabilityId = "grasp@1.0.0".parse().unwrap();
    let operation = Operation { version, by: "ada".to_owned(), reason: "a test".to_owned() };
    assert_accepted(&pipeline.command(Command::Restrict(operation)));
    pipeline.advance();
    let holding = pipeline.record().holding().map(Hint::sentence).unwrap_or_default();
    assert!(holding.contains("\"align\""), "the row is named: {holding}");
    drop(pipeline);
    assert!(matches!(Store::open(folder.path()), Err(holdpoint_store::StoreError::Refused { .. })));
}

#[test]
fn another_agent_halts_the_engine() {
    let folder = quick_folder();
    let mut first = resting_pipeline(folder.path(), ProfileName::Sim);
    assert_eq!(first.record().holding(), None);
    // At each activation ...
    first.live().world.cell.replace_agent(Agent::called("another"));
    assert!(!first.activation().agent.is_same());
    drop(first);
    // ... and at each start.
    let store = Store::open(folder.path()).unwrap();
    let (profile, policy_digest, json) = store.views().unwrap().context().unwrap().unwrap();
    let mut context: serde_json::Value = serde_json::from_str(&json).unwrap();
    context["agent"] = serde_json::json!(Agent::called("another").identity_hash());
    let change = context_change((profile, policy_digest, context.to_string()));
    commit(store, change);
    let second = resting_pipeline(folder.path(), ProfileName::Sim);
    let recorded = Agent::called("another").identity_hash().short();
    assert!(second.record().holding().is_some_and(|why| why.sentence().contains(&recorded)), "it is named");
}

#[test]
fn a_cell_that_drifts_alarms_within_ten_sequences_without_a_candidate() {
    let folder = quick_folder();
    let mut pipeline = pipeline(folder.path(), ProfileName::Sim);
    let drift = Drift { kind: DriftKind::Combined, magnitude: Magnitude::Strong };
    pipeline.live().world.cell.set_drift(Some(drift)).unwrap();
    let degraded = |pipeline: &Pipeline| {
        pipeline.record().alarms().iter().any(|alarm| matches!(alarm.key, AlarmKey::Degraded(_)))
    };
    for _ in 0..10 {
        pipeline.work_one();
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
    }
    assert!(degraded(&pipeline), "{:?}", pipeline.snapshot().alarms);
    assert!(pipeline.snapshot().candidates.is_empty());
}

/// Two candidates that were each evaluated beside the earlier versions are not activated together: evidence with another
/// neighbor does not count.
#[test]
fn evidence_beside_other_active_versions_is_stale() {
    let folder = quick_folder();
    let mut bench = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut bench);
    let stale = |bench: &Pipeline, id: &CapabilityId| {
        let snapshot = bench.snapshot();
        let found = snapshot.candidates.iter().find(|one| one.version == *id).map(|one| one.stale.clone());
        found.unwrap()
    };
    assert_eq!(stale(&bench, &id), []);
    let neighbour = Operation {
        version: "place@1.0.0".parse().unwrap(),
        by: "ada".to_owned(),
        reason: "another one comes".to_owned(),
    };
    assert_accepted(&bench.command(Command::Vacate(neighbour)));
    assert_eq!(stale(&bench, &id), [StaleCause::Neighbours]);
    bench.advance();
    let state = bench.record().version_table().version(&id).unwrap().1.state;
    assert_ne!(state, State::Active);
}

/// Sets kappas that pass every limit, so that only the tested part can stop a candidate at the gate.
pub(crate) fn at_the_gate(pipeline: &mut Pipeline) -> CapabilityId {
    candidate_past_shadow(pipeline, PolicyOutcome::Compatible, Vec::new())
}

const GOOD: EpisodeValues = EpisodeValues { time_s: 2.0, ..EpisodeValues::CLEAN };

/// Runs until nothing is left to do or the engine is halted.
fn work(pipeline: &mut Pipeline, id: &CapabilityId) -> Option<State> {
    for _ in 0..4 {
        pipeline.advance();
        let state = pipeline.record().version_table().version(id).unwrap().1.state;
        if state == State::Active || pipeline.record().holding().is_some() {
            return Some(state);
        }
    }
    None
}

#[test]
fn no_version_becomes_active_under_another_agent() {
    // The same candidate takes over where the agent is the store's.
    let folder = quick_folder();
    let mut same = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut same);
    assert_eq!(work(&mut same, &id), Some(State::Active));

    let folder = quick_folder();
    let mut other = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut other);
    let before = other.record().active_of(&id.family).unwrap().id();
    other.live().world.cell.replace_agent(Agent::called("another"));
    assert_eq!(work(&mut other, &id), Some(State::Shadowed));
    let present = Agent::called("another").identity_hash().short();
    assert!(other.record().holding().is_some_and(|why| why.sentence().contains(&present)), "it is named");
    assert_eq!(other.record().active_of(&id.family).unwrap().id(), before);
    let events = other.drain_events();
    assert!(!events.iter().any(|event| matches!(event, EventKind::Activated { .. })), "{events:?}");

    // Nor by break-glass, before its approval is considered.
    let folder = quick_folder();
    let mut locked = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut locked);
    let ana = enrolled(locked.live().record, "ana", Role::Safety, KeyEncoding::Plain);
    let digest = locked.record().capability(&id).unwrap().digest();
    let approval = Approval {
        who: String::new(),
        role: Role::Safety,
        decision: ApprovalDecision::Approve,
        reason: "the line stands".to_owned(),
        version: id.clone(),
        candidate_digest: digest,
        row_version: 1,
        evidence_digest: digest,
        policy_digest: digest,
        profile: ProfileName::Sim,
        store_id: String::new(),
        nonce: Nonce::random().unwrap(),
        not_after_ms: u64::MAX,
        break_glass: true,
        shown: None,
    };
    let signed = ana.sign(approval).unwrap();
    assert!(locked.activation().break_glass(signed.clone()).is_ok(), "it is answered");
    locked.live().world.cell.replace_agent(Agent::called("another"));
    assert!(locked.activation().break_glass(signed).is_err(), "and held");
    assert_eq!(locked.record().active_of(&id.family).unwrap().id(), before);

    // A stopped family is not reactivated for it.
    let folder = quick_folder();
    let mut stopped = resting_pipeline(folder.path(), ProfileName::Sim);
    let version: CapabilityId = "align@1.0.0".parse().unwrap();
    let operation = |reason: &str| Operation {
        version: version.clone(),
        by: "ada".to_owned(),
        reason: reason.to_owned(),
    };
    assert_accepted(&stopped.command(Command::Vacate(operation("drill"))));
    stopped.live().world.cell.replace_agent(Agent::called("another"));
    let reply = stopped.command(Command::Rearm(operation("it is looked at")));
    assert!(matches!(reply, Reply::Refused { .. }), "{reply:?}");
    assert!(stopped.record().holding().is_some());
    assert!(stopped.record().active_of(&version.family).is_none());
}

#[test]
fn unreadable_context_is_an_error_and_binds_nothing() {
    let folder = quick_folder();
    drop(engine(folder.path(), "arm7").unwrap());
    let store = Store::open(folder.path()).unwrap();
    let (profile, policy_digest, _) = store.views().unwrap().context().unwrap().unwrap();
    let change = context_change((profile, policy_digest, "{\"robot\":7}".to_owned()));
    commit(store, change);
    let error = engine(folder.path(), "arm6").err().unwrap();
    assert_eq!(error.details().unwrap().reason, ErrorReason::BadInput, "{error}");
    let stored = Store::open(folder.path()).unwrap().views().unwrap().context().unwrap().unwrap().2;
    assert_eq!(stored, "{\"robot\":7}");
}

#[test]
fn stale_evidence_is_reported_with_its_cause() {
    let folder = quick_folder();
    let mut first = resting_pipeline(folder.path(), ProfileName::Sim);
    let id = at_the_gate(&mut first);
    let evidence_file = first.live().evidence_files.of(&id).unwrap().clone();
    let (json, digest) = (serde_json::to_string(&evidence_file).unwrap(), evidence_file.digest().unwrap());
    let evidence = Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Shadow, json, digest };
    first.live().record.write(vec![evidence], Vec::new()).unwrap();
    let stale = |pipeline: &Pipeline| {
        let candidates = pipeline.snapshot().candidates;
        candidates.into_iter().find(|candidate| candidate.version == id).unwrap().stale
    };
    let voided = |pipeline: &mut Pipeline| {
        let events = pipeline.drain_events().into_iter().filter_map(|event| match event {
            EventKind::Voided { family, reason } => Some((family.to_string(), reason)),
            _ => None,
        });
        events.collect::<Vec<_>>()
    };
    assert_eq!(stale(&first), []);
    assert_eq!(voided(&mut first), [], "nothing was gathered before the first start");
    drop(first);
    let mut again = resting_pipeline(folder.path(), ProfileName::Sim);
    assert_eq!((stale(&again), voided(&mut again)), (Vec::new(), Vec::new()), "nothing has changed");
    drop(again);
    let mut second = resting_pipeline(folder.path(), ProfileName::Human);
    assert_eq!(stale(&second), [StaleCause::Profile]);
    let reports = voided(&mut second);
    let families: Vec<&str> = reports.iter().map(|(family, _)| family.as_str()).collect();
    assert_eq!(families, ["align", "grasp", "park", "place"]);
    let ends_with_profile = |reason: &NoticeOrText| matches!(reason.notice(), Some(Notice::BindingChanged { parts }) if parts.last() == Some(&BoundPart::Profile));
    assert!(reports.iter().all(|(_, reason)| ends_with_profile(reason)), "{reports:?}");
    let view = serde_json::to_value(second.snapshot().candidates.remove(0)).unwrap();
    assert_eq!(view["stale"], serde_json::json!(["profile"]));
    // No other engine may change what a script left where approval is required.
    drop(second);
    let head = || Store::open(folder.path()).unwrap().opening().head.seq;
    let before = head();
    let seeds = holdpoint_trials::seeds::EpisodeSeeds::Secret;
    let live = Config { scripted: false, seeds, ..config(folder.path(), "arm7") };
    let refused = Engine::start(live).err().unwrap();
    assert!(matches!(refused, StartError::Store(StoreError::UnauthorizedProfile { .. })), "{refused}");
    assert_eq!(head(), before, "nothing was written");
    // In its former context it counts again.
    assert_eq!(stale(&resting_pipeline(folder.path(), ProfileName::Sim)), []);
    // Another active version is another comparison.
    let mut third = resting_pipeline(folder.path(), ProfileName::Sim);
    let operation = Operation {
        version: "align@1.0.0".parse().unwrap(),
        by: "ada".to_owned(),
        reason: "drill".to_owned(),
    };
    assert_accepted(&third.command(Command::Vacate(operation)));
    assert_eq!(stale(&third), [StaleCause::ActiveVersion]);
}

pub(crate) fn compatible<O>(outcome: O) -> Assessment<O> {
    let kappa = Kappa::new(0.97);
    Assessment { outcome, kappa, basis: Basis::Measured, reasons: Vec::new(), conditions: Vec::new() }
}

/// A candidate with an approval request under these conditions, without its evaluation: the tests cover later steps.
pub(crate) fn awaiting_approval(
    pipeline: &mut Pipeline,
    policy: PolicyOutcome,
    conditions: Vec<Condition>,
) -> CapabilityId {
    let id = candidate_past_shadow(pipeline, policy, conditions);
    pipeline.activation().run(&id).unwrap();
    id
}

/// A candidate that has passed shadow, without its evaluation.
fn candidate_past_shadow(
    pipeline: &mut Pipeline,
    policy: PolicyOutcome,
    conditions: Vec<Condition>,
) -> CapabilityId {
    const NAME: &str = "align-improved";
    let package = capability::read(&Path::new(crate::MANIFESTS).join("candidates").join(NAME)).unwrap();
    let id = Capability::load(NAME, package.clone()).unwrap().id();
    let by = Some("rita".to_owned());
    assert_accepted(&pipeline.command(Command::Register { package, name: NAME.to_owned(), by }));
    let candidate = pipeline.record().capability(&id).unwrap();
    let live = pipeline.live();
    let bound =
        holdpoint_record::evidence_binding::binding(live.context, live.record.version_table(), &candidate);
    let sequences = live.context.profile.evaluation.shadow_sequences;
    let evidence_file = live.evidence_files.edit(&id);
    evidence_file.kappas = Some(Kappas {
        interface: compatible(InterfaceOutcome::Compatible),
        policy: Assessment { conditions, ..compatible(policy) },
        behavior: compatible(BehaviorOutcome::Compatible),
        recovery: compatible(RecoveryOutcome::Compatible),
    });
    evidence_file.bindings = vec![bound];
    evidence_file.twins = vec![GOOD; 40];
    evidence_file.shadow = Some(ShadowAssessment {
        check: CheckResult::Pass,
        sequences,
        output_divergence: None,
        envelope_divergence: None,
        alignment: None,
        reasons: Vec::new(),
    });
    let (json, digest) = (serde_json::to_string(evidence_file).unwrap(), evidence_file.digest().unwrap());
    let version = live.record.version_table().version(&id).unwrap().0;
    for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow] {
        for event in [LifecycleEvent::Start { version, stage }, LifecycleEvent::Pass { version, stage }] {
            live.record.transition(&id.family, event, TransitionNote::because(Notice::StageBegins)).unwrap();
        }
    }
    let evidence = Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Shadow, json, digest };
    live.record.write(vec![evidence], Vec::new()).unwrap();
    id
}

/// The paper's seven calls by name on an engine inside a program, without further effects.
#[test]
fn candidate_passes_through_the_seven_calls_of_the_paper() {
    let folder = quick_folder();
    let cell = Cell::of(&SimCells, None).unwrap();
    let mut engine = Engine::start(Config { cell, ..config(folder.path(), "arm7") }).unwrap();
    engine.begin_on_call();
    let package = capability::read(&Path::new(crate::MANIFESTS).join("candidates/align-improved")).unwrap();
    let id = Capability::load("test", package.clone()).unwrap().id();
    let view = |engine: &Engine| {
        let candidates = engine.snapshot().candidates;
        candidates.into_iter().find(|view| view.version == id).unwrap()
    };
    let until = |engine: &mut Engine, state: State| {
        for _ in 0..20_000 {
            if view(engine).state == state {
                return;
            }
            engine.advance();
            assert_eq!(engine.holding(), None);
        }
        panic!("it is {} and not {state}", view(engine).state);
    };
    let rests = |engine: &mut Engine, state: State| {
        for _ in 0..3 {
            engine.advance();
        }
        let found = view(engine);
        assert_eq!((found.state, found.flags.running), (state, None), "nothing begins without a call");
    };
    let operation = || Operation { version: id.clone(), by: "ada".to_owned(), reason: "a test".to_owned() };

    assert_accepted(&engine.register_candidate(package, "test"));
    rests(&mut engine, State::Registered);
    let early = engine.launch_shadow_eval(&id);
    assert!(matches!(early, Reply::Refused { .. }), "no stage is jumped over: {early:?}");
    assert_accepted(&engine.run_compat_checks(&id));
    rests(&mut engine, State::Validated);
    assert_accepted(&engine.launch_sandbox_eval(&id));
    until(&mut engine, State::Sandboxed);
    rests(&mut engine, State::Sandboxed);
    assert_accepted(&engine.launch_shadow_eval(&id));
    until(&mut engine, State::Shadowed);
    rests(&mut engine, State::Shadowed);
    assert_accepted(&engine.activate_candidate(&id));
    until(&mut engine, State::Active);
    assert_accepted(&engine.restrict_candidate(operation()));
    assert!(view(&engine).flags.restricted);
    assert_accepted(&engine.rollback_candidate(operation()));
    assert_eq!(view(&engine).state, State::RolledBack);
    let family = engine.snapshot().families.into_iter().find(|view| view.family == id.family).unwrap();
    assert_eq!(family.active.map(|active| active.to_string()).as_deref(), Some("align@1.0.0"));
}

/// A script set the goal without a record, and the engine lost it at its end.
#[test]
fn a_goal_is_recorded_and_outlasts_a_restart() {
    let folder = quick_folder();
    let goal = |goal: &str, reason: &str| Command::Goal {
        goal: goal.to_owned(),
        by: "ada".to_owned(),
        reason: reason.to_owned(),
    };
    let works = |pipeline: &mut Pipeline| {
        let report = pipeline.live().sequence(None).unwrap();
        (report.planned, pipeline.snapshot().live.goal)
    };
    let mut first = resting_pipeline(folder.path(), ProfileName::Sim);
    assert_eq!(works(&mut first), (3, "pick-align-place".to_owned()));
    for wrong in [goal("fly", "a test"), goal("grasp", " ")] {
        let reply = first.command(wrong);
        assert!(matches!(reply, Reply::Refused { .. }), "{reply:?}");
    }
    assert_eq!(works(&mut first).0, 3, "what is refused changes nothing");
    first.drain_events();
    assert_accepted(&first.command(goal("grasp", "the tray is being cleaned")));
    let is_goal_set = |event: &EventKind| {
        matches!(event, EventKind::GoalSet { goal, by, reason }
            if goal == "grasp" && by == "ada" && reason == "the tray is being cleaned")
    };
    assert!(first.drain_events().iter().any(is_goal_set));
    assert_eq!(works(&mut first), (1, "grasp".to_owned()));
    let filter = AuditFilter { kind: Some(RecordKind::GoalSet), ..AuditFilter::default() };
    let records = first.record().version_table().store().views().unwrap().audit(&filter).unwrap();
    let [record] = records.as_slice() else { panic!("{records:?}") };
    let body: serde_json::Value = serde_json::from_str(&record.body).unwrap();
    assert_eq!(body["reason"], "the tray is being cleaned");
    drop(first);
    let mut second = resting_pipeline(folder.path(), ProfileName::Sim);
    assert_eq!(works(&mut second), (1, "grasp".to_owned()));
}

/// A repeated id was answered regardless of the command: a stop got the answer that the cell runs again.
#[test]
fn request_id_identifies_one_command_and_a_stop_is_always_carried_out() {
    let folder = quick_folder();
    let mut engine = engine(folder.path(), "arm7").unwrap();
    let mut submit = |command: Command| engine.submit(Request::unsigned("same".to_owned(), command));
    let stop = || Command::Stop { by: "ann".to_owned(), reason: "a test".to_owned() };
    assert_accepted(&submit(stop()));
    let go = |engine: &Engine| {
        let stopped = engine.snapshot().stopped.unwrap();
        let (since_ms, stops) = (stopped.since_ms, stopped.stops);
        Command::Go { by: "ann".to_owned(), reason: "looked at".to_owned(), since_ms, stops }
    };
    let command = go(&engine);
    let mut submit = |command: Command| engine.submit(Request::unsigned("same".to_owned(), command));
    let other = submit(command);
    assert!(matches!(&other, Reply::Refused { code: Refusal::BadInput, .. }), "{other:?}");
    assert_accepted(&submit(stop()));
    let command = go(&engine);
    let mut submit = |id: &str, command: Command| engine.submit(Request::unsigned(id.to_owned(), command));
    assert_accepted(&submit("second", command.clone()));
    assert_accepted(&submit("second", command));
    let stopped = submit("second", stop());
    assert!(matches!(&stopped, Reply::Stopped { kept: StopPersistence::OnRecord, .. }), "{stopped:?}");
    assert!(engine.snapshot().stopped.is_some());
}

/// A request about a baseline was visible, but could not be opened.
#[test]
fn a_baseline_with_an_open_request_is_shown_with_its_evidence() {
    let folder = quick_folder();
    let mut pipeline = resting_pipeline(folder.path(), ProfileName::Human);
    let operation = |reason: &str| Operation {
        version: "align@1.0.0".parse().unwrap(),
        by: "ann".to_owned(),
        reason: reason.to_owned(),
    };
    assert!(pipeline.snapshot().candidates.is_empty());
    assert_accepted(&pipeline.command(Command::Restrict(operation("careful"))));
    assert_accepted(
        &pipeline.command(Command::Release { operation: operation("looked at"), profiles: Vec::new() }),
    );
    let snapshot = pipeline.snapshot();
    let shown: Vec<_> = snapshot.candidates.iter().map(|one| one.version.clone()).collect();
    assert_eq!(shown, [snapshot.prompts[0].version.clone()]);
}
