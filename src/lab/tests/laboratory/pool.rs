//! Pools of candidates: each loads, matches its ground truth as far as readable, and reveals nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use holdpoint::governance::decision::Dimension;
use holdpoint::governance::interface::{self, InterfaceInput, RegisteredVersion};
use holdpoint::governance::lifecycle::State;
use holdpoint::governance::outcome::{InterfaceOutcome, PolicyOutcome, RecoveryOutcome};
use holdpoint::governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::governance::recovery::{self, FallbackMatch, StaticInput};
use holdpoint::governance::submission::Package;
use holdpoint::runtime::capability::{self, Capability};
use holdpoint::trials;
use holdpoint_body::FailureSignal;
use holdpoint_lab::candidate_pool::generate::{FAMILIES, PoolSpec, SETS_MAX, draw, write};
use holdpoint_lab::candidate_pool::paper_kinds::Listed;
use holdpoint_lab::candidate_pool::{Class, INDEX_FILE, Pool, PoolError, PoolTruth, Preset, truth_path};

/// Seeds for calibration: reported pools use other seeds.
const SEEDS: [u64; 4] = [100, 101, 102, 103];

const fn pool_spec(seed: u64, sets: u32, preset: Preset) -> PoolSpec {
    PoolSpec { seed, sets, preset }
}

/// Each generated candidate, loaded, with its entry in the ground truth.
fn load_pool(spec: PoolSpec) -> (Vec<Capability>, PoolTruth) {
    let generated = draw(spec).unwrap();
    let truth: PoolTruth = serde_json::from_slice(&generated.truth).unwrap();
    let names = generated.index.candidates.iter().map(|candidate| candidate.name.clone());
    let load = |(name, package): (String, Package)| Capability::load(&name, package).unwrap();
    (names.zip(generated.packages).map(load).collect(), truth)
}

struct PoolVerdict {
    interface: InterfaceOutcome,
    policy: PolicyOutcome,
    recovery: RecoveryOutcome,
}

/// The verdict of stage 2 under a profile, with the baselines active.
fn verdict(
    candidate: &Capability,
    profile: &Profile,
    table: &PolicyTable,
    baselines: &[Capability],
) -> PoolVerdict {
    let active = baselines.iter().find(|baseline| baseline.id().family == candidate.id().family).unwrap();
    let exports = candidate.bundle.interface();
    let registered: Vec<RegisteredVersion> = baselines
        .iter()
        .map(|baseline| RegisteredVersion {
            id: baseline.id(),
            active: true,
            dependencies: baseline.manifest.deployment.dependencies.clone(),
        })
        .collect();
    let interface = interface::assess(
        &InterfaceInput {
            candidate: &candidate.manifest,
            exports: Some(&exports),
            active: Some(&active.manifest),
            registered: &registered,
        },
        &profile.thresholds,
    );
    let policy = policy::assess(
        &PolicyInput {
            permissions: &candidate.manifest.permissions,
            environments: &candidate.manifest.deployment.environments,
            exports: Some(&exports),
            active: Some(&active.manifest.permissions),
        },
        table,
        profile,
    );
    let fallback = candidate.manifest.recovery.fallback.as_ref();
    let found = |family, version: &semver::VersionReq| {
        let meets = |b: &&Capability| b.id().family == family && version.matches(&b.id().version);
        FallbackMatch::of(baselines.iter().filter(meets).map(|_| State::Active))
    };
    let recovery = recovery::static_part(&StaticInput {
        manifest: &candidate.manifest,
        exports: Some(&exports),
        predecessor_loads: Some(true),
        predecessor_digest_true: Some(true),
        fallback: fallback.map(|binding| found(binding.family.clone(), &binding.version)),
        watcher_knows: &FailureSignal::ALL.into_iter().collect(),
    });
    PoolVerdict {
        interface: interface.assessment.outcome,
        policy: policy.assessment.outcome,
        recovery: recovery.outcome,
    }
}

#[test]
fn a_readable_fault_has_its_intended_verdict() {
    let baselines = trials::embedded::baselines().unwrap();
    let mut problems = Vec::new();
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let profiles = ProfileName::ALL.map(|name| Profile::builtin(name).unwrap());
    let profiles = profiles.map(|profile| (PolicyTable::builtin(&profile).unwrap(), profile));
    for seed in SEEDS {
        let (candidates, truth) = load_pool(pool_spec(seed, 3, Preset::Full10));
        for (table, profile) in &profiles {
            for (candidate, entry) in candidates.iter().zip(&truth.entries) {
                let actual = verdict(candidate, profile, table, &baselines);
                let breaks_interface = entry.kind.starts_with("interface-");
                let exceeds_permissions = entry.kind.starts_with("permission-");
                seen.insert(entry.kind.clone());
                let interface = (actual.interface == InterfaceOutcome::Incompatible) == breaks_interface
                    && actual.interface != InterfaceOutcome::NoData;
                let policy = match actual.policy {
                    PolicyOutcome::Incompatible => exceeds_permissions,
                    PolicyOutcome::Review => exceeds_permissions && profile.has_approver(),
                    PolicyOutcome::Compatible | PolicyOutcome::Conditional => !exceeds_permissions,
                    PolicyOutcome::NoData => false,
                };
                // Only the drills show a fault of recovery.
                let recovery = actual.recovery == RecoveryOutcome::Compatible;
                if !(interface && policy && recovery) {
                    problems.push(format!(
                        "seed {seed} {} in {}: {} gives {:?} {:?} {:?} ({})",
                        entry.name,
                        profile.name.name(),
                        entry.kind,
                        actual.interface,
                        actual.policy,
                        actual.recovery,
                        entry.what
                    ));
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    // Every mechanism occurs in the generated pools.
    for kind in holdpoint_lab::candidate_pool::structure::INTERFACE
        .iter()
        .chain(&holdpoint_lab::candidate_pool::structure::PERMISSION)
    {
        assert!(seen.contains(kind.0), "{} never occurred", kind.0);
    }
}

/// Faults of appendix C that are in the manifest are rejected in stage 2, and each kind is in every set.
#[test]
fn appendix_c_faults_have_their_intended_verdict() {
    let baselines = trials::embedded::baselines().unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = PolicyTable::builtin(&profile).unwrap();
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for seed in SEEDS {
        let (candidates, truth) = load_pool(pool_spec(seed, 2, Preset::AppendixC));
        // Samples from before these kinds existed are unchanged.
        let (without, _) = load_pool(pool_spec(seed, 2, Preset::Full10));
        let params =
            |of: &[Capability]| of.iter().map(|one| one.package.params.clone()).collect::<BTreeSet<_>>();
        assert!(params(&candidates).is_superset(&params(&without)), "seed {seed}");
        for (candidate, entry) in candidates.iter().zip(&truth.entries) {
            let Some(kind) = Listed::ALL.into_iter().find(|kind| kind.name() == entry.kind) else { continue };
            *seen.entry(entry.kind.clone()).or_default() += 1;
            let actual = verdict(candidate, &profile, &table, &baselines);
            let is_static = !kind.has_recipe();
            let refused = [
                actual.interface == InterfaceOutcome::Incompatible,
                actual.policy == PolicyOutcome::Incompatible,
                actual.recovery == RecoveryOutcome::Incompatible,
            ];
            let by = [Dimension::Interface, Dimension::Policy, Dimension::Recovery];
            let wanted = by.map(|dimension| is_static && kind.dimension() == dimension);
            assert_eq!(refused, wanted, "seed {seed} {}: {}", entry.kind, entry.what);
        }
    }
    assert_eq!(seen.len(), Listed::ALL.len());
    assert!(seen.values().all(|count| *count == 2 * FAMILIES.len() * SEEDS.len()), "{seen:?}");
}

#[test]
fn a_set_has_the_kinds_of_its_preset_and_no_two_alike() {
    for (preset, benign, faulty, marginal) in
        [(Preset::Full10, 6, 8, 2), (Preset::Paper8, 0, 6, 2), (Preset::AppendixC, 6, 15, 2)]
    {
        let (candidates, truth) = load_pool(pool_spec(100, 1, preset));
        for family in FAMILIES {
            let of = |class: Class| {
                let entries = truth.entries.iter().filter(|entry| entry.name.starts_with(family));
                entries.filter(|entry| entry.class == class).map(|entry| &entry.kind).collect::<Vec<_>>()
            };
            assert_eq!(
                [Class::Benign, Class::Faulty, Class::Marginal].map(|class| of(class).len()),
                [benign, faulty, marginal],
                "{family}"
            );
            let kinds: BTreeSet<&String> = of(Class::Faulty).into_iter().collect();
            assert_eq!(kinds.len(), faulty, "{family}: two candidates are made in the same way: {kinds:?}");
        }
        let grasp_force = |entry: &&holdpoint_lab::candidate_pool::TruthEntry| entry.kind == "behavior-force";
        let example =
            truth.entries.iter().find(grasp_force).expect("the paper's own example is in every set");
        assert!(example.what.contains("grip_force_n 18.0 -> 25.2"), "{}", example.what);
        assert!(example.what.contains("pregrasp_check true -> false"), "{}", example.what);
        assert_eq!(candidates.len(), truth.entries.len());
    }
}

#[test]
fn no_two_candidates_are_equal_and_versions_are_new() {
    let (candidates, _) = load_pool(pool_spec(101, 6, Preset::Full10));
    let mut bodies = BTreeMap::new();
    let mut ids = BTreeSet::new();
    for candidate in &candidates {
        let id = candidate.id();
        assert!(id.version > semver::Version::new(1, 0, 0), "{id}");
        assert!(ids.insert(id.to_string()), "{id} occurs twice");
        // The manifest without its version, and the parameters.
        let mut manifest: toml::Table = candidate.package.manifest.parse().unwrap();
        manifest.remove("version");
        let body = format!("{manifest}{}", candidate.package.params);
        if let Some(other) = bodies.insert(body, id.clone()) {
            panic!("{id} is {other} again");
        }
    }
    assert_eq!(candidates.len(), 288);
}

#[test]
fn names_versions_and_submissions_do_not_tell_the_class() {
    // The mean place of benign candidates in their family's order would reveal a sorted pool.
    let (mut places, mut count) = (0.0, 0.0);
    let mut classes: BTreeMap<String, BTreeSet<bool>> = BTreeMap::new();
    for seed in 100..120 {
        let (candidates, truth) = load_pool(pool_spec(seed, 1, Preset::Full10));
        for (index, (candidate, entry)) in candidates.iter().zip(&truth.entries).enumerate() {
            let benign = entry.class == Class::Benign;
            let family = candidate.id().family;
            let number = entry.name.strip_prefix(&format!("{family}-")).expect("named after its family");
            assert!(number.len() == 3 && number.bytes().all(|b| b.is_ascii_digit()), "{}", entry.name);
            if benign {
                places += (index % 16) as f64;
                count += 1.0;
            }
            for field in ["author", "provenance", "estimated_risk", "summary"] {
                let submission: toml::Table = candidate.package.submission.parse().unwrap();
                classes.entry(format!("{field} {}", submission[field])).or_default().insert(benign);
            }
        }
    }
    // 360 benign candidates: the mean of a shuffled order is 7.5 with a standard error of .25.
    let mean: f64 = places / count;
    assert!((mean - 7.5).abs() < 1.0, "{mean}");
    let giveaways: Vec<&String> =
        classes.iter().filter(|(_, set)| set.len() < 2).map(|(field, _)| field).collect();
    assert!(giveaways.is_empty(), "only one class says {giveaways:?}");
}

#[test]
fn equal_seeds_give_equal_bytes_and_others_do_not() {
    let first = draw(pool_spec(102, 2, Preset::Full10)).unwrap();
    assert_eq!(first, draw(pool_spec(102, 2, Preset::Full10)).unwrap());
    let other = draw(pool_spec(103, 2, Preset::Full10)).unwrap();
    assert_ne!(first.packages, other.packages);
    assert_ne!(first.index.truth_digest, other.index.truth_digest);
}

#[test]
fn written_pool_is_read_back_and_hides_its_ground_truth() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("pool");
    let index = write(pool_spec(100, 1, Preset::Paper8), &dir).unwrap();
    let pool = Pool::read(&dir).unwrap();
    assert_eq!(pool.index, index);
    let truth = pool.truth().unwrap();
    let names = |pool: &Pool| pool.index.candidates.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&pool), truth.entries.iter().map(|entry| entry.name.clone()).collect::<Vec<_>>());
    for candidate in &pool.index.candidates {
        let package = capability::read(&pool.folder(candidate)).unwrap();
        let loaded = Capability::load(&candidate.name, package).unwrap();
        assert_eq!((&loaded.id().family, &loaded.id().version), (&candidate.family, &candidate.version));
    }
    // Existing files are not overwritten.
    assert!(matches!(write(pool_spec(100, 1, Preset::Paper8), &dir), Err(PoolError::Exists(_))));
    // A ground truth with one changed letter scores nothing.
    let path = truth_path(&dir);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replacen("faulty", "benign", 1)).unwrap();
    let error = pool.truth().unwrap_err();
    assert!(matches!(error, PoolError::Tampered { .. }), "{error}");
    assert!(error.to_string().contains(&index.truth_digest), "{error}");
}

#[test]
fn bad_input_is_refused_with_the_allowed_values() {
    for sets in [0, SETS_MAX + 1] {
        let error = draw(pool_spec(100, sets, Preset::Full10)).unwrap_err().to_string();
        assert!(error.contains(&format!("1 to {SETS_MAX}")), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    for (text, part) in [
        ("", "EOF"),
        ("{}", "missing field"),
        (
            r#"{"format":2,"generator":"x","seed":1,"preset":"full-10","sets":1,"truth_digest":"","candidates":[]}"#,
            "format",
        ),
        (
            r#"{"format":1,"generator":"x","seed":1,"preset":"full-9","sets":1,"truth_digest":"","candidates":[]}"#,
            "full-9",
        ),
        (
            r#"{"format":1,"generator":"x","seed":1,"preset":"full-10","sets":1,"truth_digest":"","candidates":[{"name":"../../etc","family":"grasp","version":"1.0.1"}]}"#,
            "no name of a folder",
        ),
    ] {
        fs::write(folder.path().join(INDEX_FILE), text).unwrap();
        let error = Pool::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains(INDEX_FILE), "{text}: {error}");
    }
}

#[test]
fn frozen_pools_equal_those_of_their_seeds() {
    for (folder, seed) in [("manifests/pool", 1), ("manifests/calibration", 100)] {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
        let pool = Pool::read(&dir).unwrap();
        let generated = draw(pool_spec(seed, 1, Preset::Full10)).unwrap();
        assert_eq!(pool.index, generated.index, "{folder}");
        for (candidate, package) in pool.index.candidates.iter().zip(generated.packages) {
            assert_eq!(
                capability::read(&pool.folder(candidate)).unwrap(),
                package,
                "{folder}/{}",
                candidate.name
            );
        }
        assert_eq!(fs::read(truth_path(&dir)).unwrap(), generated.truth, "{folder}");
        assert_eq!(pool.truth().unwrap().entries.len(), pool.index.candidates.len());
    }
}
