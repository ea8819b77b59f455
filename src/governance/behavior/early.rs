//! When a behavior evaluation may end before its budget: only ever to reject.
//!
//! Owns both rules; knows nothing of how episodes are run. Both look at the four binary components alone: what
//! time, retries and the measures of harm come to can be turned by the rest of the budget in ways no bound known in
//! advance covers, so they count as no worsening here, which is the least they can be. A component that blocks alone and
//! is established at the most favourable totals is a rejection by itself, as it is for the whole budget.

use super::{
    BehaviorAssessment, ComponentName, assess, counts, kappa, measured, order, unusable, without_value,
};
use crate::decision::ReasonCode;
use crate::early_stop::EarlyStopReason;
use crate::evidence::{EvidenceBinding, PairedEvidence};
use crate::finding::Finding;
use crate::outcome::BehaviorOutcome;
use crate::profile::Profile;
use crate::stats::population::PairBudget;
use crate::stats::{self, PairedCounts};

/// The components that are shares of episodes.
const BINARY: [ComponentName; 4] =
    [ComponentName::Success, ComponentName::Violation, ComponentName::Anomaly, ComponentName::Recovery];

/// Exact curtailment: whether the outcome is `incompatible` however the rest of the budget turns out.
///
/// Each missing pair is counted as the active version's alone in every component, which is the best it can be
/// for the candidate: a lower net count, and what is established as worse at that count is so at every other
/// outcome of the rest (the score and the exact bound both rise with candidate-only pairs and fall with
/// active-only ones). So the full budget's decision is the same, in any order of the episodes (design rule 5.3),
/// as long as the rest of the episodes are usable at all.
#[must_use]
pub fn is_lost(evidence: &PairedEvidence, current: &EvidenceBinding, profile: &Profile) -> bool {
    evidence.binding == *current
        && (!evidence.hard_stops.is_empty()
            || is_incompatible_at(evidence, profile, |seen, budget| {
                let missing = budget - seen.pairs;
                Some(PairedCounts { pairs: budget, active_only: seen.active_only + missing, ..seen })
            }))
}

/// Whether the full budget's decision would be `incompatible`, wrong with probability at most
/// `evaluation.early_alpha`. Seldom later and often far sooner than [`is_lost`].
///
/// Why the error is bounded: the pairs of the whole budget are a finite population in a random order that the
/// run's seed committed to. For each of the four binary components the confidence set of
/// [`crate::stats::population`] at `early_alpha / 4` misses the component's true totals *at some look* with
/// probability at most `early_alpha / 4` (Ville), so with probability at least `1 - early_alpha` all four sets
/// hold the true totals at every look. While they do, each component's true contribution to the loss is at least
/// `c_j` times the smallest worsening in its set, counted only if it is established at the set's most
/// favourable corner (and then at every point of the set); time and retries contribute at least 0. The full
/// budget's established `kappa_B` is therefore below the threshold whenever this bound is: a rejection that the
/// full budget would not have made needs one of the four sets to miss. The bound is on rejecting early; what the
/// full budget's own decision errs by is `evaluation.alpha`'s affair. At 0 the rule is off.
#[must_use]
pub fn is_lost_early(evidence: &PairedEvidence, current: &EvidenceBinding, profile: &Profile) -> bool {
    let alpha = profile.evaluation.early_alpha / BINARY.len() as f64;
    // Written so that a level that is no number switches the rule off.
    if evidence.binding != *current || !(alpha > 0.0 && alpha < 1.0) {
        return false;
    }
    let Ok(population) = PairBudget::new(u64::from(profile.evaluation.sandbox_pairs)) else { return false };
    is_incompatible_at(evidence, profile, |seen, budget| {
        // No net worsening so far: it counts as none, which is the least it can be, and nothing has to be computed.
        if seen.candidate_only <= seen.active_only {
            return Some(PairedCounts { pairs: budget, candidate_only: 0, active_only: 0 });
        }
        Some(population.possible(seen, alpha).ok()?.most_favorable(budget))
    })
}

/// By which rule the evaluation has ended, or `None` if more pairs are needed. What the caller records and
/// gives to [`assess_early_stop`]. Exact rules are asked first: their answer costs no error rate.
#[must_use]
pub fn end_reason(
    evidence: &PairedEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
) -> Option<EarlyStopReason> {
    if evidence.binding != *current {
        return None;
    }
    if !evidence.hard_stops.is_empty() {
        Some(EarlyStopReason::HardStop)
    } else if evidence.pairs.len() as u64 >= u64::from(profile.evaluation.sandbox_pairs) {
        Some(EarlyStopReason::Full)
    } else if is_lost(evidence, current, profile) {
        Some(EarlyStopReason::Curtailed)
    } else if is_lost_early(evidence, current, profile) {
        Some(EarlyStopReason::FinitePopulation { alpha: profile.evaluation.early_alpha })
    } else {
        None
    }
}

/// Assesses pairs of an evaluation that ended by the rule named (design rules 3.4, 5.3).
///
/// The rule is applied again to the evidence: an early end that the evidence does not bear out leaves the
/// assessment as [`assess`] makes it, which is `inconclusive` short of the budget.
#[must_use]
pub fn assess_early_stop(
    evidence: &PairedEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
    ended: EarlyStopReason,
) -> BehaviorAssessment {
    let early = match ended {
        EarlyStopReason::Full | EarlyStopReason::HardStop => false,
        EarlyStopReason::Curtailed => is_lost(evidence, current, profile),
        // The level is the profile's; one named elsewhere is no evidence.
        EarlyStopReason::FinitePopulation { alpha } => {
            alpha.to_bits() == profile.evaluation.early_alpha.to_bits()
                && is_lost_early(evidence, current, profile)
        }
    };
    let seen = evidence.pairs.len() as u64;
    let budget = u64::from(profile.evaluation.sandbox_pairs);
    if !early || !evidence.hard_stops.is_empty() || seen >= budget {
        let mut result = assess(evidence, current, profile);
        result.ended = bears_out(evidence, ended, budget).then_some(ended);
        return result;
    }
    let mut result = measured(evidence, profile).unwrap_or_else(without_value);
    // "Fewer pairs than the budget" is what the rule answers; improvements seen so far stay in the reasons.
    result.assessment.reasons.retain(|reason| reason.code != ReasonCode::BehaviorInconclusive);
    let reason = super::reason(Finding::PairsEndedEarly { rule: ended, seen, budget })
        .with(seen as f64, budget as f64);
    result.assessment.reasons.push(reason);
    result.assessment.reasons.extend(result.components.iter().filter(|c| c.is_established()).map(|c| {
        let worse = super::reason(Finding::ComponentWorseSoFar { component: c.name });
        worse.with(c.worsening, c.limit())
    }));
    order::deciding_first(&mut result.assessment.reasons, &result.components);
    result.assessment.outcome = BehaviorOutcome::Incompatible;
    result.assessment.conditions.clear();
    result.improved = false;
    result.ended = Some(ended);
    result
}

/// Whether the evidence is of an end by this rule, for the rules that end nothing early.
fn bears_out(evidence: &PairedEvidence, ended: EarlyStopReason, budget: u64) -> bool {
    match ended {
        EarlyStopReason::Full => evidence.pairs.len() as u64 >= budget,
        EarlyStopReason::HardStop => !evidence.hard_stops.is_empty(),
        EarlyStopReason::Curtailed | EarlyStopReason::FinitePopulation { .. } => false,
    }
}

/// Whether established `kappa_B` is below the threshold at the totals that `favourable` gives for the whole
/// budget from the counts seen, component by component.
fn is_incompatible_at(
    evidence: &PairedEvidence,
    profile: &Profile,
    favourable: impl Fn(PairedCounts, u64) -> Option<PairedCounts>,
) -> bool {
    let budget = u64::from(profile.evaluation.sandbox_pairs);
    let pairs = &evidence.pairs;
    if unusable(pairs).is_some() || pairs.len() as u64 > budget {
        return false;
    }
    let each = profile.evaluation.alpha / ComponentName::ALL.len() as f64;
    let mut certain = Vec::new();
    for name in BINARY {
        let Some(totals) = favourable(counts(name, pairs), budget) else { return false };
        // Nothing to establish without a net worsening.
        if totals.candidate_only > totals.active_only
            && let Ok(bound) = stats::binary_pairs(totals, each)
            && bound.lower > 0.0
        {
            certain.push((name, bound.mean));
        }
    }
    // More violations or anomalies, or a loss of success as large as the profile's, are bought by nothing.
    let success_loss_max = profile.behavior.success_loss_max;
    certain.iter().any(|(name, worsening)| name.blocks_alone_at(*worsening, success_loss_max))
        || kappa(&profile.behavior, certain).is_some_and(|value| value.get() < profile.thresholds.behavior())
}
