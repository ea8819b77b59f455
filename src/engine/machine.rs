//! The ledger and its store against the model of the lifecycle, as a state machine: any events in any order, allowed or
//! not, with ends, kills and restarts between them. After each step the rows, the ledger and the model say the same, and
//! every invariant of the store holds.
//!
//! `HOLDPOINT_MACHINE_CASES` is how many histories (4), of up to 100 steps each; `HOLDPOINT_MACHINE_SEED`
//! their seed (1).

use std::fs;
use std::path::Path;

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::{self, FamilyState, Leave, LifecycleEvent, Stage, State, VersionRef};
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{ActiveCause, Change, Store, StoreError, check_invariants, verify};
use holdpoint_runtime::capability::Capability;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed};
use proptest_state_machine::{ReferenceStateMachine, StateMachineTest, prop_state_machine};
use tempfile::TempDir;

use crate::ledger::{Ledger, LedgerError, Note, Origin};
use crate::tests::context_change;
use crate::wall_clock::WallClock;
use holdpoint_governance::wall_time::WallTime;

/// The most versions of the family.
const VERSIONS: u16 = 4;

#[derive(Clone, Copy, Debug)]
enum Step {
    Event(LifecycleEvent),
    /// The engine ends, and another one comes up.
    Restart,
    /// The engine is killed: the next one finds the files as they are.
    Kill,
}

/// What the lifecycle's own model says.
#[derive(Clone, Debug)]
struct Model {
    family: FamilyState,
    /// Whether it took the last event.
    taken: bool,
}

impl Model {
    fn after(mut self, step: Step) -> Self {
        let event = match step {
            Step::Event(event) => event,
            Step::Restart | Step::Kill => LifecycleEvent::Restart,
        };
        let next = lifecycle::apply(&self.family, event);
        self.taken = next.is_ok();
        if let Ok((family, _)) = next {
            self.family = family;
        }
        self
    }
}

/// Every event that there is for so many versions.
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
            Event::FinishRollback { version, leave: Leave::RolledBack },
            Event::FinishRollback { version, leave: Leave::Demoted },
            Event::FailRollback { version },
            Event::Rearm { version },
            Event::Pause { version },
            Event::Resume { version },
        ]);
    }
    all
}

impl ReferenceStateMachine for Model {
    type State = Self;
    type Transition = Step;

    fn init_state() -> BoxedStrategy<Self> {
        let (family, _) = lifecycle::apply(&FamilyState::empty(false), LifecycleEvent::Bootstrap).unwrap();
        Just(Self { family, taken: true }).boxed()
    }

    fn transitions(model: &Self) -> BoxedStrategy<Step> {
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
        // What takes many steps to get to is not passed by.
        let rare = |event: &LifecycleEvent| {
            matches!(event, LifecycleEvent::Activate { .. } | LifecycleEvent::FinishRollback { .. })
        };
        if onward.iter().any(rare) {
            onward.retain(rare);
        }
        if onward.is_empty() {
            onward.clone_from(&allowed);
        }
        // Most steps lead somewhere; of any event at all most are refused.
        prop_oneof![
            14 => proptest::sample::select(onward).prop_map(Step::Event),
            3 => proptest::sample::select(allowed).prop_map(Step::Event),
            2 => proptest::sample::select(all).prop_map(Step::Event),
            1 => Just(Step::Restart),
            1 => Just(Step::Kill),
        ]
        .boxed()
    }

    fn preconditions(model: &Self, step: &Step) -> bool {
        !matches!(step, Step::Event(LifecycleEvent::Register))
            || model.family.versions.len() < usize::from(VERSIONS)
    }

    fn apply(model: Self, step: &Step) -> Self {
        model.after(*step)
    }
}

/// A ledger with its store, in a folder that goes with it.
struct Kept {
    ledger: Ledger,
    folder: TempDir,
    at_ms: u64,
}

fn family() -> Family {
    Family::new("align".to_owned()).unwrap()
}

/// The family's first version, or a later one.
fn capability(number: usize) -> Capability {
    if number == 0 {
        let baselines = crate::embedded::baselines().unwrap();
        return baselines.into_iter().find(|capability| capability.id().family == family()).unwrap();
    }
    let mut package = crate::embedded::package("align-improved").unwrap();
    package.manifest = package.manifest.replacen("1.1.0", &format!("1.{number}.0"), 1);
    Capability::load("align-improved", package).unwrap()
}

fn folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
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

impl Kept {
    fn open(folder: TempDir, at_ms: u64) -> Self {
        let until = std::time::Instant::now() + std::time::Duration::from_mins(1);
        let store = loop {
            match Store::open(folder.path()) {
                // A test beside this one may just be starting a child, which holds this process's descriptors.
                Err(StoreError::InUse { .. }) if std::time::Instant::now() < until => {
                    std::thread::yield_now();
                }
                opened => break opened.unwrap(),
            }
        };
        Self { ledger: Ledger::open(store, WallClock::scripted(0, None)).unwrap(), folder, at_ms }
    }

    /// What goes with an event, as the engine writes it.
    fn note(&self, event: LifecycleEvent) -> Note {
        let mut note = Note::because("a step");
        match event {
            LifecycleEvent::Activate { version } | LifecycleEvent::ActivateUnreviewed { version, .. } => {
                let digest = Digest::of_parts("test", &[&self.at_ms.to_le_bytes()]);
                let id =
                    self.ledger.family(&family()).unwrap().members[usize::from(version.0)].capability.id();
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
            let next = capability(self.ledger.family(&family()).unwrap().members.len());
            self.ledger.register((next, Origin::default()), false, false, self.at_ms, note)
        } else {
            self.ledger.transition(&family(), event, self.at_ms, note)
        };
        match done {
            Ok(_) => true,
            Err(LedgerError::Refused(_)) => false,
            Err(error) => panic!("{event:?} is allowed, and: {error}"),
        }
    }
}

impl StateMachineTest for Kept {
    type SystemUnderTest = Self;
    type Reference = Model;

    fn init_test(_: &Model) -> Self {
        let mut kept = Self::open(folder(), 1);
        let policy = Digest::of_parts("test", &[b"policy"]);
        let context = context_change((ProfileName::Sim, policy, "{}".to_owned()));
        kept.ledger.write(vec![context], Vec::new(), 1).unwrap();
        let note = Note { cause: Some(ActiveCause::Bootstrap), ..Note::because("the first one") };
        kept.ledger.register((capability(0), Origin::default()), true, false, 1, note).unwrap();
        kept
    }

    fn apply(mut kept: Self, model: &Model, step: Step) -> Self {
        let event = match step {
            Step::Event(event) => event,
            Step::Restart => {
                let Self { ledger, folder, at_ms } = kept;
                drop(ledger);
                kept = Self::open(folder, at_ms);
                LifecycleEvent::Restart
            }
            Step::Kill => {
                let left = folder();
                copy(kept.folder.path(), left.path());
                kept = Self::open(left, kept.at_ms);
                LifecycleEvent::Restart
            }
        };
        assert_eq!(kept.event(event), model.taken, "{event:?}");
        kept
    }

    fn check_invariants(kept: &Self, model: &Model) {
        let entry = kept.ledger.family(&family()).unwrap();
        assert_eq!(entry.state, model.family);
        let views = kept.ledger.store().views().unwrap();
        assert_eq!(check_invariants(views.connection()).unwrap(), []);
        let row = views.families().unwrap().remove(0);
        let standing: FamilyState = serde_json::from_str(&row.standing.unwrap()).unwrap();
        assert_eq!((&standing, row.safe_stopped), (&model.family, model.family.safe_stopped));
        let id_of = |version: VersionRef| entry.members[usize::from(version.0)].capability.id();
        assert_eq!(row.active, model.family.active().map(id_of));
        for (member, version) in entry.members.iter().zip(&model.family.versions) {
            let row = views.version(&member.capability.id()).unwrap().unwrap().summary;
            assert_eq!((row.state, row.flags), (version.state, version.flags), "{}", member.capability.id());
        }
        if let (Some(active), Some(pinned)) = (model.family.active(), &row.pinned) {
            let target = model.family.versions[usize::from(active.0)].predecessor.map(id_of);
            assert_eq!(target.as_ref(), Some(pinned));
        }
        let actives = model.family.versions.iter().filter(|version| version.state == State::Active);
        assert_eq!(actives.count(), usize::from(!model.family.safe_stopped));
    }

    fn teardown(kept: Self, _: Model) {
        let (folder, key) = (kept.folder, *kept.ledger.store().public_key());
        drop(kept.ledger);
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
    fn the_store_follows_the_model(sequential 10..100 => Kept);
}
