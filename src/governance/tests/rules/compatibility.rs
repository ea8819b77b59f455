//! `kappa_I`, `kappa_P`, `kappa_B` and `kappa_R` against tables of changes.

use std::collections::BTreeMap;

use holdpoint_body::FailureSignal;
use holdpoint_governance::behavior;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::evidence::{EpisodeValues, HardStop};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::Family;
use holdpoint_governance::interface::declared_changes;
use holdpoint_governance::interface::{self, InterfaceInput, RegisteredVersion};
use holdpoint_governance::manifest::Manifest;
use holdpoint_governance::outcome::{BehaviorOutcome, InterfaceOutcome, PolicyOutcome, RecoveryOutcome};
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::recovery::{self, FallbackMatch, StaticInput};
use holdpoint_governance::submission::{InterfaceChange, InterfaceChangeKind, InterfacePart};

use crate::fixture::{
    GOOD, MANIFEST, binding, exports, manifest, manifest_with, pairs, profile, recovery as drilled,
};

#[test]
fn interface_changes_have_their_outcomes() {
    use InterfaceOutcome::{Compatible, Conditional, Incompatible};
    let thresholds = profile(ProfileName::Sim).thresholds;
    let input = "[inputs.object_pose]";
    let extra = |lines: &str| format!("[inputs.size]\ntype = \"real\"\nunit = \"m\"\n{lines}\n{input}");
    for (from, to, outcome, kappa, code) in [
        ("1.0.0", "1.0.1", Compatible, 1.0, InterfaceCompatible),
        (input, &extra("required = false"), Compatible, 1.0, InterfaceCompatible),
        (input, &extra("default = 0.1"), Incompatible, 0.75, InterfaceSignatureBreaking),
        (input, &extra(""), Incompatible, 0.75, InterfaceSignatureBreaking),
        ("object_pose", "target_pose", Incompatible, 0.75, InterfaceSignatureBreaking),
        ("frame = \"world\"", "frame = \"tool\"", Incompatible, 0.75, InterfaceSignatureBreaking),
        ("[0.05, 0.2]", "[0.05, 0.3]", Compatible, 1.0, InterfaceCompatible),
        ("[0.05, 0.2]", "[0.1, 0.2]", Incompatible, 0.75, InterfaceSignatureBreaking),
        ("[0.0, 0.08]", "[0.0, 0.05]", Compatible, 1.0, InterfaceCompatible),
        ("[0.0, 0.08]", "[0.0, 0.10]", Incompatible, 0.75, InterfaceSchemaBreaking),
        ("outputs.width", "outputs.gap", Incompatible, 0.75, InterfaceSchemaBreaking),
        (
            "range = [0.0, 0.08]",
            "range = [0.0, 0.08]\nrequired = false\ndefault = 0.0",
            Incompatible,
            0.75,
            InterfaceSchemaBreaking,
        ),
        ("min = 0.04", "min = 0.02", Compatible, 1.0, InterfaceCompatible),
        ("min = 0.04", "min = 0.06", Incompatible, 0.75, InterfaceConditionBreaking),
        ("equals = true", "equals = false", Incompatible, 0.75, InterfaceConditionBreaking),
        (
            "environments",
            "dependencies = { align = \"^1\" }\nenvironments",
            Compatible,
            1.0,
            InterfaceCompatible,
        ),
        (
            "environments",
            "dependencies = { align = \"^2\" }\nenvironments",
            Conditional,
            0.875,
            InterfaceDependencyAdaptable,
        ),
        (
            "environments",
            "dependencies = { align = \"^9\" }\nenvironments",
            Incompatible,
            0.75,
            InterfaceDependencyBreaking,
        ),
        (
            "environments",
            "dependencies = { place = \"^1\" }\nenvironments",
            Incompatible,
            0.75,
            InterfaceDependencyBreaking,
        ),
    ] {
        let (active, candidate) = (manifest(), manifest_with(from, to));
        let exports = exports(&candidate);
        let version = |id: &str, active, needs: Option<&str>| RegisteredVersion {
            id: id.parse().unwrap(),
            active,
            dependencies: needs
                .map(|family| (Family::new(family).unwrap(), semver::VersionReq::STAR))
                .into_iter()
                .collect::<BTreeMap<_, _>>(),
        };
        // Place depends on grasp: a circle.
        let registered = [
            version("align@1.0.0", true, None),
            version("align@2.0.0", false, None),
            version("place@1.0.0", true, Some("grasp")),
        ];
        let input = InterfaceInput {
            candidate: &candidate,
            exports: Some(&exports),
            active: Some(&active),
            registered: &registered,
        };
        let found = interface::assess(&input, &thresholds).assessment;
        assert_eq!(
            (found.outcome, found.kappa.unwrap().get()),
            (outcome, kappa),
            "{from:?} -> {to:?}: {found:?}"
        );
        assert_eq!(found.reasons[0].code, code, "{from:?} -> {to:?}");
        let dependency = code == InterfaceDependencyAdaptable;
        let depends = interface::unmet(&candidate, &registered);
        assert_eq!(depends == ["align@^2"], dependency, "{from:?} -> {to:?}: {depends:?}");
        assert!(found.conditions.is_empty(), "{from:?} -> {to:?}");
        let unread = InterfaceInput { exports: None, ..input };
        assert_eq!(interface::assess(&unread, &thresholds).assessment.outcome, InterfaceOutcome::NoData);
    }
}

#[test]
fn code_is_compared_with_manifest_and_label_with_finding() {
    let thresholds = profile(ProfileName::Sim).thresholds;
    let (active, candidate) = (manifest(), manifest_with("min = 0.04", "min = 0.06"));
    let mut code = exports(&candidate);
    let input = InterfaceInput {
        candidate: &candidate,
        exports: Some(&code),
        active: Some(&active),
        registered: &[],
    };
    let found = interface::assess(&input, &thresholds).assessment;
    assert!(found.reasons.iter().any(|reason| reason.code == InterfaceVersionMislabelled), "{found:?}");
    code.entry_points.clear();
    code.failure_signals.insert(FailureSignal::TimedOut);
    let same = manifest();
    let input = InterfaceInput { candidate: &same, exports: Some(&code), active: None, registered: &[] };
    let found = interface::assess(&input, &thresholds).assessment;
    assert_eq!(found.outcome, InterfaceOutcome::Incompatible);
    assert_eq!(
        found.reasons.iter().filter(|reason| reason.code == InterfaceExportMismatch).count(),
        2,
        "{found:?}"
    );
}

#[test]
fn permission_changes_have_their_outcomes() {
    use PolicyOutcome::{Compatible, Conditional, Incompatible, Review};
    use ProfileName::{Human, Real, Sim};
    let zones = "zones = [\"work\", \"transit\"]";
    let channels = "channels = [\"arm\", \"gripper\"]\ncommands = [\"tool-pose\", \"gripper\", \"stop\"]";
    let bus = "channels = [\"arm\", \"gripper\", \"bus\"]\ncommands = [\"tool-pose\", \"gripper\", \"stop\", \"direct\"]";
    for (name, from, to, outcome, code) in [
        (Sim, "1.0.0", "1.0.1", Compatible, PolicyCompatible),
        (Real, "1.0.0", "1.0.1", Compatible, PolicyCompatible),
        (Human, "1.0.0", "1.0.1", Compatible, PolicyCompatible),
        (Sim, zones, "zones = [\"work\", \"transit\", \"human\"]", Incompatible, PolicyUncoveredHighRisk),
        (Real, zones, "zones = [\"work\", \"transit\", \"human\"]", Incompatible, PolicyForbiddenMode),
        (Human, zones, "zones = [\"work\", \"transit\", \"human\"]", Incompatible, PolicyForbiddenMode),
        (Sim, channels, bus, Incompatible, PolicyBelowThreshold),
        (Human, channels, bus, Incompatible, PolicyForbiddenMode),
        (Sim, "authority = 1", "authority = 2", Incompatible, PolicyAuthorityReview),
        (Human, "authority = 1", "authority = 2", Review, PolicyAuthorityReview),
        (Human, "authority = 1", "authority = 3", Incompatible, PolicyForbiddenMode),
        (Real, "max_speed_m_s = 0.2", "max_speed_m_s = 0.6", Conditional, PolicyTighterEnvelope),
        (Sim, "max_speed_m_s = 0.2", "max_speed_m_s = 0.6", Compatible, PolicyCompatible),
        (Real, "\"sim\", \"real\", \"human\"", "\"sim\"", Incompatible, PolicyEnvironmentNotAdmitted),
        (Sim, "\"sim\", \"real\", \"human\"", "\"sim\"", Conditional, PolicySimulationOnly),
        (Human, "memory_kib = 1024", "memory_kib = 20000", Incompatible, PolicyResourcesExceeded),
    ] {
        let profile = profile(name);
        let table = PolicyTable::builtin(&profile).unwrap();
        let (active, candidate) = (manifest(), manifest_with(from, to));
        let exported = exports(&candidate);
        let input = PolicyInput {
            permissions: &candidate.permissions,
            environments: &candidate.deployment.environments,
            exports: Some(&exported),
            active: Some(&active.permissions),
        };
        let found = policy::assess(&input, &table, &profile);
        assert_eq!(found.assessment.outcome, outcome, "{name:?}: {to}: {:?}", found.assessment.reasons);
        assert!(
            found.assessment.reasons.iter().any(|r| r.code == code),
            "{name:?}: {to}: {:?}",
            found.assessment.reasons
        );
        let unread = policy::assess(&PolicyInput { exports: None, ..input }, &table, &profile);
        assert_eq!(unread.assessment.outcome, PolicyOutcome::NoData);
    }
}

/// A limit that is no tighter than the declared one was named as if it were.
#[test]
fn a_tighter_envelope_names_only_what_is_tighter() {
    let profile = profile(ProfileName::Real);
    let table = PolicyTable::builtin(&profile).unwrap();
    let limits = &profile.runtime;
    let (fast, hard) = (limits.tool_speed_max_m_s * 2.0, limits.contact_force_max_n * 2.0);
    let mut candidate = manifest();
    let (slow, soft) = (candidate.permissions.max_speed_m_s, candidate.permissions.max_force_n);
    for (speed, force, tighter) in [
        (slow, soft, None),
        (fast, soft, Some((true, false))),
        (slow, hard, Some((false, true))),
        (fast, hard, Some((true, true))),
    ] {
        candidate.permissions.max_speed_m_s = speed;
        candidate.permissions.max_force_n = force;
        let exported = exports(&candidate);
        let input = PolicyInput {
            permissions: &candidate.permissions,
            environments: &candidate.deployment.environments,
            exports: Some(&exported),
            active: None,
        };
        let found = policy::assess(&input, &table, &profile).assessment;
        let reason = found.reasons.iter().find(|reason| reason.code == PolicyTighterEnvelope);
        let named = reason.map(|reason| match reason.finding.as_ref().unwrap() {
            Finding::EnvelopeTighter { speed_m_s, force_n } => (speed_m_s.is_some(), force_n.is_some()),
            other => panic!("{other:?}"),
        });
        assert_eq!(named, tighter, "{speed} m/s, {force} N: {:?}", found.reasons);
        // The numbers are those of a quantity that is tighter.
        assert!(reason.is_none_or(|reason| reason.evidence > reason.limit), "{reason:?}");
    }
}

#[test]
fn permissions_that_the_code_needs_count_without_a_declaration() {
    let profile = profile(ProfileName::Sim);
    let table = PolicyTable::builtin(&profile).unwrap();
    let quiet = manifest_with("\"stop\"]", "\"stop\"] #");
    let loud = manifest_with(
        "\"tool-pose\", \"gripper\", \"stop\"",
        "\"tool-pose\", \"gripper\", \"stop\", \"joints\"",
    );
    let input = PolicyInput {
        permissions: &quiet.permissions,
        environments: &quiet.deployment.environments,
        exports: Some(&exports(&loud)),
        active: None,
    };
    let found = policy::assess(&input, &table, &profile).assessment;
    assert_eq!((found.outcome, found.reasons[0].code), (PolicyOutcome::Incompatible, PolicyUndeclaredImport));
    // A table of another profile does not apply.
    let other = PolicyTable::builtin(&crate::fixture::profile(ProfileName::Real)).unwrap();
    assert_eq!(policy::assess(&input, &other, &profile).assessment.outcome, PolicyOutcome::NoData);
}

/// `(bad of the active version, bad of the candidate)` out of the budget, in disjoint seeds.
fn behaviour(
    name: ProfileName,
    active: (usize, EpisodeValues),
    candidate: (usize, EpisodeValues),
) -> behavior::BehaviorAssessment {
    let profile = profile(name);
    let mut evidence = pairs(&profile);
    evidence.pairs.iter_mut().take(active.0).for_each(|pair| pair.active = active.1);
    evidence.pairs.iter_mut().rev().take(candidate.0).for_each(|pair| pair.candidate = candidate.1);
    behavior::assess(&evidence, &binding(), &profile)
}

#[test]
fn behavioral_changes_have_their_outcomes() {
    use BehaviorOutcome::{Compatible, Incompatible};
    let anomaly = EpisodeValues { anomaly: true, ..GOOD };
    let violation = EpisodeValues { violation: true, ..GOOD };
    let failure = EpisodeValues { success: false, ..GOOD };
    let recovered = EpisodeValues { recovery: true, ..GOOD };
    let slow = EpisodeValues { time_s: 5.0, ..GOOD };
    let retry = EpisodeValues { retries: 2, ..GOOD };
    for (name, active, candidate, outcome, code) in [
        // Nothing differs: reachable at the budget of each profile.
        (ProfileName::Sim, (0, GOOD), (0, GOOD), Compatible, BehaviorCompatible),
        (ProfileName::Real, (0, GOOD), (0, GOOD), Compatible, BehaviorCompatible),
        (ProfileName::Human, (0, GOOD), (0, GOOD), Compatible, BehaviorCompatible),
        (ProfileName::Human, (0, GOOD), (3, anomaly), Compatible, BehaviorCompatible),
        (ProfileName::Human, (0, GOOD), (12, violation), Incompatible, BehaviorEstablishedWorse),
        (ProfileName::Human, (0, GOOD), (39, anomaly), Incompatible, BehaviorEstablishedWorse),
        (ProfileName::Sim, (0, GOOD), (60, failure), Incompatible, BehaviorEstablishedWorse),
        (ProfileName::Sim, (30, failure), (0, GOOD), Compatible, BehaviorImproved),
        (ProfileName::Sim, (30, failure), (12, anomaly), Incompatible, BehaviorSafetyTraded),
        // Six of 300 more with an anomaly are not significantly worse at this level; seven are.
        (ProfileName::Sim, (30, failure), (6, anomaly), Compatible, BehaviorImproved),
        (ProfileName::Sim, (30, failure), (30, anomaly), Incompatible, BehaviorSafetyTraded),
        // That recovery runs more often is no harm by itself, within its tolerance; bought with it, nothing is.
        (ProfileName::Sim, (0, GOOD), (12, recovered), Compatible, BehaviorCompatible),
        (ProfileName::Sim, (30, failure), (12, recovered), Incompatible, BehaviorSafetyTraded),
        (ProfileName::Sim, (0, GOOD), (90, recovered), Incompatible, BehaviorEstablishedWorse),
        (ProfileName::Sim, (0, GOOD), (300, slow), Compatible, BehaviorCompatible),
        (ProfileName::Sim, (0, GOOD), (300, retry), Incompatible, BehaviorEstablishedWorse),
    ] {
        let found = behaviour(name, active, candidate);
        let codes: Vec<ReasonCode> = found.assessment.reasons.iter().map(|reason| reason.code).collect();
        assert_eq!(found.assessment.outcome, outcome, "{name:?} {active:?} {candidate:?}: {found:?}");
        assert!(codes.contains(&code), "{name:?} {active:?} {candidate:?}: {codes:?}");
    }
    // The M1 of the paper: anomaly +.04 is .92.
    let marginal = behaviour(ProfileName::Human, (0, GOOD), (12, anomaly));
    assert!((marginal.assessment.kappa.unwrap().get() - 0.92).abs() < 1e-12);
}

#[test]
fn unusable_episodes_are_no_data_and_hard_stops_end_it() {
    let profile = profile(ProfileName::Sim);
    let good = pairs(&profile);
    let assess = |evidence| behavior::assess(&evidence, &binding(), &profile).assessment.outcome;
    let mut stale = good.clone();
    stale.binding.policy = crate::fixture::digest("other");
    let mut twice = good.clone();
    twice.pairs[1].seed = 0;
    let mut few = good.clone();
    few.pairs.pop();
    let mut none = good.clone();
    none.pairs.clear();
    let mut hard = good.clone();
    hard.hard_stops.push(HardStop::MotionAfterStop);
    for (name, evidence, expected) in [
        ("stale", stale, BehaviorOutcome::NoData),
        ("twice", twice, BehaviorOutcome::NoData),
        ("few", few, BehaviorOutcome::Inconclusive),
        ("none", none, BehaviorOutcome::NoData),
        ("hard", hard, BehaviorOutcome::Incompatible),
    ] {
        assert_eq!(assess(evidence), expected, "{name}");
    }
    assert!(!behavior::is_lost(&good, &binding(), &profile));
    let mut lost = good;
    lost.pairs.truncate(290);
    lost.pairs.iter_mut().for_each(|pair| pair.candidate.violation = true);
    assert!(behavior::is_lost(&lost, &binding(), &profile));
}

#[test]
fn recovery_changes_have_their_outcomes() {
    use RecoveryOutcome::{Compatible, Conditional, Fragile, Incompatible};
    // Passes of 100: rollback, fallback, abort, detect; against an active version.
    for (active, candidate, outcome, code) in [
        ([95; 4], [95; 4], Compatible, RecoveryCompatible),
        ([95; 4], [93; 4], Compatible, RecoveryCompatible),
        ([82; 4], [76; 4], Conditional, RecoveryConditional),
        ([82; 4], [90, 50, 60, 70], Fragile, RecoveryFragile),
        ([95; 4], [74, 100, 100, 100], Incompatible, RecoveryRollbackBelowFloor),
        ([95; 4], [0, 100, 100, 100], Incompatible, RecoveryRollbackBelowFloor),
        ([95; 4], [90, 0, 100, 100], Incompatible, RecoveryBelowThreshold),
        ([36; 4], [80, 5, 30, 90], Fragile, RecoveryFragile),
        ([36; 4], [80, 1, 10, 60], Incompatible, RecoveryFarBelowFloor),
    ] {
        let profile = profile(ProfileName::Real);
        let found = recovery::assess(&drilled(active, candidate), &binding(), &profile);
        assert_eq!(found.assessment.outcome, outcome, "{candidate:?}: {found:?}");
        assert!(found.assessment.reasons.iter().any(|r| r.code == code), "{candidate:?}: {found:?}");
    }
    let mut few = drilled([95; 4], [95; 4]);
    few.candidate.detect.passed = 30;
    few.candidate.detect.failed = 0;
    few.candidate.detect.infeasible = 70;
    let real = profile(ProfileName::Real);
    assert_eq!(recovery::assess(&few, &binding(), &real).assessment.outcome, RecoveryOutcome::NoData);
}

#[test]
fn missing_recovery_declarations_have_their_outcomes() {
    let knows = FailureSignal::ALL.into_iter().collect();
    let (whole, code) = (manifest(), exports(&manifest()));
    let good = StaticInput {
        manifest: &whole,
        exports: Some(&code),
        predecessor_loads: Some(true),
        predecessor_digest_true: Some(true),
        fallback: Some(FallbackMatch::Usable),
        watcher_knows: &knows,
    };
    let hookless = manifest_with("rollback_hook = \"restore\"\n", "");
    let renamed = manifest_with("\"restore\"", "\"undo\"");
    let unbound = manifest_with("fallback = { family = \"grasp\", version = \"^1\" }\n", "");
    let deaf = std::collections::BTreeSet::new();
    for (name, input, outcome, code) in [
        ("whole", good, RecoveryOutcome::Compatible, RecoveryCompatible),
        (
            "no hook",
            StaticInput { manifest: &hookless, ..good },
            RecoveryOutcome::Incompatible,
            RecoveryHookMissing,
        ),
        (
            "renamed",
            StaticInput { manifest: &renamed, ..good },
            RecoveryOutcome::Incompatible,
            RecoveryHookMissing,
        ),
        (
            "unbound",
            StaticInput { manifest: &unbound, ..good },
            RecoveryOutcome::Incompatible,
            RecoveryFallbackUnresolved,
        ),
        (
            "lost",
            StaticInput { fallback: Some(FallbackMatch::Unregistered), ..good },
            RecoveryOutcome::Incompatible,
            RecoveryFallbackUnresolved,
        ),
        (
            "not in the cell",
            StaticInput { fallback: Some(FallbackMatch::NotUsable), ..good },
            RecoveryOutcome::NoData,
            RecoveryCellFault,
        ),
        (
            "damaged",
            StaticInput { predecessor_digest_true: Some(false), ..good },
            RecoveryOutcome::Incompatible,
            RecoveryPredecessorNotLoadable,
        ),
        ("unknown", StaticInput { predecessor_loads: None, ..good }, RecoveryOutcome::NoData, RecoveryNoData),
        ("unread", StaticInput { exports: None, ..good }, RecoveryOutcome::NoData, RecoveryNoData),
        (
            "deaf",
            StaticInput { watcher_knows: &deaf, ..good },
            RecoveryOutcome::Incompatible,
            RecoverySignalUnknown,
        ),
    ] {
        let found = recovery::static_part(&input);
        assert_eq!((found.outcome, found.reasons[0].code), (outcome, code), "{name}: {found:?}");
    }
}

/// Where the paper has a version usable under bounds only, the bound is issued as a condition.
#[test]
fn versions_usable_under_bounds_get_conditions() {
    let ruled = |name, from: &str, to: &str| {
        let profile = profile(name);
        let candidate = manifest_with(from, to);
        let exported = exports(&candidate);
        let input = PolicyInput {
            permissions: &candidate.permissions,
            environments: &candidate.deployment.environments,
            exports: Some(&exported),
            active: Some(&manifest().permissions),
        };
        policy::assess(&input, &PolicyTable::builtin(&profile).unwrap(), &profile).assessment.conditions
    };
    let environments = "\"sim\", \"real\", \"human\"";
    assert_eq!(ruled(ProfileName::Sim, environments, "\"sim\""), [Condition::SimulationOnly]);
    assert_eq!(ruled(ProfileName::Sim, environments, "\"sim\", \"real\""), []);
    let review = ruled(ProfileName::Human, "authority = 1", "authority = 2");
    assert_eq!(review, [Condition::ApprovalRequired { quorum: 2 }]);
    let longest = profile(ProfileName::Human).evaluation.shadow_sequences_max;
    let slower = |percent: u32| {
        let slow = EpisodeValues { time_s: GOOD.time_s * (1.0 + f64::from(percent) / 100.0), ..GOOD };
        behaviour(ProfileName::Human, (0, GOOD), (usize::MAX, slow)).assessment
    };
    let suspicious = (1..200).map(slower).find(|found| found.outcome == BehaviorOutcome::Suspicious);
    assert_eq!(
        suspicious.expect("some time is neither longer nor as long").conditions,
        [
            Condition::StricterThresholds { factor: 0.5 },
            Condition::ShadowFirst { sequences: longest },
            Condition::RollbackCoupled
        ]
    );
    let real = profile(ProfileName::Real);
    let longest = real.evaluation.shadow_sequences_max;
    for (candidate, conditions) in [
        ([90, 50, 60, 70], vec![Condition::ShadowFirst { sequences: longest }, Condition::RollbackCoupled]),
        ([95; 4], Vec::new()),
    ] {
        let found = recovery::assess(&drilled([82; 4], candidate), &binding(), &real);
        assert_eq!(found.assessment.conditions, conditions, "{candidate:?}");
    }
}

/// Permissions beyond the active version's are named in full, with both levels; for a first version all are.
#[test]
fn permissions_beyond_the_active_version_are_named() {
    let profile = profile(ProfileName::Human);
    let table = PolicyTable::builtin(&profile).unwrap();
    let more = MANIFEST
        .replace(
            "zones = [\"work\", \"transit\"]",
            "zones = [\"work\", \"transit\", \"tray\"]\nsensors = [\"camera\"]",
        )
        .replace("max_force_n = 20.0", "max_force_n = 25.0")
        .replace("memory_kib = 1024", "memory_kib = 2048");
    let candidate = Manifest::parse("manifest.toml", &more).unwrap();
    let exported = exports(&candidate);
    let active = manifest();
    let input = PolicyInput {
        permissions: &candidate.permissions,
        environments: &candidate.deployment.environments,
        exports: Some(&exported),
        active: Some(&active.permissions),
    };
    let found = policy::assess(&input, &table, &profile);
    let named = ["zone tray", "sensor camera", "force 25 N (was 20 N)", "memory 2048 KiB (was 1024 KiB)"];
    assert_eq!(found.added_permissions(), named);
    // A budget that is larger, or left to the profile, is more.
    let mut small = active.permissions.clone();
    (small.resources.ticks_per_task, small.resources.commands_per_task) = (Some(900), Some(70));
    let mut larger = small.clone();
    (larger.resources.ticks_per_task, larger.resources.commands_per_task) = (None, Some(80));
    let request = PolicyInput { permissions: &larger, active: Some(&small), ..input };
    let budgets = policy::assess(&request, &table, &profile);
    let named = ["ticks a task as the profile has them (was 900)", "commands a task 80 (was 70)"];
    assert_eq!(budgets.added_permissions(), named);
    let request = PolicyInput { permissions: &small, active: Some(&larger), ..input };
    assert!(policy::assess(&request, &table, &profile).added_permissions().is_empty());
    let first = policy::assess(&PolicyInput { active: None, ..input }, &table, &profile);
    assert_eq!(first.added_permissions().len(), 2 + 3 + 3 + 2 + 5, "{:?}", first.added_permissions());
    assert!(!first.assessment.reasons.iter().any(|reason| reason.code == PolicyNewPermission));
}

/// An author's declaration of the interface is compared with the finding, part by part.
#[test]
fn declared_interface_changes_are_compared_with_manifests() {
    let candidate = manifest_with("range = [0.0, 0.08]", "range = [0.0, 0.05]");
    let candidate = Manifest {
        inputs: BTreeMap::from([("pose".to_owned(), candidate.inputs["object_pose"].clone())]),
        ..candidate
    };
    let found = declared_changes::changes(Some(&manifest()), &candidate);
    let parts: Vec<_> = found.iter().map(|one| (one.part, one.name.as_str(), one.change)).collect();
    assert_eq!(
        parts,
        [
            (InterfacePart::Input, "object_pose", InterfaceChangeKind::Removed),
            (InterfacePart::Input, "pose", InterfaceChangeKind::Added),
            (InterfacePart::Output, "width", InterfaceChangeKind::Changed),
        ]
    );
    let all: Vec<InterfaceChange> = found.iter().cloned().collect();
    assert!(declared_changes::undeclared_changes(&all, &found).is_empty());
    let held = declared_changes::undeclared_changes(&all[1..], &found);
    assert_eq!((held.len(), held[0].code), (1, InterfaceUndeclaredChange));
    let undeclared = Finding::ChangeUndeclared { change: all[0].clone() };
    assert_eq!(held[0].finding, Some(undeclared));
    let empty = declared_changes::undeclared_changes(
        &all,
        &declared_changes::changes(Some(&manifest()), &manifest()),
    );
    assert_eq!(empty.len(), 3, "declared and not found: {empty:?}");
}

/// A stronger precondition on an input is carried by the dispatcher's check: the condition names what is checked.
#[test]
fn a_stronger_precondition_on_an_input_is_a_condition() {
    let with = |min: &str| {
        MANIFEST
            .replace(
                "[outputs.width]",
                "[inputs.gripper_width]\ntype = \"real\"\nunit = \"m\"\n\n[outputs.width]",
            )
            .replace("min = 0.04", &format!("min = {min}"))
    };
    let parsed = |min: &str| Manifest::parse("manifest.toml", &with(min)).unwrap();
    let (active, candidate) = (parsed("0.04"), parsed("0.06"));
    let code = exports(&candidate);
    let input = InterfaceInput {
        candidate: &candidate,
        exports: Some(&code),
        active: Some(&active),
        registered: &[],
    };
    let found = interface::assess(&input, &profile(ProfileName::Sim).thresholds).assessment;
    assert_eq!(
        (found.outcome, found.reasons[0].code),
        (InterfaceOutcome::Conditional, InterfaceConditionAdaptable)
    );
    let checked = Condition::CheckedCall { fields: vec!["gripper_width".to_owned()] };
    assert_eq!(found.conditions, std::slice::from_ref(&checked));
    // A record of an older build reads as the same condition.
    let older = serde_json::json!({ "kind": "interface-adapter", "fields": ["gripper_width"] });
    assert_eq!(serde_json::from_value::<Condition>(older).unwrap(), checked);
}
