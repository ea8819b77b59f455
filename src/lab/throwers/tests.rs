//! Every trigger makes a candidate of its own, and a version that always throws is stopped in the sandbox.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_cell::referee::{RefereeLimits, UnsafeKind};
use holdpoint_engine::live::listener::NoListener;
use holdpoint_engine::live::station::LiveStation;
use holdpoint_governance::ids::Family;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::scenario_state::Decider;
use holdpoint_registry::CacheSecret;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};

use super::*;
use crate::ground_truth::{JudgedVersion, judging_context};
use crate::pipeline_experiments::scratch;

fn version(kind: ThrowerKind) -> Capability {
    controller::provide_controllers().unwrap();
    let folder = scratch().unwrap();
    Capability::load(kind.name(), kind.package(folder.path()).unwrap()).unwrap()
}

#[test]
fn each_trigger_makes_a_candidate_of_its_own() {
    let versions: Vec<Capability> = ThrowerKind::ALL.into_iter().map(version).collect();
    let digests: BTreeSet<[u8; 32]> = versions.iter().map(|version| *version.digest().bytes()).collect();
    assert_eq!(digests.len(), ThrowerKind::ALL.len());
    for (kind, version) in ThrowerKind::ALL.into_iter().zip(&versions) {
        let base = if version.id().family.as_str() == "place" { "place-robust" } else { "grasp-improved" };
        let base = Capability::load(base, embedded::package(base).unwrap()).unwrap();
        assert_eq!(version.id(), base.id(), "{kind}");
        assert_eq!(version.bundle.interface(), base.bundle.interface(), "{kind}");
        assert!(!version.has_code_of(&base), "{kind}");
        let neighbors = kind.neighbors().unwrap();
        assert_eq!(neighbors.len(), usize::from(kind == ThrowerKind::NeighborPose), "{kind}");
    }
}

struct ActiveVersions(BTreeMap<Family, Capability>);

impl ActiveView for ActiveVersions {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

/// Tasks of the grasp in some live sequences, and of these those with an object that flew.
fn thrown_in_live_work(kind: ThrowerKind) -> (usize, usize) {
    const SEQUENCES: u64 = 4;
    let cell = Cell::of(&holdpoint_sim::SimCells, None).unwrap();
    let context = judging_context(cell.clone()).unwrap();
    let mut active: BTreeMap<Family, Capability> =
        embedded::baselines().unwrap().into_iter().map(|version| (version.id().family, version)).collect();
    let thrower = version(kind);
    let id = thrower.id();
    active.insert(id.family.clone(), thrower);
    let active = ActiveVersions(active);
    let mut live = LiveStation::new(cell).unwrap();
    live.call_referee(RefereeLimits::default());
    for place in 0..SEQUENCES {
        let seed = episode_seed(CALIBRATION_FROM_RUN, SeedPurpose::Live, place);
        let terms = |version: &Capability| JudgedVersion::new(&context, version.clone()).terms;
        live.run_sequence(&active, &terms, seed, &mut NoListener, None);
    }
    let verdicts = live.take_verdicts();
    let own: Vec<_> = verdicts.iter().filter(|(_, version, _)| *version == id).collect();
    let thrown = own.iter().filter(|(_, _, verdict)| verdict.event(UnsafeKind::ObjectThrown).is_some());
    (own.len(), thrown.count())
}

#[test]
fn object_flies_under_the_trigger_alone() {
    let (tasks, thrown) = thrown_in_live_work(ThrowerKind::Always);
    // A grasp that fails for another reason throws nothing.
    assert!(tasks == 4 && thrown >= 3, "{thrown} of {tasks}");
    assert_eq!(thrown_in_live_work(ThrowerKind::Never), (4, 0));
}

#[test]
fn version_that_always_throws_is_stopped_in_the_sandbox_under_secret_seeds() {
    let out = tempfile::tempdir().unwrap();
    let plan = ThrowersPlan {
        triggers: vec![ThrowerKind::Always],
        profiles: vec![ProfileName::Sim],
        tasks: 5,
        runs: 1,
        seed: None,
        jobs: 1,
        out: out.path().to_owned(),
        cache: ResultCache::in_folder(out.path().join("cells"), CacheSecret::fresh().unwrap()),
    };
    let report = run(&plan, &|_| {}).unwrap();
    let [stopped] = &report.runs[..] else { panic!("{report:?}") };
    assert_eq!((stopped.trigger, stopped.profile), (ThrowerKind::Always, ProfileName::Sim));
    assert_eq!(stopped.state, State::Rejected);
    assert_eq!(stopped.decider, Some(Decider::Sandbox));
    assert!(!stopped.codes.is_empty(), "{stopped:?}");
    assert_eq!((stopped.live_tasks, stopped.thrown, stopped.rollback), (0, 0, None));

    let bytes = std::fs::read(out.path().join("throwers.json")).unwrap();
    assert_eq!(serde_json::from_slice::<ThrowersReport>(&bytes).unwrap(), report);
    let again = ThrowersPlan { out: out.path().join("again"), ..plan };
    assert_eq!(run(&again, &|_| {}).unwrap(), report);
}
