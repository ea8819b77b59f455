//! Ending an evaluation before its budget: only to reject, and only if the rule named bears it out.

use holdpoint_governance::behavior;
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    DrillTallies, DrillTally, EpisodeValues, HardStop, Pair, PairedEvidence, RecoveryEvidence,
    SettlingTallies,
};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::outcome::{BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::recovery;
use proptest::prelude::*;

use crate::fixture::{GOOD, binding, digest, pairs, profile, recovery as drilled};

const ANOMALY: EpisodeValues = EpisodeValues { anomaly: true, ..GOOD };
const FAILURE: EpisodeValues = EpisodeValues { success: false, ..GOOD };

/// The first `seen` pairs, of which the candidate's first `bad` are as given.
fn begun(profile: &Profile, seen: usize, bad: usize, how: EpisodeValues) -> PairedEvidence {
    let mut evidence = pairs(profile);
    evidence.pairs.truncate(seen);
    evidence.pairs.iter_mut().take(bad).for_each(|pair| pair.candidate = how);
    evidence
}

fn with_pairs(mut profile: Profile, sandbox_pairs: u32) -> Profile {
    profile.evaluation.sandbox_pairs = sandbox_pairs;
    profile
}

#[test]
fn behavioral_evaluation_ends_by_the_counts() {
    let mut profile = with_pairs(profile(ProfileName::Sim), 120);
    let alpha = profile.evaluation.early_alpha;
    assert!(alpha > 0.0, "the rule is on");
    let early = Some(EarlyStopReason::FinitePopulation { alpha });
    for (seen, bad, how, expected) in [
        (20, 0, GOOD, None),
        (20, 5, FAILURE, None),
        // With 20 of 20 pairs lost, the other 100 could still make the net worsening insignificant.
        (20, 20, FAILURE, None),
        (40, 40, ANOMALY, early),
        (40, 12, ANOMALY, None),
        // The active version's pairs could still outweigh 40 failures in the 80 that are left, in theory.
        (40, 40, FAILURE, early),
        (100, 80, FAILURE, Some(EarlyStopReason::Curtailed)),
        (120, 0, GOOD, Some(EarlyStopReason::Full)),
        (120, 120, FAILURE, Some(EarlyStopReason::Full)),
    ] {
        let evidence = begun(&profile, seen, bad, how);
        assert_eq!(behavior::end_reason(&evidence, &binding(), &profile), expected, "{seen} {bad} {how:?}");
        if expected.is_none() {
            let found = behavior::assess(&evidence, &binding(), &profile);
            assert_eq!(found.assessment.outcome, BehaviorOutcome::Inconclusive);
        }
    }
    let mut hard = begun(&profile, 3, 0, GOOD);
    hard.hard_stops.push(HardStop::CommandPastGuard);
    assert_eq!(behavior::end_reason(&hard, &binding(), &profile), Some(EarlyStopReason::HardStop));
    // Off at 0, and evidence of something else ends nothing.
    profile.evaluation.early_alpha = 0.0;
    let lost = begun(&profile, 40, 40, FAILURE);
    assert_eq!(behavior::end_reason(&lost, &binding(), &profile), None);
    let mut stale = hard;
    stale.binding.candidate = digest("other");
    assert_eq!(behavior::end_reason(&stale, &binding(), &profile), None);
}

#[test]
fn early_end_is_incompatible_only_if_the_evidence_confirms_it() {
    use BehaviorOutcome::{Incompatible, Inconclusive};
    let profile = with_pairs(profile(ProfileName::Sim), 120);
    let early = EarlyStopReason::FinitePopulation { alpha: profile.evaluation.early_alpha };
    let another = EarlyStopReason::FinitePopulation { alpha: 0.04 };
    let code = Some(BehaviorEndedEarly);
    for (seen, bad, named, outcome, first) in [
        (40, 40, early, Incompatible, code),
        (40, 40, another, Inconclusive, None),
        (40, 40, EarlyStopReason::Curtailed, Inconclusive, None),
        (20, 0, early, Inconclusive, None),
        (100, 80, EarlyStopReason::Curtailed, Incompatible, code),
        (100, 80, EarlyStopReason::Full, Inconclusive, None),
        (100, 80, EarlyStopReason::HardStop, Inconclusive, None),
        (120, 120, EarlyStopReason::Full, Incompatible, None),
    ] {
        let found =
            behavior::assess_early_stop(&begun(&profile, seen, bad, FAILURE), &binding(), &profile, named);
        let what = format!("{seen} {bad} {named:?}: {found:?}");
        assert_eq!(found.assessment.outcome, outcome, "{what}");
        let names: Option<ReasonCode> = found
            .assessment
            .reasons
            .first()
            .map(|reason| reason.code)
            .filter(|code| *code == BehaviorEndedEarly);
        assert_eq!(names, first, "{what}");
        let conclusive = first.is_some() || (named == EarlyStopReason::Full && seen == 120);
        assert_eq!(found.ended, conclusive.then_some(named), "{what}");
        assert!(found.assessment.conditions.is_empty() || outcome != Incompatible, "{what}");
    }
    let found = behavior::assess_early_stop(&begun(&profile, 40, 40, FAILURE), &binding(), &profile, early);
    let reason = &found.assessment.reasons[0];
    assert_eq!((reason.evidence, reason.limit), (Some(40.0), Some(120.0)));
    let ended = Finding::PairsEndedEarly {
        rule: EarlyStopReason::FinitePopulation { alpha: 0.01 },
        seen: 40,
        budget: 120,
    };
    assert_eq!(reason.finding, Some(ended));
}

#[test]
fn early_stop_reason_round_trips() {
    for (ended, text) in [
        (EarlyStopReason::Full, r#""full""#),
        (EarlyStopReason::HardStop, r#""hard-stop""#),
        (EarlyStopReason::Curtailed, r#""curtailed""#),
        (EarlyStopReason::FinitePopulation { alpha: 0.01 }, r#"{"finite-population":{"alpha":0.01}}"#),
    ] {
        assert_eq!(serde_json::to_string(&ended).unwrap(), text);
        assert_eq!(serde_json::from_str::<EarlyStopReason>(text).unwrap(), ended);
    }
}

/// Drills with `passed` passed of `of` done, alike in the four kinds.
fn done(passed: u32, of: u32) -> DrillTallies {
    let tally = DrillTally { passed, failed: of - passed, infeasible: 0, failed_alone: 0 };
    DrillTallies { rollback: tally, fallback: tally, abort: tally, detect: tally, ..DrillTallies::default() }
}

#[test]
fn drills_end_by_the_counts() {
    let profile = profile(ProfileName::Real);
    assert_eq!(profile.evaluation.drills_per_kind, 40);
    let early = Some(EarlyStopReason::FinitePopulation { alpha: profile.evaluation.early_alpha });
    let seven = DrillTally { passed: 0, failed: 7, infeasible: 0, failed_alone: 0 };
    let whole = done(40, 40);
    let drilled_alike = RecoveryEvidence { candidate: whole, active: whole, ..drilled([95; 4], [95; 4]) };
    for (candidate, expected) in [
        (DrillTallies::default(), None),
        (done(20, 20), None),
        (done(40, 40), Some(EarlyStopReason::Full)),
        (done(10, 40), Some(EarlyStopReason::Full)),
        // Rollback below the floor of 30 of 40: certain after 11 failures, at the error rate after 7 of 7.
        (
            DrillTallies { rollback: DrillTally { failed: 11, ..DrillTally::default() }, ..whole },
            Some(EarlyStopReason::Curtailed),
        ),
        (DrillTallies { rollback: seven, ..whole }, early),
        (
            DrillTallies {
                rollback: DrillTally { passed: 3, failed: 4, infeasible: 0, failed_alone: 0 },
                ..whole
            },
            None,
        ),
        // A fallback that never works alone is lost only once all of its drills are done.
        (
            DrillTallies { fallback: DrillTally { failed: 39, ..DrillTally::default() }, ..whole },
            Some(EarlyStopReason::Curtailed),
        ),
        (DrillTallies { fallback: seven, ..whole }, None),
    ] {
        let evidence = RecoveryEvidence { candidate, ..drilled_alike };
        assert_eq!(recovery::end_reason(&evidence, &binding(), &profile), expected, "{candidate:?}");
        let Some(named) = expected else { continue };
        let found = recovery::assess_early_stop(&evidence, &binding(), &profile, named);
        assert_eq!(found.ended, Some(named), "{found:?}");
        if named != EarlyStopReason::Full {
            assert_eq!(found.assessment.outcome, RecoveryOutcome::Incompatible, "{found:?}");
            assert_eq!(found.assessment.reasons[0].code, RecoveryEndedEarly, "{found:?}");
            assert!(
                recovery::is_lost(&evidence, &binding(), &profile) || named != EarlyStopReason::Curtailed
            );
        }
        let plain = recovery::assess(&evidence, &binding(), &profile);
        assert_eq!(
            plain.assessment.outcome == RecoveryOutcome::NoData,
            named != EarlyStopReason::Full,
            "{plain:?}"
        );
    }
    // A named rule that the evidence does not confirm is no data.
    let begun = RecoveryEvidence { candidate: done(20, 20), ..drilled_alike };
    for named in
        [EarlyStopReason::Full, EarlyStopReason::Curtailed, EarlyStopReason::FinitePopulation { alpha: 0.01 }]
    {
        let found = recovery::assess_early_stop(&begun, &binding(), &profile, named);
        assert_eq!((found.assessment.outcome, found.ended), (RecoveryOutcome::NoData, None), "{named:?}");
    }
    let mut off = profile;
    off.evaluation.early_alpha = 0.0;
    let lost = RecoveryEvidence { candidate: DrillTallies { rollback: seven, ..whole }, ..drilled_alike };
    assert_eq!(recovery::end_reason(&lost, &binding(), &off), None);
}

#[test]
fn each_kind_of_drill_has_its_intervals() {
    let profile = profile(ProfileName::Real);
    let found = recovery::assess(&drilled([95; 4], [95, 80, 95, 95]), &binding(), &profile);
    assert_eq!(found.kinds.len(), 4);
    for kind in &found.kinds {
        for side in [kind.candidate, kind.active] {
            assert!(side.n == 100 && side.lower < side.rate && side.rate < side.upper, "{kind:?}");
        }
    }
    let worse: Vec<_> = found.kinds.iter().map(|kind| kind.established_worse).collect();
    assert_eq!(worse, [false, true, false, false]);
    let named: Vec<_> =
        found.assessment.reasons.iter().filter(|reason| reason.code == RecoveryEstablishedWorse).collect();
    let fallback = Finding::DrillsWorse { drill: holdpoint_governance::evidence::DrillKind::Fallback };
    assert!(named.len() == 1 && named[0].finding == Some(fallback), "{named:?}");
    // The outcome and kappa_R are the rule's, as before.
    assert_eq!(found.assessment.outcome, RecoveryOutcome::Compatible);
}

fn episode() -> impl Strategy<Value = EpisodeValues> {
    (0..4u8, 0..3u32, 1.0..9.0f64).prop_map(|(bad, retries, time_s)| EpisodeValues {
        success: bad != 1,
        violation: bad == 2,
        anomaly: bad == 3,
        recovery: bad == 1,
        retries,
        time_s,
        ..GOOD
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Where curtailment ends it, the full budget says the same, whatever the rest holds.
    #[test]
    fn a_curtailed_evaluation_is_incompatible_in_full(
        old in proptest::collection::vec(episode(), 60),
        new in proptest::collection::vec(episode(), 60),
        spoilt in 0usize..60,
    ) {
        let profile = with_pairs(profile(ProfileName::Sim), 60);
        let mut full = pairs(&profile);
        for (index, pair) in full.pairs.iter_mut().enumerate() {
            let candidate = if index < spoilt { FAILURE } else { new[index] };
            *pair = Pair { active: old[index], candidate, ..*pair };
        }
        let whole = behavior::assess(&full, &binding(), &profile).assessment.outcome;
        for seen in 0..=60 {
            let mut part = full.clone();
            part.pairs.truncate(seen);
            if behavior::is_lost(&part, &binding(), &profile) {
                prop_assert_eq!(whole, BehaviorOutcome::Incompatible, "after {}", seen);
            }
        }
    }

    /// The same of drills, in any order.
    #[test]
    fn curtailed_drills_are_incompatible_in_full(
        candidate in proptest::array::uniform4(0u32..=40),
        active in proptest::array::uniform4(0u32..=40),
        seen in proptest::array::uniform4(0u32..=40),
        hits in proptest::array::uniform4(0.0..1.0f64),
    ) {
        let profile = profile(ProfileName::Real);
        let tally = |passed: u32, of: u32| DrillTally { passed, failed: of - passed, infeasible: 0, failed_alone: 0 };
        let of = |passed: [u32; 4]| {
            let [rollback, fallback, abort, detect] = passed.map(|passed| tally(passed, 40));
            DrillTallies { rollback, fallback, abort, detect, ..DrillTallies::default() }
        };
        let full = RecoveryEvidence { binding: binding(), candidate: of(candidate), active: of(active), settling: SettlingTallies::default() };
        let mut part = full;
        for (index, kind) in holdpoint_governance::evidence::DrillKind::ALL.into_iter().enumerate() {
            // Any number of the passes that the part can hold.
            let (passed, failed) = (candidate[index], 40 - candidate[index]);
            let (least, most) = (seen[index].saturating_sub(failed), passed.min(seen[index]));
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
            let within = least + (f64::from(most - least) * hits[index]) as u32;
            *part.candidate.of_mut(kind) = tally(within, seen[index]);
        }
        if recovery::is_lost(&part, &binding(), &profile) {
            let whole = recovery::assess(&full, &binding(), &profile).assessment.outcome;
            prop_assert_eq!(whole, RecoveryOutcome::Incompatible);
        }
    }
}
