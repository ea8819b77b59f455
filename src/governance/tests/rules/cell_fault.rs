//! Drills that the active version cannot do, and fallbacks that the cell lacks: both leave recovery open.

use holdpoint_governance::composition::psi;
use holdpoint_governance::decision::ReasonCode::{self, *};
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    DrillKind, DrillTallies, DrillTally, RecoveryEvidence, SettlingTallies,
};
use holdpoint_governance::finding::{DrillSide, Finding};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::outcome::{BehaviorOutcome, PolicyOutcome, Recommendation, RecoveryOutcome};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::recovery::{self, FallbackMatch, RecoveryAssessment, names_cell_fault};

use crate::fixture::{binding, kappas, made_under, profile, recovery as drilled};

fn assessed(evidence: &RecoveryEvidence, ended: EarlyStopReason) -> RecoveryAssessment {
    recovery::assess_drills(evidence, &binding(), &profile(ProfileName::Real), ended)
}

fn codes(found: &RecoveryAssessment) -> Vec<ReasonCode> {
    found.assessment.reasons.iter().map(|reason| reason.code).collect()
}

#[test]
fn drills_that_the_active_version_cannot_do_reject_no_candidate() {
    use RecoveryOutcome::{Compatible, Incompatible, NoData};
    // Passes of 100: rollback, fallback, abort, detect.
    for (active, candidate, outcome, undrillable) in [
        ([95; 4], [95; 4], Compatible, None),
        ([95; 4], [0, 95, 95, 95], Incompatible, None),
        ([0, 95, 95, 95], [0, 95, 95, 95], NoData, Some(DrillKind::Rollback)),
        ([95, 0, 95, 95], [95, 0, 95, 95], NoData, Some(DrillKind::Fallback)),
        // What the candidate fails alone still counts against it.
        ([0, 95, 95, 95], [0, 0, 95, 95], Incompatible, None),
        // A weak active version, and a candidate that is weaker still.
        ([30, 95, 95, 95], [0, 95, 95, 95], Incompatible, None),
        // A candidate that does what the active version cannot do is not kept waiting.
        ([0, 95, 95, 95], [95; 4], Compatible, None),
    ] {
        let found = assessed(&drilled(active, candidate), EarlyStopReason::Full);
        assert_eq!(found.assessment.outcome, outcome, "{active:?} {candidate:?}: {found:?}");
        assert_eq!(names_cell_fault(&found.assessment), undrillable.is_some(), "{found:?}");
        if let Some(drill) = undrillable {
            let findings: Vec<_> = found.assessment.reasons.iter().map(|reason| &reason.finding).collect();
            assert_eq!(findings, [&Some(Finding::ActiveUndrillable { drill })]);
            assert_eq!((found.assessment.kappa, found.interval), (None, None));
        }
    }
}

#[test]
fn an_early_end_that_the_active_version_shares_rejects_no_candidate() {
    let begun = |active: DrillTally| {
        let failed = DrillTally { passed: 0, failed: 20, infeasible: 0, failed_alone: 0 };
        let of = |rollback| DrillTallies { rollback, ..DrillTallies::default() };
        RecoveryEvidence {
            binding: binding(),
            candidate: of(failed),
            active: of(active),
            settling: SettlingTallies::default(),
        }
    };
    let real = profile(ProfileName::Real);
    for (passed, outcome, code) in [
        (20, RecoveryOutcome::Incompatible, RecoveryEndedEarly),
        (0, RecoveryOutcome::NoData, RecoveryCellFault),
    ] {
        let evidence = begun(DrillTally { passed, failed: 20 - passed, infeasible: 0, failed_alone: 0 });
        let ended = recovery::end_reason(&evidence, &binding(), &real).unwrap();
        assert_ne!(ended, EarlyStopReason::Full);
        let found = assessed(&evidence, ended);
        assert_eq!((found.assessment.outcome, codes(&found)[0]), (outcome, code), "{found:?}");
        assert_eq!(found.ended, Some(ended), "the record names the rule, so that a replay finds the same");
    }
}

#[test]
fn a_shortage_of_drills_is_charged_to_the_side_that_has_it() {
    let few = DrillTally { passed: 10, failed: 0, infeasible: 70, failed_alone: 0 };
    let both = drilled([95; 4], [95; 4]);
    let of_candidate = {
        let mut evidence = both;
        evidence.candidate.detect = few;
        evidence
    };
    let of_both = {
        let mut evidence = of_candidate;
        evidence.active.detect = few;
        evidence
    };
    let first = |evidence: &RecoveryEvidence| {
        let found = assessed(evidence, EarlyStopReason::Full).assessment;
        assert_eq!(found.outcome, RecoveryOutcome::NoData);
        found.reasons[0].finding.clone().unwrap()
    };
    let drill = DrillKind::Detect;
    assert_eq!(first(&of_candidate), Finding::TooFewDrills { side: DrillSide::Candidate, drill });
    assert_eq!(first(&of_both), Finding::ActiveUndrillable { drill });
    // Drills that were left out are no fault of the cell.
    let none = RecoveryEvidence {
        binding: binding(),
        candidate: DrillTallies::default(),
        active: DrillTallies::default(),
        settling: SettlingTallies::default(),
    };
    assert_eq!(codes(&assessed(&none, EarlyStopReason::Full)), [RecoveryNoData]);
}

#[test]
fn a_fallback_that_exists_and_may_not_take_over_is_a_fault_of_the_cell() {
    for (states, found) in [
        (vec![], FallbackMatch::Unregistered),
        (vec![State::Registered, State::RolledBack], FallbackMatch::NotUsable),
        (vec![State::Demoted, State::Superseded], FallbackMatch::Usable),
        (vec![State::Active, State::Rejected], FallbackMatch::Usable),
    ] {
        assert_eq!(FallbackMatch::of(states.clone()), found, "{states:?}");
    }
}

#[test]
fn a_fault_of_the_cell_leads_the_decision_and_is_put_to_no_one() {
    let unsuited = drilled([0, 95, 95, 95], [0, 95, 95, 95]);
    let mut open = kappas(&profile(ProfileName::Real), [1.0; 4]);
    open.recovery = assessed(&unsuited, EarlyStopReason::Full).assessment;
    open.behavior.outcome = BehaviorOutcome::NoData;
    open.policy.outcome = PolicyOutcome::Review;
    for has_approver in [false, true] {
        let decision = psi(&open, has_approver, made_under());
        assert_eq!(*decision.outcome(), Recommendation::Sandbox);
        assert_eq!(decision.reasons()[0].code, RecoveryCellFault);
    }
    // It hides no fault of the candidate's interface or policy.
    open.policy.outcome = PolicyOutcome::Incompatible;
    let decision = psi(&open, false, made_under());
    assert_eq!(*decision.outcome(), Recommendation::Reject);
}
