//! When drills may end before their budget: only ever to reject.
//!
//! Owns both rules; knows nothing of how drills are done. Both let the active version's missing drills all fail:
//! the lower its `rho`, the better the candidate looks beside it.

use super::{RecoveryAssessment, assess, compare, kappa, kinds, recovery_outcome, rho};
use crate::decision::Reason;
use crate::early_stop::EarlyStopReason;
use crate::evidence::{DrillKind, DrillTallies, DrillTally, EvidenceBinding, RecoveryEvidence};
use crate::finding::Finding;
use crate::outcome::{Assessment, Basis, RecoveryOutcome};
use crate::profile::Profile;
use crate::stats::population::RunBudget;

/// Exact curtailment: whether the outcome is `incompatible` even if every missing drill of the candidate
/// passes and every missing one of the active version fails.
///
/// Each condition of `incompatible` gets only harder to meet as the candidate's pass rates rise and the active
/// version's fall, so the full budget's decision is the same, as long as the rest of the drills are feasible. What
/// single phases say at the end can only add to it.
#[must_use]
pub fn is_lost(evidence: &RecoveryEvidence, current: &EvidenceBinding, profile: &Profile) -> bool {
    is_incompatible_at(evidence, current, profile, |tally, budget| {
        Some(budget - u64::from(tally.failed).min(budget))
    })
    .is_some()
}

/// Whether the full budget's decision would be `incompatible`, wrong with probability at most
/// `evaluation.early_alpha`.
///
/// The drills of one kind are a finite population in a random order that the run's seed committed to. The
/// confidence set for the candidate's passes of each of the four kinds ([`crate::stats::population`], at
/// `early_alpha / 4`) misses the true count at some look with probability at most `early_alpha / 4` (Ville), so
/// with probability at least `1 - early_alpha` no kind passes more often in the full budget than the largest count
/// in its set, at any look. The active version's drills take no part in the error: their missing ones are counted
/// as failed. What is incompatible at those counts is so at the true ones. At 0 the rule is off.
#[must_use]
pub fn is_lost_early(evidence: &RecoveryEvidence, current: &EvidenceBinding, profile: &Profile) -> bool {
    lost_early(evidence, current, profile).is_some()
}

fn lost_early(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
) -> Option<Vec<Reason>> {
    let alpha = profile.evaluation.early_alpha / DrillKind::ALL.len() as f64;
    // Written so that a level that is no number switches the rule off.
    if !(alpha > 0.0 && alpha < 1.0) {
        return None;
    }
    let population = RunBudget::new(u64::from(profile.evaluation.drills_per_kind)).ok()?;
    is_incompatible_at(evidence, current, profile, |tally, _| {
        let seen = u64::from(tally.feasible());
        population.passes(u64::from(tally.passed), seen, alpha).ok().map(|(_, most)| most)
    })
}

/// By which rule the drills have ended, or `None` if more are needed. What the caller records and gives to
/// [`assess_early_stop`]. Exact rules are asked first: their answer costs no error rate.
#[must_use]
pub fn end_reason(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
) -> Option<EarlyStopReason> {
    if evidence.binding != *current {
        return None;
    }
    let budget = profile.evaluation.drills_per_kind;
    let all = [&evidence.candidate, &evidence.active];
    let full = all.iter().all(|drills| DrillKind::ALL.into_iter().all(|k| drills.of(k).feasible() >= budget));
    if full {
        Some(EarlyStopReason::Full)
    } else if is_lost(evidence, current, profile) {
        Some(EarlyStopReason::Curtailed)
    } else if is_lost_early(evidence, current, profile) {
        Some(EarlyStopReason::FinitePopulation { alpha: profile.evaluation.early_alpha })
    } else {
        None
    }
}

/// Assesses drills that ended by the rule named (design rules 3.5, 5.3).
///
/// The rule is applied again to the evidence: an early end that the evidence does not bear out leaves the
/// assessment as [`assess`] makes it, which is `no data` short of the budget. A value of `kappa_R` is given only
/// if every kind has drills of both versions.
#[must_use]
pub fn assess_early_stop(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
    ended: EarlyStopReason,
) -> RecoveryAssessment {
    let drills_min = profile.evaluation.drills_per_kind;
    let full = kinds(evidence, profile, drills_min).is_ok();
    let blocking = match ended {
        _ if full => None,
        EarlyStopReason::Full | EarlyStopReason::HardStop => None,
        EarlyStopReason::Curtailed => is_incompatible_at(evidence, current, profile, |tally, budget| {
            Some(budget - u64::from(tally.failed).min(budget))
        }),
        // The level is the profile's; one named elsewhere is no evidence.
        EarlyStopReason::FinitePopulation { alpha } => (alpha.to_bits()
            == profile.evaluation.early_alpha.to_bits())
        .then(|| lost_early(evidence, current, profile))
        .flatten(),
    };
    let Some(mut reasons) = blocking else {
        let mut result = assess(evidence, current, profile);
        result.ended = (ended == EarlyStopReason::Full && full).then_some(ended);
        return result;
    };
    let each = u64::from(drills_min);
    let seen: u64 =
        DrillKind::ALL.iter().map(|kind| u64::from(evidence.candidate.of(*kind).feasible())).sum();
    let budget = each * DrillKind::ALL.len() as u64;
    let reason = super::reason(Finding::DrillsEndedEarly { rule: ended, seen, budget })
        .with(seen as f64, budget as f64);
    reasons.insert(0, reason);
    let kinds = kinds(evidence, profile, 1).unwrap_or_default();
    reasons.extend(kinds.iter().filter_map(compare::reason));
    let of = |side: fn(&compare::KindRates) -> f64| {
        rho(&kinds.iter().map(|kind| (kind.kind, side(kind))).collect::<Vec<_>>(), &profile.recovery)
    };
    let (new, old) = (of(|kind| kind.candidate.rate), of(|kind| kind.active.rate));
    RecoveryAssessment {
        assessment: Assessment {
            outcome: RecoveryOutcome::Incompatible,
            kappa: old.zip(new).and_then(|(old, new)| kappa(old, new)),
            basis: Basis::Measured,
            reasons,
            conditions: Vec::new(),
        },
        rho_candidate: new,
        rho_active: old,
        interval: compare::interval_of_kappa(evidence, profile),
        rates: kinds.iter().map(|kind| (kind.kind, kind.candidate.rate)).collect(),
        kinds,
        phases: super::phases::phases(evidence, profile),
        settled: Vec::new(),
        ended: Some(ended),
    }
}

/// Why the outcome is `incompatible` at the passes that `most_passed` gives for the candidate's whole budget, kind
/// by kind, against an active version whose missing drills all fail; `None` if it is not.
fn is_incompatible_at(
    evidence: &RecoveryEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
    most_passed: impl Fn(&DrillTally, u64) -> Option<u64>,
) -> Option<Vec<Reason>> {
    if evidence.binding != *current {
        return None;
    }
    let budget = u64::from(profile.evaluation.drills_per_kind);
    let rates = |drills: &DrillTallies, passed: &dyn Fn(&DrillTally) -> Option<u64>| {
        let rate = |kind: DrillKind| {
            let tally = drills.of(kind);
            // With more drills than the budget the rate is over those.
            let whole = budget.max(u64::from(tally.feasible()));
            Some((kind, passed(tally)? as f64 / whole as f64))
        };
        DrillKind::ALL.into_iter().map(rate).collect::<Option<Vec<_>>>()
    };
    let over = |tally: &DrillTally| u64::from(tally.feasible()) >= budget;
    let best = rates(&evidence.candidate, &|tally| {
        if over(tally) { Some(u64::from(tally.passed)) } else { most_passed(tally, budget) }
    })?;
    let worst = rates(&evidence.active, &|tally| Some(u64::from(tally.passed)))?;
    let (new, old) = (rho(&best, &profile.recovery)?, rho(&worst, &profile.recovery)?);
    let (outcome, reasons) = recovery_outcome(&best, new, old, kappa(old, new)?, profile);
    (outcome == RecoveryOutcome::Incompatible).then_some(reasons)
}
