//! The drills of one kind in one phase of the work: nothing is averaged away over easy phases.
//!
//! A hand that opens at a stop passes every drill in which it holds nothing. Reports what the counts of each phase
//! support; the rule of [`super`] gives the outcome.

use serde::{Deserialize, Serialize};

use super::compare::{RateInterval, interval, is_worse};
use crate::decision::Reason;
use crate::evidence::{DrillKind, RecoveryEvidence};
use crate::finding::Finding;
use crate::phase::{PhaseTallies, WorkPhase};
use crate::profile::Profile;

/// Feasible drills from which the share of a phase counts: with five, a hook that always fails there is below half of
/// any floor for certain, and one that fails in one of ten drills is with probability 1e-5 (none of five passes).
pub const PHASE_DRILLS_MIN: u32 = 5;

/// One kind of drill in one phase, both versions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseRates {
    /// The kind of drill.
    pub kind: DrillKind,
    /// The phase in which the drills began.
    pub phase: WorkPhase,
    /// How often the candidate passed; absent with fewer than [`PHASE_DRILLS_MIN`].
    pub candidate: Option<RateInterval>,
    /// How often the active version passed; absent with fewer.
    pub active: Option<RateInterval>,
    /// The candidate passes in less than half of the floor, and leans toward passing less often.
    pub failing: bool,
    /// The candidate's rate is established as lower at `evaluation.alpha`, shared by every kind in every phase that
    /// both versions were drilled in.
    pub established_worse: bool,
    /// The active version was drilled here, and the candidate, whose work comes here too seldom, was not; nor was it in
    /// another phase in which what hangs in the hand moves, if this is one.
    pub missing: bool,
}

/// The pass rate below which recovery is unusable.
pub(super) fn unusable_rate(profile: &Profile) -> f64 {
    profile.recovery.unusable_share * profile.recovery.rho_floor
}

/// Every kind in every phase that either version was drilled in.
pub(super) fn phases(evidence: &RecoveryEvidence, profile: &Profile) -> Vec<PhaseRates> {
    let (new, old) = (&evidence.candidate.phases, &evidence.active.phases);
    let both = |place: &(DrillKind, WorkPhase)| {
        [new, old].iter().all(|tallies| tallies.of(place.0, place.1).feasible() >= PHASE_DRILLS_MIN)
    };
    let compared = PhaseTallies::places().filter(both).count().max(1);
    let alpha = profile.evaluation.alpha / compared as f64;
    let least = unusable_rate(profile);
    let tallies = new;
    let rates = |(kind, phase): (DrillKind, WorkPhase)| {
        let (new, old) = (new.of(kind, phase), old.of(kind, phase));
        let (candidate, active) = (interval(new, PHASE_DRILLS_MIN), interval(old, PHASE_DRILLS_MIN));
        // Where the active version passes as seldom, that is a finding about it and no reason against its successor.
        let leans = active.is_none() || is_worse(new, old, profile.recovery.lean_alpha);
        let failing = candidate.is_some_and(|found| found.rate < least) && leans;
        let established_worse = candidate.is_some() && active.is_some() && is_worse(new, old, alpha);
        // A path that is a diagonal has no lift, and one that lifts at once does not hold where the object stands: what
        // hangs in the hand and moves, which is more, was rehearsed all the same.
        let alike = |other: &WorkPhase| tallies.of(kind, *other).feasible() >= PHASE_DRILLS_MIN;
        let covered = (phase.moves_what_hangs() || phase == WorkPhase::Holding)
            && WorkPhase::ALL.iter().any(|other| other.moves_what_hangs() && alike(other));
        let missing = active.is_some() && 2 * new.feasible() < old.feasible() && !covered;
        PhaseRates { kind, phase, candidate, active, failing, established_worse, missing }
    };
    let drilled = |place: &(DrillKind, WorkPhase)| {
        [new, old].iter().any(|tallies| tallies.of(place.0, place.1).feasible() > 0)
    };
    PhaseTallies::places().filter(drilled).map(rates).collect()
}

/// Says that the candidate fails in a phase, or is established as worse there.
pub(super) fn reason(found: &PhaseRates, profile: &Profile) -> Option<Reason> {
    let PhaseRates { kind, phase, candidate, active, .. } = found;
    let rate = candidate.map_or(0.0, |candidate| candidate.rate);
    let (drill, phase) = (*kind, *phase);
    let (finding, limit) = if found.failing {
        (Finding::PhaseFails { drill, phase }, unusable_rate(profile))
    } else if found.established_worse {
        (Finding::PhaseWorse { drill, phase }, active.map_or(0.0, |active| active.rate))
    } else {
        return None;
    };
    Some(super::reason(finding).with(rate, limit))
}

/// Where the active version itself is weak: a kind below the floor, or a kind in one phase below half of it. No reason
/// for or against a candidate, which is compared with it; operators have to know.
pub(super) fn weaknesses(
    kinds: &[super::KindRates],
    phases: &[PhaseRates],
    profile: &Profile,
) -> Vec<Reason> {
    let (floor, unusable) = (profile.recovery.rho_floor, unusable_rate(profile));
    let reason = |drill, phase, rate: f64, limit: f64| {
        super::reason(Finding::ActiveWeak { drill, phase }).with(rate, limit)
    };
    let of_kinds = kinds
        .iter()
        .filter(|found| found.active.rate < floor)
        .map(|found| reason(found.kind, None, found.active.rate, floor));
    let of_phases = phases.iter().filter_map(|found| {
        let active = found.active.filter(|active| active.rate < unusable)?;
        Some(reason(found.kind, Some(found.phase), active.rate, unusable))
    });
    of_kinds.chain(of_phases).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decision::ReasonCode;
    use crate::evidence::{DrillTallies, DrillTally, EvidenceBinding, SettlingTallies};
    use crate::ids::Digest;
    use crate::outcome::RecoveryOutcome;
    use crate::profile::ProfileName;

    const fn of(passed: u32, failed: u32) -> DrillTally {
        DrillTally { passed, failed, infeasible: 0, failed_alone: 0 }
    }

    /// Drills of every kind in four phases, ten each, all passed but those of one kind in one phase.
    fn drills(kind: DrillKind, phase: WorkPhase, tally: DrillTally) -> DrillTallies {
        let mut drills = DrillTallies::default();
        for each in DrillKind::ALL {
            for at in [WorkPhase::Approach, WorkPhase::Contact, WorkPhase::Holding, WorkPhase::Lifting] {
                let tally = if (each, at) == (kind, phase) { tally } else { of(10, 0) };
                *drills.phases.of_mut(each, at) = tally;
                let whole = drills.of_mut(each);
                *whole = of(whole.passed + tally.passed, whole.failed + tally.failed);
            }
        }
        drills
    }

    fn phase_judgement(candidate: &DrillTallies, active: &DrillTallies) -> super::super::RecoveryAssessment {
        let digest = Digest::of_parts("test", &[]);
        let binding = EvidenceBinding {
            candidate: digest,
            active: None,
            profile: digest,
            policy: digest,
            environment: digest,
            neighbours: None,
            anchor: None,
        };
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        super::super::assess(
            &RecoveryEvidence {
                binding,
                candidate: *candidate,
                active: *active,
                settling: SettlingTallies::default(),
            },
            &binding,
            &profile,
        )
    }

    #[test]
    fn failing_phase_is_not_averaged_away() {
        let good = drills(DrillKind::Abort, WorkPhase::Lifting, of(10, 0));
        let abort = |passed| drills(DrillKind::Abort, WorkPhase::Lifting, of(passed, 10 - passed));
        for (candidate, active, outcome, code) in [
            (good, good, RecoveryOutcome::Compatible, ReasonCode::RecoveryCompatible),
            // A quarter of all aborts, rho .93: without its phase it would be compatible.
            (abort(0), good, RecoveryOutcome::Incompatible, ReasonCode::RecoveryPhaseFailing),
            (abort(3), good, RecoveryOutcome::Incompatible, ReasonCode::RecoveryPhaseFailing),
            // As weak as the active version, give or take what chance gives, is not worse.
            (abort(0), abort(1), RecoveryOutcome::Compatible, ReasonCode::RecoveryActiveWeak),
            (abort(2), abort(4), RecoveryOutcome::Compatible, ReasonCode::RecoveryCompatible),
            (abort(0), abort(6), RecoveryOutcome::Incompatible, ReasonCode::RecoveryPhaseFailing),
            (abort(9), good, RecoveryOutcome::Compatible, ReasonCode::RecoveryCompatible),
        ] {
            let found = phase_judgement(&candidate, &active).assessment;
            assert_eq!(found.outcome, outcome, "{:?}", found.reasons);
            assert!(found.reasons.iter().any(|reason| reason.code == code), "{:?}", found.reasons);
        }
    }

    #[test]
    fn seven_failures_of_ten_in_one_phase_are_found() {
        // Ten drills in each of sixteen places, the active version passing all: the fewest failures that count.
        let abort = |failed| drills(DrillKind::Abort, WorkPhase::Lifting, of(10 - failed, failed));
        let outcomes: Vec<RecoveryOutcome> =
            (0..=10).map(|failed| phase_judgement(&abort(failed), &abort(0)).assessment.outcome).collect();
        let first = |outcome| outcomes.iter().position(|found| *found == outcome);
        assert_eq!(first(RecoveryOutcome::Incompatible), Some(7), "{outcomes:?}");
        assert!(outcomes[7..].iter().all(|found| *found == RecoveryOutcome::Incompatible), "{outcomes:?}");
    }

    #[test]
    fn a_hook_that_always_fails_is_found_in_the_fewest_drills_that_count() {
        let five = |passed, failed| {
            let mut all = drills(DrillKind::Abort, WorkPhase::Lifting, of(10, 0));
            *all.phases.of_mut(DrillKind::Abort, WorkPhase::Lifting) = of(passed, failed);
            all
        };
        let (whole, none) = (five(PHASE_DRILLS_MIN, 0), five(0, PHASE_DRILLS_MIN));
        assert_eq!(phase_judgement(&none, &whole).assessment.outcome, RecoveryOutcome::Incompatible);
        assert_eq!(phase_judgement(&whole, &whole).assessment.outcome, RecoveryOutcome::Compatible);
    }

    #[test]
    fn a_phase_the_candidate_never_shows_is_missing_evidence() {
        let good = drills(DrillKind::Abort, WorkPhase::Lifting, of(10, 0));
        let mut without = good;
        for kind in DrillKind::ALL {
            *without.phases.of_mut(kind, WorkPhase::Lifting) =
                DrillTally { passed: 0, failed: 0, infeasible: 20, failed_alone: 0 };
        }
        let found = phase_judgement(&without, &good).assessment;
        assert_eq!(found.outcome, RecoveryOutcome::NoData);
        assert!(
            found.reasons.iter().any(|reason| {
                matches!(reason.finding, Some(Finding::TooFewPhaseDrills { phase: WorkPhase::Lifting, .. }))
            }),
            "{:?}",
            found.reasons
        );
        // The object in the hand was moved another way.
        for kind in DrillKind::ALL {
            *without.phases.of_mut(kind, WorkPhase::Transport) = of(10, 0);
        }
        assert_eq!(phase_judgement(&without, &good).assessment.outcome, RecoveryOutcome::Compatible);
    }

    #[test]
    fn grasp_without_a_holding_phase_needs_no_drill_in_it() {
        let good = drills(DrillKind::Abort, WorkPhase::Lifting, of(10, 0));
        let mut without = good;
        for kind in DrillKind::ALL {
            *without.phases.of_mut(kind, WorkPhase::Holding) = of(2, 0);
        }
        assert_eq!(phase_judgement(&without, &good).assessment.outcome, RecoveryOutcome::Compatible);
        // An approach is a separate case, and so is a grasp without a drill with the object hanging.
        for phase in [WorkPhase::Approach, WorkPhase::Lifting] {
            let mut lacking = without;
            for kind in DrillKind::ALL {
                *lacking.phases.of_mut(kind, phase) = of(2, 0);
            }
            assert_eq!(
                phase_judgement(&lacking, &good).assessment.outcome,
                RecoveryOutcome::NoData,
                "{phase}"
            );
        }
    }

    #[test]
    fn an_active_versions_weakness_is_reported() {
        let weak = drills(DrillKind::Detect, WorkPhase::Lifting, of(2, 8));
        let found = phase_judgement(&weak, &weak).assessment;
        let reasons = found.reasons.iter().filter(|reason| reason.code == ReasonCode::RecoveryActiveWeak);
        assert_eq!(reasons.count(), 1, "the phase, and no kind as a whole: {:?}", found.reasons);
        assert_eq!(found.outcome, RecoveryOutcome::Compatible);
    }

    #[test]
    fn phase_tallies_are_stored_as_rows() {
        let drills = drills(DrillKind::Abort, WorkPhase::Lifting, of(4, 6));
        let text = serde_json::to_string(&drills).unwrap();
        assert_eq!(serde_json::from_str::<DrillTallies>(&text).unwrap(), drills);
        let row = r#"{"kind":"abort","phase":"lifting","passed":4,"failed":6,"infeasible":0}"#;
        assert!(text.contains(row), "{text}");
        let twice = text.replace("\"phases\":[", &format!("\"phases\":[{row},"));
        let error = serde_json::from_str::<DrillTallies>(&twice).unwrap_err().to_string();
        assert!(
            error.contains(DrillKind::Abort.name()) && error.contains(WorkPhase::Lifting.name()),
            "{error}"
        );
        assert!(!serde_json::to_string(&DrillTallies::default()).unwrap().contains("phases"));
    }
}
