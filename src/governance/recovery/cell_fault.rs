//! Faults of the cell that keep a candidate from being drilled: the active version cannot do the drills, or no fallback
//! may take over.
//!
//! A fault of the cell leaves recovery open. It never makes a candidate incompatible.

use super::phases::unusable_rate;
use super::{PHASE_DRILLS_MIN, RecoveryAssessment, assess_early_stop, compare, reason};
use crate::decision::{Reason, ReasonCode};
use crate::early_stop::EarlyStopReason;
use crate::evidence::{DrillKind, DrillTallies, DrillTally, EvidenceBinding, RecoveryEvidence};
use crate::finding::Finding;
use crate::lifecycle::State;
use crate::manifest::Fallback;
use crate::outcome::{Assessment, RecoveryOutcome};
use crate::profile::Profile;

/// What the registry has of the fallback that a manifest binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FallbackMatch {
    /// A version that meets the binding may take over.
    Usable,
    /// Registered versions meet the binding, and none of them may take over: a fault of the cell.
    NotUsable,
    /// No version that meets the binding was ever registered: a fault of the manifest.
    Unregistered,
}

impl FallbackMatch {
    /// Whether a version in this state may take over as a fallback.
    #[must_use]
    pub const fn is_usable(state: State) -> bool {
        matches!(state, State::Active | State::Superseded)
    }

    /// The match by the states of all registered versions that meet the binding.
    #[must_use]
    pub fn of(states: impl IntoIterator<Item = State>) -> Self {
        let mut found = Self::Unregistered;
        for state in states {
            if Self::is_usable(state) {
                return Self::Usable;
            }
            found = Self::NotUsable;
        }
        found
    }
}

/// The reason that the cell has no version that may take over as this fallback.
pub(super) fn not_in_cell(fallback: &Fallback) -> Reason {
    let (family, requirement) = (fallback.family.clone(), fallback.version.to_string());
    reason(Finding::FallbackNotInCell { family, requirement })
}

/// Whether an assessment names a fault of the cell.
#[must_use]
pub fn names_cell_fault(recovery: &Assessment<RecoveryOutcome>) -> bool {
    recovery.reasons.iter().any(|reason| reason.code == ReasonCode::RecoveryCellFault)
}

/// Assesses drills as [`assess_early_stop`] does, and charges to the cell those that the active version cannot do.
///
/// Such drills say nothing about the candidate. If it is incompatible only by them, or if they are too few, recovery has no
/// data, and the cell's fault is the reason.
#[must_use]
pub fn assess_drills(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
    ended: EarlyStopReason,
) -> RecoveryAssessment {
    let found = assess_early_stop(evidence, current, profile, ended);
    let is_undrillable = |kind: &DrillKind| is_undrillable(evidence, *kind, profile, ended);
    let undrillable: Vec<DrillKind> = DrillKind::ALL.into_iter().filter(is_undrillable).collect();
    let is_open = match found.assessment.outcome {
        RecoveryOutcome::Incompatible if undrillable.is_empty() => false,
        RecoveryOutcome::Incompatible => {
            let rest = without(evidence, &undrillable, profile);
            let of_rest = assess_early_stop(&rest, current, profile, ended);
            of_rest.assessment.outcome != RecoveryOutcome::Incompatible
        }
        RecoveryOutcome::NoData => {
            found.assessment.reasons.iter().any(|reason| is_shortage_of(reason, &undrillable))
        }
        RecoveryOutcome::Compatible | RecoveryOutcome::Conditional | RecoveryOutcome::Fragile => false,
    };
    if !is_open {
        return found;
    }
    let reasons = undrillable.into_iter().map(|drill| reason(Finding::ActiveUndrillable { drill }));
    let basis = found.assessment.basis;
    let assessment = Assessment::without_value(RecoveryOutcome::NoData, basis, reasons.collect());
    RecoveryAssessment { assessment, interval: None, ..found }
}

/// Whether the active version cannot do the drills of a kind: too few of them can begin, or it passes less than half of
/// the floor, and the candidate does not lean toward passing less often.
fn is_undrillable(
    evidence: &RecoveryEvidence,
    kind: DrillKind,
    profile: &Profile,
    ended: EarlyStopReason,
) -> bool {
    let (new, old) = (evidence.candidate.of(kind), evidence.active.of(kind));
    let feasible = old.feasible();
    if feasible < profile.evaluation.drills_per_kind && ended == EarlyStopReason::Full {
        // Without a single attempt the drills were left out.
        return feasible.saturating_add(old.infeasible) > 0;
    }
    feasible >= PHASE_DRILLS_MIN
        && f64::from(old.passed) / f64::from(feasible) < unusable_rate(profile)
        && !compare::is_worse(new, old, profile.recovery.lean_alpha)
}

/// Whether a reason is that one of these kinds has too few drills.
fn is_shortage_of(reason: &Reason, kinds: &[DrillKind]) -> bool {
    matches!(reason.finding, Some(Finding::TooFewDrills { drill, .. }) if kinds.contains(&drill))
}

/// The evidence with these kinds passed by both versions, so that the other kinds decide.
fn without(evidence: &RecoveryEvidence, kinds: &[DrillKind], profile: &Profile) -> RecoveryEvidence {
    let passed =
        DrillTally { passed: profile.evaluation.drills_per_kind, failed: 0, infeasible: 0, failed_alone: 0 };
    let rest_of = |drills: &DrillTallies| {
        let mut rest = *drills;
        for kind in kinds {
            *rest.of_mut(*kind) = passed;
        }
        rest
    };
    RecoveryEvidence {
        binding: evidence.binding,
        candidate: rest_of(&evidence.candidate),
        active: rest_of(&evidence.active),
        settling: evidence.settling,
    }
}
