//! Declared against used permissions, and the effects of conduct, stress and interventions.

use std::collections::BTreeSet;

use holdpoint_governance::behavior::{self, signature};
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::evidence::{Conduct, EpisodeValues, HardStop, ShadowSequence};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::gate::assess_shadow;
use holdpoint_governance::manifest::Manifest;
use holdpoint_governance::mode::{Channel, CommandKind, RequiredCommand, Sensor, ZoneName};
use holdpoint_governance::monitor::{Monitor, MonitorAction, Rate, normal_rates};
use holdpoint_governance::outcome::{Assessment, BehaviorOutcome, CheckResult, PolicyOutcome};
use holdpoint_governance::permission::{PermissionUse, PermissionsUsed};
use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
use holdpoint_governance::profile::ProfileName;

use crate::fixture::{GOOD, binding, exports, manifest, manifest_with, pairs, profile, shadow};

/// The policies of `sim` on a manifest and its code.
fn judge(manifest: &Manifest, code: &Interface) -> Assessment<PolicyOutcome> {
    let profile = profile(ProfileName::Sim);
    let input = PolicyInput {
        permissions: &manifest.permissions,
        environments: &manifest.deployment.environments,
        exports: Some(code),
        active: None,
    };
    policy::assess(&input, &PolicyTable::builtin(&profile).unwrap(), &profile).assessment
}

#[test]
fn sensors_and_tools_of_the_code_must_be_declared() {
    let manifest = manifest();
    let judged = |sensors, tools| judge(&manifest, &Interface { sensors, tools, ..exports(&manifest) });
    let tools = manifest.permissions.tools.clone();
    assert_ne!(judged(BTreeSet::new(), tools.clone()).outcome, PolicyOutcome::Incompatible);
    let camera = judged([Sensor::Camera].into(), tools);
    assert_eq!(camera.outcome, PolicyOutcome::Incompatible);
    assert_eq!(camera.reasons[0].code, ReasonCode::PolicyUndeclaredImport);
    let undeclared = Finding::SensorUndeclared { name: "camera".to_owned() };
    assert_eq!(camera.reasons[0].finding, Some(undeclared));
}

#[test]
fn a_declared_but_uncovered_mode_costs_kappa_p() {
    let kappa = |zones: &str| {
        let manifest = manifest_with("zones = [\"work\", \"transit\"]", zones);
        judge(&manifest, &exports(&manifest)).kappa.unwrap().get()
    };
    assert!((kappa("zones = [\"work\", \"transit\"]") - 1.0).abs() < 1e-12);
    assert!((kappa("zones = [\"work\", \"transit\", \"human\"]") - 2.0 / 3.0).abs() < 1e-12);
}

#[test]
fn a_budget_beyond_the_longest_episode_does_not_fit_the_profile() {
    let ticks_max = profile(ProfileName::Sim).runtime.ticks_max();
    for (ticks, fits) in [(ticks_max, true), (ticks_max + 1, false)] {
        let budget = format!("memory_kib = 1024, ticks_per_task = {ticks} }}");
        let manifest = manifest_with("memory_kib = 1024 }", &budget);
        let reasons = judge(&manifest, &exports(&manifest)).reasons;
        let exceeded = reasons.iter().any(|reason| reason.code == ReasonCode::PolicyResourcesExceeded);
        assert_eq!(!exceeded, fits, "{ticks}");
    }
}

#[test]
fn declared_and_used_permissions_differ_both_ways() {
    let manifest = manifest();
    let sent = |channel, command| RequiredCommand { channel, command };
    let mut used = PermissionsUsed {
        commands: [sent(Channel::Arm, CommandKind::ToolPose)].into(),
        zones: [ZoneName::Work].into(),
        speed_max_m_s: 0.1,
        ..PermissionsUsed::default()
    };
    let other = PermissionsUsed {
        commands: [sent(Channel::Arm, CommandKind::Joints)].into(),
        zones: [ZoneName::Tray].into(),
        speed_max_m_s: 0.3,
        undeclared: 2,
        ..PermissionsUsed::default()
    };
    used.merge(&other);
    let usage = PermissionUse::new(&manifest.permissions, &exports(&manifest), &used, 7);
    assert_eq!(usage.exceeded, ["command arm/joints", "zone tray", "speed 0.300 m/s of 0.2"]);
    let counts: Vec<bool> = usage.excesses().iter().map(|excess| excess.effect().counts()).collect();
    assert_eq!(counts, [true, true, false], "a measured peak is no command");
    assert_eq!(usage.unused, ["channel gripper", "command gripper", "command stop", "zone transit"]);
    assert_eq!((usage.tasks, usage.used.undeclared), (7, 2));
}

#[test]
fn conduct_prolongs_shadow_and_rejects_no_version() {
    let profile = profile(ProfileName::Sim);
    let calm = shadow(&profile);
    assert_eq!(assess_shadow(&calm, &binding(), &profile).check, CheckResult::Pass);
    let all = [
        Conduct { retried: true, ..Conduct::default() },
        Conduct { warned: true, ..Conduct::default() },
        Conduct { near_share: 0.5, ..Conduct::default() },
    ];
    for twin_conduct in all {
        let mut evidence = calm.clone();
        for sequence in &mut evidence.sequences {
            sequence.twin_conduct = twin_conduct;
        }
        let result = assess_shadow(&evidence, &binding(), &profile);
        assert_eq!(result.check, CheckResult::Inconclusive, "{twin_conduct:?}");
        assert_eq!(result.reasons[0].code, ReasonCode::ShadowLeaning);
        // The same of both sides is no difference.
        for sequence in &mut evidence.sequences {
            sequence.live_conduct = twin_conduct;
        }
        assert_eq!(
            assess_shadow(&evidence, &binding(), &profile).check,
            CheckResult::Pass,
            "{twin_conduct:?}"
        );
        let first = calm.sequences[0];
        evidence.sequences = (0..u64::from(profile.evaluation.shadow_sequences_max))
            .map(|seed| ShadowSequence { seed, twin_conduct, ..first })
            .collect();
        assert_eq!(
            assess_shadow(&evidence, &binding(), &profile).check,
            CheckResult::Pass,
            "the longest decides"
        );
    }
}

fn monitor() -> Monitor {
    let profile = profile(ProfileName::Sim);
    Monitor::new(&profile, &normal_rates(&[GOOD; 20], &profile.monitor).unwrap(), 0).unwrap()
}

#[test]
fn timeouts_warnings_and_slow_tasks_are_charted() {
    let slow = profile(ProfileName::Sim).monitor.slow_factor * GOOD.time_s;
    for (bad, named) in [
        (EpisodeValues { timeout: true, ..GOOD }, Rate::Timeout),
        (EpisodeValues { policy_warning: true, ..GOOD }, Rate::PolicyWarning),
        (EpisodeValues { near_violation: true, ..GOOD }, Rate::NearLimit),
        (EpisodeValues { time_s: slow + 0.01, ..GOOD }, Rate::Slow),
    ] {
        let mut monitor = monitor();
        let decisions = (1..=60).map(|tick| monitor.observe(&bad, tick)).collect::<Vec<_>>();
        let first = decisions.iter().find(|decision| decision.action == MonitorAction::Restrict).unwrap();
        assert!(
            first.reasons.iter().any(|reason| match reason.finding {
                Some(Finding::RateDrifts { rate }) => rate == named,
                _ => false,
            }),
            "{named}: {first:?}"
        );
        assert_eq!(decisions.last().unwrap().action, MonitorAction::Rollback, "{named}");
    }
    let mut monitor = monitor();
    let as_before = EpisodeValues { time_s: slow, ..GOOD };
    for tick in 1..=60 {
        assert_eq!(monitor.observe(&as_before, tick).action, MonitorAction::Continue);
    }
}

/// A clamp by the profile in every task is normal for the version: such a rate cannot rise.
#[test]
fn constant_warning_rate_is_no_drift() {
    let clamped = EpisodeValues { policy_warning: true, near_violation: true, ..GOOD };
    for name in ProfileName::ALL {
        let profile = profile(name);
        let expected = normal_rates(&[clamped; 20], &profile.monitor).unwrap();
        let mut monitor = Monitor::new(&profile, &expected, 0).unwrap();
        for tick in 1..=2_000 {
            assert_eq!(monitor.observe(&clamped, tick).action, MonitorAction::Continue, "{name} {tick}");
        }
        let failing = EpisodeValues { success: false, ..clamped };
        let action = (2_001..=2_060).map(|tick| monitor.observe(&failing, tick).action).max();
        assert_eq!(action, Some(MonitorAction::Rollback), "the other charts stand");
    }
}

/// Clamps and slowness under a tighter envelope do not count against the version; everything else does.
#[test]
fn effects_of_a_restriction_are_not_charted() {
    let slow = 2.0 * profile(ProfileName::Sim).monitor.slow_factor * GOOD.time_s;
    let restricted = EpisodeValues { policy_warning: true, near_violation: true, time_s: slow, ..GOOD };
    let mut monitor = monitor();
    monitor.set_tightened(true);
    for tick in 1..=60 {
        assert_eq!(monitor.observe(&restricted, tick).action, MonitorAction::Continue);
    }
    let violating = EpisodeValues { violation: true, ..restricted };
    let action = (61..=120).map(|tick| monitor.observe(&violating, tick).action).max();
    assert_eq!(action, Some(MonitorAction::Rollback));
    let mut monitor = self::monitor();
    let action = (1..=60).map(|tick| monitor.observe(&restricted, tick).action).max();
    assert_eq!(action, Some(MonitorAction::Rollback), "without a restriction it is a drift");
}

#[test]
fn intervention_is_charted_only_as_an_intervention() {
    let mut monitor = monitor();
    let window = monitor.provisional_left();
    let stopped = EpisodeValues {
        success: false,
        recovery: true,
        anomaly: true,
        violation: true,
        intervention: true,
        ..GOOD
    };
    let before: Vec<_> = monitor.charts().map(|(rate, chart, stands, _)| (rate, chart, stands)).collect();
    monitor.observe(&stopped, 1);
    assert_eq!(monitor.provisional_left(), window, "it is no episode of the window");
    let stands = |monitor: &Monitor| monitor.charts().map(|(_, _, stands, _)| stands).collect::<Vec<_>>();
    let mut restricted = self::monitor();
    restricted.record_intervention(1);
    assert_eq!(stands(&restricted), stands(&monitor), "a restriction by a person counts as much as a stop");
    for (known, now) in before.iter().zip(monitor.charts()) {
        let moved = known.2.to_bits() != now.2.to_bits();
        assert_eq!(moved, now.0.name() == "intervention", "{}", now.0);
    }
    let action = (2..=40).map(|tick| monitor.record_intervention(tick).action).max();
    assert_eq!(
        action,
        Some(MonitorAction::Rollback),
        "a version that has to be stopped again and again is rolled back"
    );
}

#[test]
fn unsafe_under_stress_is_a_concern() {
    let profile = profile(ProfileName::Sim);
    let evidence = pairs(&profile);
    for (unsafe_episodes, outcome) in
        [(0, BehaviorOutcome::Compatible), (2, BehaviorOutcome::Compatible), (3, BehaviorOutcome::Suspicious)]
    {
        let mut result = behavior::assess(&evidence, &binding(), &profile);
        behavior::add_stress_concern(&mut result, unsafe_episodes, 10, &profile);
        assert_eq!(result.assessment.outcome, outcome, "{unsafe_episodes}");
        let is_conditional = !result.assessment.conditions.is_empty();
        assert_eq!(is_conditional, outcome == BehaviorOutcome::Suspicious);
    }
}

#[test]
fn hard_stop_that_no_valid_scene_compares_is_a_concern() {
    let profile = profile(ProfileName::Sim);
    for stops in [&[][..], &[HardStop::MotionAfterStop]] {
        let mut result = behavior::assess(&pairs(&profile), &binding(), &profile);
        behavior::add_uncompared_concern(&mut result, stops, &profile);
        let is_suspicious = result.assessment.outcome == BehaviorOutcome::Suspicious;
        let is_named = |reason: &Reason| matches!(reason.finding, Some(Finding::StopUncompared { .. }));
        assert_eq!(is_suspicious, !stops.is_empty());
        assert_eq!(result.assessment.reasons.iter().any(is_named), !stops.is_empty());
    }
}

#[test]
fn time_p95_is_the_time_that_one_in_twenty_exceeds() {
    let at = |time_s: f64| EpisodeValues { time_s, ..GOOD };
    let twenty: Vec<EpisodeValues> = (1..=20).rev().map(|second| at(f64::from(second))).collect();
    assert!((signature(twenty.iter()).unwrap().time_p95_s - 19.0).abs() < 1e-12);
    assert!((signature(twenty[..3].iter()).unwrap().time_p95_s - 20.0).abs() < 1e-12);
}
