//! A value that is NaN, missing or of other circumstances never passes.

use holdpoint_governance::behavior;
use holdpoint_governance::composition::composite;
use holdpoint_governance::decision::Kappa;
use holdpoint_governance::evidence::{EpisodeValues, EvidenceBinding, Signature};
use holdpoint_governance::gate;
use holdpoint_governance::monitor::{Monitor, MonitorAction};
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile::fields::Weights;
use holdpoint_governance::recovery;
use proptest::prelude::*;

use crate::fixture::{GOOD, binding, digest, pairs, profile, recovery as drilled, shadow};

fn no_number() -> impl Strategy<Value = f64> {
    prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(-1.0), Just(1e300)]
}

fn spoil(episode: &mut EpisodeValues, field: usize, value: f64) {
    match field {
        0 => episode.time_s = value,
        1 => episode.unsafe_continuation_ms = value,
        _ => episode.retries = u32::MAX,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn one_bad_number_in_an_episode_never_passes(field in 0..3usize, at in 0..300usize, old in any::<bool>(), value in no_number()) {
        let profile = profile(ProfileName::Sim);
        let mut evidence = pairs(&profile);
        let pair = &mut evidence.pairs[at];
        spoil(if old { &mut pair.active } else { &mut pair.candidate }, field, value);
        let found = behavior::assess(&evidence, &binding(), &profile);
        prop_assert!(!CheckResult::from(found.assessment.outcome).advances(), "{:?}", found.assessment);
        prop_assert_eq!(found.assessment.kappa, None);
    }

    #[test]
    fn one_bad_number_in_shadow_never_passes(field in any::<bool>(), at in 0..20usize, value in no_number()) {
        let profile = profile(ProfileName::Sim);
        let mut evidence = shadow(&profile);
        let sequence = &mut evidence.sequences[at];
        *(if field { &mut sequence.output_divergence } else { &mut sequence.envelope_divergence }) = value;
        prop_assert!(!gate::assess_shadow(&evidence, &binding(), &profile).check.advances());
    }

    #[test]
    fn one_foreign_digest_never_passes(which in 0..5usize) {
        let profile = profile(ProfileName::Sim);
        let other = digest("other");
        let mut foreign: EvidenceBinding = binding();
        match which {
            0 => foreign.candidate = other,
            1 => foreign.active = None,
            2 => foreign.profile = other,
            3 => foreign.policy = other,
            _ => foreign.environment = other,
        }
        prop_assert!(!CheckResult::from(behavior::assess(&pairs(&profile), &foreign, &profile).assessment.outcome).advances());
        let drills = drilled([95; 4], [95; 4]);
        prop_assert!(!CheckResult::from(recovery::assess(&drills, &foreign, &profile).assessment.outcome).advances());
        prop_assert!(!gate::assess_shadow(&shadow(&profile), &foreign, &profile).check.advances());
    }

    #[test]
    fn missing_drills_never_pass(kind in 0..4usize, left in 0..40u32, old in any::<bool>()) {
        let profile = profile(ProfileName::Sim);
        let mut evidence = drilled([95; 4], [95; 4]);
        let drills = if old { &mut evidence.active } else { &mut evidence.candidate };
        let tally = drills.of_mut(holdpoint_governance::evidence::DrillKind::ALL[kind]);
        (tally.passed, tally.failed, tally.infeasible) = (left, 0, 100);
        let found = recovery::assess(&evidence, &binding(), &profile);
        prop_assert!(!CheckResult::from(found.assessment.outcome).advances(), "{:?}", found);
    }

    #[test]
    fn more_anomalies_never_raise_kappa(worse in 0..60usize, more in 1..60usize) {
        let profile = profile(ProfileName::Sim);
        let kappa = |count: usize| {
            let mut evidence = pairs(&profile);
            let bad = EpisodeValues { anomaly: true, ..GOOD };
            evidence.pairs.iter_mut().take(count).for_each(|pair| pair.candidate = bad);
            behavior::assess(&evidence, &binding(), &profile).assessment.kappa.map(Kappa::get)
        };
        prop_assert!(kappa(worse) >= kappa(worse + more));
    }

    #[test]
    fn declared_traces_that_are_not_finite_never_pass(field in 0..6usize, value in prop_oneof![Just(f64::NAN), Just(f64::INFINITY)]) {
        let profile = profile(ProfileName::Sim);
        let good = behavior::signature([GOOD; 4].iter()).unwrap();
        let mut bad: Signature = good;
        let slot = [&mut bad.success, &mut bad.time_s, &mut bad.retry, &mut bad.violation, &mut bad.anomaly, &mut bad.recovery];
        *slot.into_iter().nth(field).unwrap() = value;
        // The candidate's are worse than any; as the active version's, they are no yardstick.
        for found in [behavior::estimate(&bad, &good, &profile), behavior::estimate(&good, &bad, &profile)] {
            prop_assert!(!CheckResult::from(found.assessment.outcome).advances(), "{:?}", found);
        }
        // Time is not charted: it has no share of bad episodes.
        prop_assert!(field == 1 || Monitor::new(&profile, &bad, 0).is_err());
    }

    #[test]
    fn number_outside_its_range_is_no_kappa(value in prop_oneof![no_number(), Just(1.000_001)]) {
        prop_assert_eq!(Kappa::new(value), None);
        prop_assert_eq!(recovery::kappa(value, 0.9), None);
        prop_assert_eq!(recovery::kappa(0.9, value), None);
        let one = Kappa::new(1.0);
        prop_assert_eq!(composite(&Weights::PAPER, [one, one, Kappa::new(value), one]), None);
    }

    #[test]
    fn monitor_rolls_back_a_version_with_non_finite_values(field in 0..3usize, value in no_number()) {
        let profile = profile(ProfileName::Sim);
        let good = behavior::signature([GOOD; 4].iter()).unwrap();
        let mut monitor = Monitor::new(&profile, &good, 0).unwrap();
        let mut episode = GOOD;
        spoil(&mut episode, field, value);
        prop_assert_eq!(monitor.observe(&episode, 1).action, MonitorAction::Rollback);
    }
}
