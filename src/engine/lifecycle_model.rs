//! Tests the version table and its store against the model of the lifecycle, as a state machine: any events in any order,
//! allowed or not, with ends, kills and restarts between them. After each step rows, version table and model agree, and every
//! invariant of the store holds.
//!
//! `HOLDPOINT_MACHINE_CASES` is how many histories (4), of up to 100 steps each; `HOLDPOINT_MACHINE_SEED`
//! their seed (1).

use std::fs;
use std::path::Path;

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::{
    self, DeactivationKind, FamilyState, LifecycleEvent, Stage, State, VersionRef,
};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{Store, Views, check_invariants, verify};
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{ActiveCause, Change, EvidenceKind, StoreError};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed};
use proptest_state_machine::{ReferenceStateMachine, StateMachineTest, prop_state_machine};
use tempfile::TempDir;

use crate::quick_folder::quick_folder;
use crate::tests::context_change;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_record::version_table::{TransitionNote, VersionOrigin, VersionTable, VersionTableError};
use holdpoint_record::wall_clock::WallClock;

/// The most versions of the family.
const VERSIONS: u16 = 4;

#[derive(Clone, Copy, Debug)]
enum ModelStep {
    Event(LifecycleEvent),
    /// The engine ends, and another one comes up.
    Restart,
    /// The engine is killed: the next one finds the files as they are.
    Kill,
}

/// The state of the lifecycle's model.
#[derive(Clone, Debug)]
struct LifecycleModel {
    family: FamilyState,
    /// Whether it took the last event.
    taken: bool,
}

impl LifecycleModel {
    fn after(mut self, step: ModelStep) -> Self {
        let event = match step {
            ModelStep::Event(event) => event,
            ModelStep::Restart | ModelStep::Kill => LifecycleEvent::Restart,
        };
        let next = lifecycle::apply(&self.family, event);
        self.taken = next.is_ok();
        if let Ok((family, _)) = next {
            self.family = family;
        }
        self
    }
}

/// Every event for this number of versions.
fn events(versions: u16) -> Vec<LifecycleEvent> {
    use LifecycleEvent as Event;
    let mut all = vec![
        Event::Register,
        Event::ContextChanged { needs_approval: false },
        Event::ContextChanged { needs_approval: true },
    ];
    for version in (0..versions).map(VersionRef) {
        for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow, Stage::Activation] {
            all.extend([
                Event::Start { version, stage },
                Event::Pass { version, stage },
                Event::Repeat { version, stage },
            ]);
        }
        all.extend((1..9).map(|row_version| Event::Approved { version, row_version }));
        all.extend([
            Event::Abort { version },
            Event::Demote { version },
            Event::Reject { version },
            Event::RequestApproval { version },
            Event::ApprovalExpired { version },
            Event::Activate { version },
            Event::ActivateUnreviewed { version, until: WallTime::from_ms(1_000) },
            Event::Reviewed { version },
            Event::Close { version, profile: ProfileName::Real },
            Event::Open { version, profile: ProfileName::Real },
            Event::Confirm { version },
            Event::Restrict { version },
            Event::Release { version },
            Event::BeginRollback { version },
            Event::FinishRollback { version, leave: DeactivationKind::RolledBack },
            Event::FinishRollback { version, leave: DeactivationKind::Demoted },
            Event::FailRollback { version },
            Event::Rearm { version },
            Event::Pause { version },
            Event::Resume { version },
        ]);
    }
    all
}

impl ReferenceStateMachine for LifecycleModel {
    type State = Self;
    type Transition = ModelStep;

    fn init_state() -> BoxedStrategy<Self> {
        let (family, _) = lifecycle::apply(&FamilyState::empty(false), LifecycleEvent::Bootstrap).unwrap();
        Just(Self { family, taken: true }).boxed()
    }

    fn transitions(model: &Self) -> BoxedStrategy<ModelStep> {
        let versions = u16::try_from(model.family.versions.len()).unwrap();
        let (mut onward, mut allowed) = (Vec::new(), Vec::new());
        let all = events(versions);
        for event in all.iter().copied().filter(|event| lifecycle::apply(&model.family, *event).is_ok()) {
            allowed.push(event);
            if let LifecycleEvent::Start { .. }
            | LifecycleEvent::Pass { .. }
            | LifecycleEvent::Approved { .. }
            | LifecycleEvent::RequestApproval { .. }
            | LifecycleEvent::Activate { .. }
            | LifecycleEvent::FinishRollback { .. }
            | LifecycleEvent::Rearm { .. } = event
            {
                onward.push(event);
            }
        }
        // Keeps events that need many steps.
        let rare = |event: &LifecycleEvent| {
            matches!(event, LifecycleEvent::Activate { .. } | LifecycleEvent::FinishRollback { .. })
        };
        if onward.iter().any(rare) {
            onward.retain(rare);
        }
        if onward.is_empty() {
            onward.clone_from(&allowed);
        }
        // Most steps are allowed; a uniform choice of events would be refused mostly.
        prop_oneof![
            14 => proptest::sample::select(onward).prop_map(ModelStep::Event),
            3 => proptest::sample::select(allowed).prop_map(ModelStep::Event),
            2 => proptest::sample::select(all).prop_map(ModelStep::Event),
            1 => Just(ModelStep::Restart),
            1 => Just(ModelStep::Kill),
        ]
        .boxed()
    }

    fn preconditions(model: &Self, step: &ModelStep) -> bool {
        !matches!(step, ModelStep::Event(LifecycleEvent::Register))
            || model.family.versions.len() < usize::from(VERSIONS)
    }

    fn apply(model: Self, step: &ModelStep) -> Self {
        model.after(*step)
    }
}

/// A version table with its store, in a temporary folder.
struct ModelStore {
    version_table: VersionTable,
    folder: TempDir,
    at_ms: u64,
}

fn family() -> Family {
    Family::new("align".to_owned()).unwrap()
}

/// The family's first version, or a later one.
fn capability(number: usize) -> Capability {
    if number == 0 {
        let baselines = holdpoint_trials::embedded::baselines().unwrap();
        return baselines.into_iter().find(|capability| capability.id().family == family()).unwrap();
    }
    let mut package = holdpoint_trials::embedded::package("align-improved").unwrap();
    package.manifest = package.manifest.replacen("1.1.0", &format!("1.{number}.0"), 1);
    Capability::load("align-improved", package).unwrap()
}

fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() {
            fs::create_dir(&to).unwrap();
            copy(&from, &to);
        } else {
            fs::copy(&from, &to).unwrap();
        }
    }
}

impl ModelStore {
    fn open(folder: TempDir, at_ms: u64) -> Self {
        let until = std::time::Instant::now() + std::time::Duration::from_mins(1);
        let store = loop {
            match Store::open(folder.path()) {
                // A parallel test may be starting a child, which holds this process's descriptors.
                Err(StoreError::InUse { .. }) if std::time::Instant::now() < until => {
                    std::thread::yield_now();
                }
                opened => break opened.unwrap(),
            }
        };
        Self {
            version_table: VersionTable::open(Box::new(store), WallClock::scripted(0, None)).unwrap(),
            folder,
            at_ms,
        }
    }

    /// The note of an event, as the engine writes it.
    fn note(&self, event: LifecycleEvent) -> TransitionNote {
        let mut note = TransitionNote::because(Notice::StageBegins);
        match event {
            LifecycleEvent::Activate { version } | LifecycleEvent::ActivateUnreviewed { version, .. } => {
                let digest = Digest::of_parts("test", &[&self.at_ms.to_le_bytes()]);
                let id = self.version_table.family(&family()).unwrap().members[usize::from(version.0)]
                    .capability
                    .id();
                let kind = EvidenceKind::Gate;
                note.before = vec![Change::PutEvidence { version: id, kind, json: "{}".to_owned(), digest }];
                note.cause = Some(ActiveCause::Gate { evidence: digest, approvals_needed: 0 });
            }
            LifecycleEvent::Rearm { .. } => note.cause = Some(ActiveCause::Rearm),
            LifecycleEvent::FinishRollback { .. } => note.cause = Some(ActiveCause::Restore),
            _ => {}
        }
        note
    }

    fn event(&mut self, event: LifecycleEvent) -> bool {
        self.at_ms += 1;
        let note = self.note(event);
        let done = if event == LifecycleEvent::Register {
            let next = capability(self.version_table.family(&family()).unwrap().members.len());
            self.version_table.register((next, VersionOrigin::default()), false, false, self.at_ms, note)
        } else {
            self.version_table.transition(&family(), event, self.at_ms, note)
        };
        match done {
            Ok(_) => true,
            Err(VersionTableError::Refused(_)) => false,
            Err(error) => panic!("{event:?} is allowed, and: {error}"),
        }
    }
}

impl StateMachineTest for ModelStore {
    type SystemUnderTest = Self;
    type Reference = LifecycleModel;

    fn init_test(_: &LifecycleModel) -> Self {
        let mut store = Self::open(quick_folder(), 1);
        let policy = Digest::of_parts("test", &[b"policy"]);
        let context = context_change((ProfileName::Sim, policy, "{}".to_owned()));
        store.version_table.write(vec![context], Vec::new(), 1).unwrap();
        let note = TransitionNote {
            cause: Some(ActiveCause::Bootstrap),
            ..TransitionNote::because(Notice::StageBegins)
        };
        store
            .version_table
            .register((capability(0), VersionOrigin::default()), true, false, 1, note)
            .unwrap();
        store
    }

    fn apply(mut store: Self, model: &LifecycleModel, step: ModelStep) -> Self {
        let event = match step {
            ModelStep::Event(event) => event,
            ModelStep::Restart => {
                let Self { version_table, folder, at_ms } = store;
                drop(version_table);
                store = Self::open(folder, at_ms);
                LifecycleEvent::Restart
            }
            ModelStep::Kill => {
                let left = quick_folder();
                copy(store.folder.path(), left.path());
                store = Self::open(left, store.at_ms);
                LifecycleEvent::Restart
            }
        };
        assert_eq!(store.event(event), model.taken, "{event:?}");
        store
    }

    fn check_invariants(store: &Self, model: &LifecycleModel) {
        let entry = store.version_table.family(&family()).unwrap();
        assert_eq!(entry.state, model.family);
        let database = store.version_table.store().layout().database();
        let views = Views::open(&database).unwrap();
        assert_eq!(check_invariants(views.connection()).unwrap(), []);
        let row = views.families().unwrap().remove(0);
        let state: FamilyState = serde_json::from_str(&row.state_json.unwrap()).unwrap();
        assert_eq!((&state, row.safe_stopped), (&model.family, model.family.safe_stopped));
        let id_of = |version: VersionRef| entry.members[usize::from(version.0)].capability.id();
        assert_eq!(row.active, model.family.active().map(id_of));
        for (member, version) in entry.members.iter().zip(&model.family.versions) {
            let row = views.version(&member.capability.id()).unwrap().unwrap().summary;
            let id = member.capability.id();
            assert_eq!((row.state, row.flags), (version.state, version.flags), "{id}");
            // What a status rests on is the same in memory and after a restart, whatever came before.
            let recorded = views.recorded_changes(&id).unwrap();
            assert_eq!(store.version_table.recorded_changes(&id), Some(&recorded), "{id}");
            assert!(recorded.state.is_some(), "{id}");
        }
        if let (Some(active), Some(pinned)) = (model.family.active(), &row.pinned) {
            let target = model.family.versions[usize::from(active.0)].predecessor.map(id_of);
            assert_eq!(target.as_ref(), Some(pinned));
        }
        let actives = model.family.versions.iter().filter(|version| version.state == State::Active);
        assert_eq!(actives.count(), usize::from(!model.family.safe_stopped));
    }

    fn teardown(store: Self, _: LifecycleModel) {
        let (folder, key) = (store.folder, *store.version_table.store().public_key());
        drop(store.version_table);
        verify(&folder.path().join("holdpoint.db"), Some(&key)).unwrap();
    }
}

fn number(name: &str, otherwise: u32) -> u32 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

fn config() -> Config {
    Config {
        cases: number("HOLDPOINT_MACHINE_CASES", 4),
        rng_seed: RngSeed::Fixed(number("HOLDPOINT_MACHINE_SEED", 1).into()),
        failure_persistence: None,
        ..Config::default()
    }
}

prop_state_machine! {
    #![proptest_config(config())]

    #[test]
    fn store_states_equal_those_of_the_model(sequential 10..100 => ModelStore);
}
