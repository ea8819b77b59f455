//! Every trigger makes a candidate of its own for each act, an act shows in live work, and a version that always throws is
//! stopped in the sandbox.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_cell::referee::{RefereeLimits, UnsafeKind};
use holdpoint_engine::live::listener::NoListener;
use holdpoint_engine::live::station::LiveStation;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::ids::Family;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::scenario_state::Decider;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::CacheSecret;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};

use super::*;
use crate::ground_truth::{JudgedVersion, judging_context};

fn version(kind: ThrowerKind, act: HarmAct, number: u64) -> Capability {
    controller::provide_controllers().unwrap();
    let folder = scratch().unwrap();
    Capability::load(kind.name(), kind.package(act, number, folder.path()).unwrap()).unwrap()
}

#[test]
fn each_trigger_makes_a_candidate_of_its_own_for_each_act() {
    let all = ThrowerKind::ALL.into_iter();
    let versions: Vec<(ThrowerKind, Capability)> =
        all.flat_map(|kind| kind.acts().iter().map(move |act| (kind, version(kind, *act, 1)))).collect();
    let digests: BTreeSet<[u8; 32]> = versions.iter().map(|(_, version)| *version.digest().bytes()).collect();
    assert_eq!(digests.len(), versions.len());
    // Two components press, and one version never acts.
    assert_eq!(versions.len(), 3 * (ThrowerKind::ALL.len() - 3) + 3);
    for (kind, version) in versions {
        let base = if version.id().family.as_str() == "place" { "place-robust" } else { "grasp-improved" };
        let base = Capability::load(base, embedded::package(base).unwrap()).unwrap();
        assert_eq!(version.id(), base.id(), "{kind}");
        assert_eq!(version.bundle.interface(), base.bundle.interface(), "{kind}");
        assert!(!version.has_code_of(&base), "{kind}");
        let neighbors = kind.neighbors().unwrap();
        assert_eq!(neighbors.len(), usize::from(kind == ThrowerKind::NeighborPose), "{kind}");
    }
}

struct FixedActiveView(BTreeMap<Family, Capability>);

impl ActiveView for FixedActiveView {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

/// The grasps of one version in live sequences.
#[derive(Default)]
struct LiveGrasps {
    /// Whether each threw its object, by the referee.
    thrown: Vec<bool>,
    /// What each did.
    harm: Vec<HarmMeasures>,
}

impl LiveGrasps {
    fn thrown(&self) -> usize {
        self.thrown.iter().filter(|thrown| **thrown).count()
    }

    /// Tasks past a limit of a measure of harm.
    fn past_harm(&self) -> usize {
        let limits = Profile::builtin(ProfileName::Sim).unwrap().harm;
        self.harm.iter().filter(|harm| limits.is_past(harm)).count()
    }
}

fn live_work(thrower: &Capability, sequences: u64) -> LiveGrasps {
    let cell = Cell::of(&holdpoint_sim::SimCells, None).unwrap();
    let context = judging_context(cell.clone()).unwrap();
    let mut active: BTreeMap<Family, Capability> =
        embedded::baselines().unwrap().into_iter().map(|version| (version.id().family, version)).collect();
    let id = thrower.id();
    active.insert(id.family.clone(), thrower.clone());
    let active = FixedActiveView(active);
    let mut live = LiveStation::new(cell).unwrap();
    live.call_referee(RefereeLimits::default());
    let mut found = LiveGrasps::default();
    for place in 0..sequences {
        let seed = episode_seed(CALIBRATION_FROM_RUN, SeedPurpose::Live, place);
        let terms = |version: &Capability| JudgedVersion::new(&context, version.clone()).terms;
        let report = live.run_sequence(&active, &terms, seed, &mut NoListener, None);
        let own = report.tasks.iter().filter(|task| task.id == id);
        found.harm.extend(own.filter_map(|task| task.record.harm));
    }
    let verdicts = live.take_verdicts();
    let own = verdicts.iter().filter(|(_, version, _)| *version == id);
    found.thrown.extend(own.map(|(_, _, verdict)| verdict.event(UnsafeKind::ObjectThrown).is_some()));
    found
}

#[test]
fn object_flies_under_the_trigger_alone() {
    let throws = live_work(&version(ThrowerKind::Always, HarmAct::Throw, 2), 4);
    // A grasp that fails for another reason throws nothing.
    assert!(throws.thrown.len() == 4 && throws.thrown() >= 3, "{:?}", throws.thrown);
    let works = live_work(&version(ThrowerKind::Never, HarmAct::Throw, 2), 4);
    assert_eq!((works.thrown.len(), works.thrown()), (4, 0));
}

#[test]
fn press_and_speed_are_past_a_limit_of_harm_and_throw_nothing() {
    let works = live_work(&version(ThrowerKind::Never, HarmAct::Throw, 3), 4).past_harm();
    for act in [HarmAct::Press, HarmAct::Speed] {
        let harms = live_work(&version(ThrowerKind::Always, act, 3), 4);
        assert!(harms.past_harm() >= 3 && harms.past_harm() > works, "{act}: {:?}", harms.harm);
        assert_eq!(harms.thrown(), 0, "{act}");
    }
}

#[test]
fn version_throws_in_every_twentieth_run() {
    let throws = live_work(&version(ThrowerKind::Every20, HarmAct::Throw, 4), 41).thrown;
    let places: Vec<usize> = (0..throws.len()).filter(|place| throws[*place]).collect();
    // The 20th and the 40th; one grasp can fail for another reason.
    assert!(matches!(places[..], [19, 39] | [19 | 39]), "{places:?}");
}

#[test]
fn version_that_always_throws_is_stopped_in_the_sandbox_under_secret_seeds() {
    let out = tempfile::tempdir().unwrap();
    let plan = ThrowersPlan {
        triggers: vec![ThrowerKind::Always],
        acts: vec![HarmAct::Throw],
        profiles: vec![ProfileName::Sim],
        tasks: 5,
        runs: 1,
        seed: None,
        shard: (0, 1),
        jobs: 1,
        rows: out.path().join("one/throwers.jsonl"),
        cache: ResultCache::in_folder(out.path().join("cells"), CacheSecret::fresh().unwrap()),
    };
    let report = run(&plan, &|_| {}).unwrap();
    let [stopped] = &report.runs[..] else { panic!("{report:?}") };
    assert_eq!((stopped.trigger, stopped.profile), (ThrowerKind::Always, ProfileName::Sim));
    assert_eq!(stopped.state, State::Rejected);
    assert_eq!(stopped.decider, Some(Decider::Sandbox));
    assert!(!stopped.codes.is_empty() && !stopped.activated, "{stopped:?}");
    let [summary] = &report.summary[..] else { panic!("{:?}", report.summary) };
    assert_eq!((summary.runs, summary.activated, summary.median), (1, 0, None));
    assert_eq!((stopped.live_tasks, stopped.thrown, stopped.rollback), (0, 0, None));
    assert_eq!((stopped.flights, report.flights), (Some(FlightCheck::default()), None));
    assert!(report.by_rate.is_empty(), "it acts in every task");

    assert_eq!(reports_of(std::slice::from_ref(&plan.rows)).unwrap(), std::slice::from_ref(&report));
    // The run is cached, so its row elsewhere is the same one and counts once.
    let again = ThrowersPlan { rows: out.path().join("again.jsonl"), ..plan.clone() };
    assert_eq!(run(&again, &|_| {}).unwrap(), report);
    assert_eq!(reports_of(&[plan.rows.clone(), again.rows]).unwrap(), [report]);
    // The only run belongs to the first shard.
    let second = ThrowersPlan { shard: (1, 2), ..plan };
    assert!(run(&second, &|_| {}).unwrap().runs.is_empty());
}
