//! The live-like pairs alone reject a version or raise a concern, and equally good versions pass them.

use holdpoint_governance::behavior::{BehaviorAssessment, live_like_pairs};
use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{EpisodeValues, Pair, PairedEvidence};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::profile::{Profile, ProfileName};

use crate::fixture::{GOOD, binding, comparison, pairs, profile, recovery};

const FAILED: EpisodeValues = EpisodeValues { success: false, recovery: true, ..GOOD };

const VIOLATING: EpisodeValues = EpisodeValues { violation: true, ..GOOD };

/// Equal pairs, of which every third is live-like.
fn mixed(profile: &Profile) -> PairedEvidence {
    let mut evidence = pairs(profile);
    evidence.pairs.iter_mut().step_by(3).for_each(|pair| pair.live_like = true);
    evidence
}

/// The same, with the candidate's values in the first so many live-like pairs, or in the first so many others.
fn with(profile: &Profile, values: EpisodeValues, count: usize, in_live_like: bool) -> PairedEvidence {
    let mut evidence = mixed(profile);
    let of_kind = evidence.pairs.iter_mut().filter(|pair| pair.live_like == in_live_like);
    of_kind.take(count).for_each(|pair| pair.candidate = values);
    evidence
}

fn assess(evidence: &PairedEvidence, profile: &Profile) -> BehaviorAssessment {
    let drills = recovery([100; 4], [100; 4]);
    let all = ComparisonEvidence { has_live_like: true, ..comparison(evidence, &drills) };
    all.assess(&binding(), EarlyStopReason::Full, profile).0
}

fn outcome(evidence: &PairedEvidence, profile: &Profile) -> BehaviorOutcome {
    assess(evidence, profile).assessment.outcome
}

#[test]
fn without_a_third_of_live_like_pairs_no_version_is_compatible() {
    for name in ProfileName::ALL {
        let profile = profile(name);
        let found = assess(&mixed(&profile), &profile);
        assert_eq!(found.assessment.outcome, BehaviorOutcome::Compatible, "{:?}", found.assessment.reasons);
        let own = found.live_like.unwrap();
        assert_eq!(own.pairs, live_like_pairs(profile.evaluation.sandbox_pairs));
        let mut short = mixed(&profile);
        short.pairs[0].live_like = false;
        for evidence in [short, pairs(&profile)] {
            let found = assess(&evidence, &profile).assessment;
            assert_eq!(found.outcome, BehaviorOutcome::Inconclusive, "{:?}", found.reasons);
            assert_eq!(found.reasons[0].finding, Some(Finding::TooFewLiveLikePairs));
            assert!(found.reasons.iter().all(|reason| reason.code != ReasonCode::BehaviorCompatible));
        }
    }
}

/// The numbers are those of SciPy (`tests/reports/recompute_store.py`).
#[test]
fn loss_in_the_live_like_pairs_alone_rejects() {
    let profile = profile(ProfileName::Sim);
    for (lost, in_live_like, expected) in [
        (6, true, BehaviorOutcome::Compatible),
        (7, true, BehaviorOutcome::Incompatible),
        (14, true, BehaviorOutcome::Incompatible),
        (14, false, BehaviorOutcome::Compatible),
    ] {
        let found = assess(&with(&profile, FAILED, lost, in_live_like), &profile);
        assert_eq!(found.assessment.outcome, expected, "{lost} {in_live_like}: {:?}", found.assessment);
        let first = &found.assessment.reasons[0];
        assert_eq!(
            first.code == ReasonCode::BehaviorLiveLikeWorse,
            expected == BehaviorOutcome::Incompatible
        );
    }
}

#[test]
fn violations_in_the_live_like_pairs_are_a_concern_beyond_the_wider_margin() {
    let profile = profile(ProfileName::Sim);
    for (violating, in_live_like, expected) in [
        (4, true, BehaviorOutcome::Compatible),
        (5, true, BehaviorOutcome::Suspicious),
        (6, true, BehaviorOutcome::Suspicious),
        (6, false, BehaviorOutcome::Compatible),
    ] {
        let found = assess(&with(&profile, VIOLATING, violating, in_live_like), &profile).assessment;
        assert_eq!(found.outcome, expected, "{violating} {in_live_like}: {:?}", found.reasons);
        let is_concern = expected == BehaviorOutcome::Suspicious;
        assert_eq!(found.reasons[0].code == ReasonCode::BehaviorLiveLikeSuspicious, is_concern);
        assert_eq!(found.conditions.is_empty(), !is_concern);
        if is_concern {
            let (upper, limit) = (found.reasons[0].evidence.unwrap(), found.reasons[0].limit.unwrap());
            assert!(upper > limit && (limit - 2.0 * 0.05).abs() < 1e-9, "{upper} {limit}");
        }
    }
}

/// Equally good versions whose failures differ in one episode of ten by chance. About one of 300 is expected to be rejected
/// for its live-like pairs; more than four are in 2 of 1,000 such tests.
#[test]
fn equally_good_versions_pass_the_live_like_pairs() {
    let profile = profile(ProfileName::Sim);
    let mut state = 11_u64;
    let mut below = |limit: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % limit
    };
    let mut lost = 0;
    for _ in 0..300 {
        let mut evidence = mixed(&profile);
        for pair in &mut evidence.pairs {
            match below(20) {
                0 => pair.candidate = FAILED,
                1 => pair.active = FAILED,
                _ => {}
            }
        }
        let mut without = evidence.clone();
        // The same pairs where nothing differs in the live-like ones.
        without.pairs.iter_mut().filter(|pair| pair.live_like).for_each(|pair| {
            *pair = Pair { active: GOOD, candidate: GOOD, ..*pair };
        });
        let is_lost = |evidence: &PairedEvidence| outcome(evidence, &profile) != BehaviorOutcome::Compatible;
        lost += u32::from(is_lost(&evidence) && !is_lost(&without));
    }
    assert!(lost <= 4, "{lost} of 300");
}

#[test]
fn pair_of_an_older_record_is_not_live_like() {
    let pair = Pair { seed: 7, active: GOOD, candidate: GOOD, live_like: false };
    let older = serde_json::to_string(&pair).unwrap();
    assert!(!older.contains("live_like"), "{older}");
    assert_eq!(serde_json::from_str::<Pair>(&older).unwrap(), pair);
    let live_like = Pair { live_like: true, ..pair };
    let text = serde_json::to_string(&live_like).unwrap();
    assert_eq!(serde_json::from_str::<Pair>(&text).unwrap(), live_like);
}
