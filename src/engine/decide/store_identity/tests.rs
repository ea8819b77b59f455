//! An update of the program changes the profile that it comes with: until an administrator signs, the store opens, stops and takes
//! versions off, and activates nothing.

mod site;

use std::path::Path;

use holdpoint_approvals::SignedProfileAct;
use holdpoint_audit::profile_history::ContextRules;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::outcome::PolicyOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Caller, Command, Operation, Reply};
use holdpoint_registry::{Store, allow_profile, verify};
use holdpoint_store::{Change, Transaction};
use holdpoint_trials::seeds::EpisodeSeeds;

use super::*;
use crate::decide::people::persons::guarded;
use crate::live::stop_switch::StopRequest;
use crate::quick_folder::quick_folder;
use crate::tests::{assert_accepted, at_the_gate, awaiting_approval, config};
use crate::{Config, Engine, StartError};
use holdpoint_record::wall_clock::WallClock;

/// An engine that is no script's.
fn live(folder: &Path, profile: ProfileName) -> Result<Engine, StartError> {
    let seeds = EpisodeSeeds::Secret;
    Engine::start(Config { scripted: false, seeds, profile: profile.into(), ..config(folder, "arm7") })
}

/// An administrator authorizes these rules of `human`.
fn authorized(store: &Store, rules: &ContextRules) {
    let folder = store.layout().identities();
    let admin = guarded(&folder, &store.persons().unwrap().unprotected_administrator(&folder).unwrap());
    let views = store.views().unwrap();
    let change = views.profiles().unwrap().change_to(rules);
    let end = (store.store_id(), views.head().unwrap().hash);
    let act = SignedProfileAct::by(&admin, (ProfileName::Human, change), end, "read").unwrap();
    allow_profile(store, ProfileName::Human, ("{}".to_owned(), act), 0).unwrap();
}

/// The profile as this program has it, on a store as it is.
fn next(store: &Store) -> ContextRules {
    let profile = Profile::builtin(ProfileName::Human).unwrap();
    let rules = ProfileRules::of(&profile, &PolicyTable::builtin(&profile).unwrap()).unwrap();
    store.opening().profiles.next(&rules, false)
}

/// The store as a program leaves it that has another profile `human`: one field has another number there, one is tighter
/// here, and one is not there.
fn left_by_another_program(folder: &Path) {
    let store = Store::open(folder).unwrap();
    let mut rules = next(&store);
    rules.digest = Digest::of_parts("test", &[b"another program"]);
    rules.settings.insert("approval.timeout_s".to_owned(), "500".to_owned()).unwrap();
    rules.settings.insert("runtime.retries_max".to_owned(), "2".to_owned()).unwrap();
    rules.settings.remove("monitor.slow_factor").unwrap();
    authorized(&store, &rules);
    let (profile, policy_digest, json) = store.views().unwrap().context().unwrap().unwrap();
    let change = Change::SetContext { profile, policy_digest, json, rules: Some(Box::new(rules)) };
    let at_ms = store.opening().head.at_ms;
    let (command_id, changes) = ("another program".to_owned(), vec![change]);
    store.commit(Transaction { command_id, at_ms, wall_ms: 0, changes, audit: Vec::new() }).unwrap();
}

#[test]
fn changed_profile_activates_no_version_until_an_administrator_signs() {
    let folder = quick_folder();
    drop(live(folder.path(), ProfileName::Human).unwrap());
    left_by_another_program(folder.path());
    let contexts = |store: &Store| store.views().unwrap().profiles().unwrap();
    let before = contexts(&Store::open(folder.path()).unwrap());
    let mut engine = live(folder.path(), ProfileName::Human).unwrap();
    let why = engine.snapshot().unauthorized.unwrap();
    assert!(["approval.timeout_s", "600", "500"].iter().all(|part| why.contains(part)), "{why}");
    let is_raised = |engine: &Engine| {
        let key = AlarmKey::ProfileUnauthorized.to_string();
        engine.snapshot().alarms.iter().any(|alarm| alarm.alarm == key && alarm.state.is_present())
    };
    assert!(is_raised(&engine));
    let pipeline = &mut engine.pipeline;
    // The gate holds what would pass, whatever it was asked.
    let id = awaiting_approval(pipeline, PolicyOutcome::Compatible, Vec::new());
    let evidence_file = pipeline.live().evidence_files.of(&id).unwrap().clone();
    assert!(
        evidence_file.reasons.iter().any(|reason| reason.code == ReasonCode::GateProfileUnauthorized),
        "{evidence_file:?}"
    );
    assert!(evidence_file.held);
    assert_eq!(pipeline.record().version_table().version(&id).unwrap().1.state, State::Shadowed);
    // Nothing runs, and no one can start the arm.
    for _ in 0..20 {
        pipeline.work_one();
        pipeline.advance();
    }
    assert_eq!(pipeline.snapshot().live.sequences, 0);
    let (by, reason) = ("ada".to_owned(), "a try".to_owned());
    let stop =
        StopRequest { id: "1".to_owned(), by: by.clone(), reason: reason.clone(), caller: Caller::Script };
    assert_accepted(&pipeline.halt(stop));
    let since_ms = pipeline.snapshot().stopped.unwrap().since_ms;
    let go = Command::Go { by: by.clone(), reason: reason.clone(), since_ms, stops: 1 };
    let refused = pipeline.command(go);
    assert!(matches!(&refused, Reply::Refused { text, .. } if *text == why), "{refused:?}");
    let operation =
        Operation { version: "grasp@1.0.0".parse().unwrap(), by: by.clone(), reason: reason.clone() };
    assert_accepted(&pipeline.command(Command::Vacate(operation.clone())));
    assert!(pipeline.record().active_of(&operation.version.family).is_none());
    let refused = pipeline.command(Command::Rearm(operation));
    assert!(matches!(&refused, Reply::Refused { text, .. } if *text == why), "{refused:?}");
    assert_eq!(pipeline.record().holding(), None);
    drop(engine);
    // Another profile than the one on record does not come up so.
    let refused = live(folder.path(), ProfileName::Real).err().unwrap();
    assert!(matches!(refused, StartError::Store(StoreError::UnauthorizedProfile { .. })), "{refused}");
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(contexts(&store), before, "an unsigned profile is not in force");
    // An administrator who was shown another list has signed something else.
    let mut other = next(&store);
    other.loosened.pop();
    authorized(&store, &other);
    drop(store);
    assert!(live(folder.path(), ProfileName::Human).unwrap().snapshot().unauthorized.is_some());
    let store = Store::open(folder.path()).unwrap();
    authorized(&store, &next(&store));
    drop(store);
    let engine = live(folder.path(), ProfileName::Human).unwrap();
    assert_eq!(engine.snapshot().unauthorized, None);
    let key = *engine.pipeline.record().version_table().store().public_key();
    drop(engine);
    let engine = live(folder.path(), ProfileName::Human).unwrap();
    assert!(!is_raised(&engine), "{:?} {:?}", engine.snapshot().alarms, engine.snapshot().unauthorized);
    drop(engine);
    verify(&folder.path().join("holdpoint.db"), Some(&key)).unwrap();
}

/// After a crash between two transactions, evidence of the earlier context counted under the new one.
#[test]
fn context_and_voided_families_are_written_together() {
    let folder = quick_folder();
    drop(Engine::start(config(folder.path(), "arm7")).unwrap());
    let store = Store::open(folder.path()).unwrap();
    let at_ms = store.opening().head.at_ms;
    let mut table = VersionTable::open(Box::new(store), WallClock::scripted(0, None)).unwrap();
    assert!(table.families().count() > 1);
    // Only one family can be voided.
    let index = "CREATE UNIQUE INDEX refuse ON family (void_seq > 0) WHERE void_seq > 0";
    let database = table.store().layout().database();
    rusqlite::Connection::open(database).and_then(|other| other.execute_batch(index)).unwrap();
    let recorded = |table: &VersionTable| table.store().views().unwrap().context().unwrap();
    let before = recorded(&table);
    let agent = agent(&*table.store().views().unwrap()).unwrap().unwrap();
    let profile = Profile::builtin(ProfileName::Human).unwrap();
    let policies = PolicyTable::builtin(&profile).unwrap();
    let context = Context::new(profile, policies, None, config(folder.path(), "arm7").cell).unwrap();
    assert!(set_context(&context, &mut table, agent, (at_ms, true)).is_err());
    assert_eq!(recorded(&table), before);
}

/// Regression: a script started a stopped cell and registered a version in the name of an uninvolved person.
#[test]
fn script_cannot_use_a_store_of_a_live_profile() {
    let folder = quick_folder();
    drop(live(folder.path(), ProfileName::Human).unwrap());
    let end = || Store::open(folder.path()).unwrap().opening().head.seq;
    let before = end();
    for profile in ProfileName::ALL {
        let requested = Config { profile: profile.into(), ..config(folder.path(), "arm7") };
        let refused = Engine::start(requested).err().unwrap();
        assert!(matches!(refused, StartError::Store(StoreError::ScriptAfterLive)), "{profile}: {refused}");
    }
    assert_eq!(end(), before, "nothing is written");
    live(folder.path(), ProfileName::Human).unwrap();
}

/// A version that became active under `sim`, or in a script, stayed in control near people.
#[test]
fn a_less_strict_activation_ends_under_a_stricter_profile() {
    let id: CapabilityId = "align@1.1.0".parse().unwrap();
    for scripted in [false, true] {
        let folder = quick_folder();
        let sim = |scripted| {
            let script = config(folder.path(), "arm7");
            if scripted {
                Engine::start(script).unwrap()
            } else {
                live(folder.path(), ProfileName::Sim).unwrap()
            }
        };
        let state = |engine: &Engine| engine.pipeline.record().version_table().version(&id).unwrap().1.state;
        let mut engine = sim(scripted);
        at_the_gate(&mut engine.pipeline);
        while state(&engine) != State::Active && engine.pipeline.record().holding().is_none() {
            engine.pipeline.advance();
        }
        assert_eq!(state(&engine), State::Active);
        let requester = |engine: &Engine| {
            engine.pipeline.record().version_table().version(&id).unwrap().2.origin.requester.clone()
        };
        assert_eq!(requester(&engine).name() == "rita", scripted, "a script names whom it likes");
        drop(engine);
        let engine = sim(false);
        assert_eq!((state(&engine), requester(&engine).name() == "rita"), (State::Active, false));
        drop(engine);
        let engine = live(folder.path(), ProfileName::Human).unwrap();
        assert_eq!(state(&engine), State::Demoted);
        let active = engine.pipeline.record().active_of(&id.family).unwrap();
        assert_eq!(active.id().to_string(), "align@1.0.0");
        drop(engine);
        assert_eq!(state(&live(folder.path(), ProfileName::Human).unwrap()), State::Demoted);
    }
}
