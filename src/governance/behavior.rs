//! `kappa_B`: does the candidate behave worse than the active version, on the same seeds?
//!
//! One-sided: only worsening counts, improvement is reported apart. One analysis at the fixed budget.
//! Source: paper section 4.3, Table 3; design rule 3.4; readings 2.2, X76.

use serde::{Deserialize, Serialize};

mod anchor;
mod component;
mod counted;
mod early;
mod harm;
mod live_like;
mod order;
mod sequences;

pub(crate) use anchor::require_anchor;
pub use anchor::{AnchorComparison, apply_anchor};
pub use component::{BehaviorComponent, ComponentName, component_of};
pub(crate) use counted::apply_try;
pub use counted::without_try;
pub use early::{assess_early_stop, end_reason, is_lost, is_lost_early};
pub(crate) use harm::in_shadow;
pub use harm::{ExceedanceRates, HarmComparison, HarmDecider};
pub(crate) use live_like::apply_live_like;
pub use live_like::{LiveLikeComparison, live_like_pairs};
pub use sequences::{
    SequenceComparison, SequenceEvidence, SequenceMeasure, SequencePair, SequenceStep, apply_sequences,
};

use self::harm::HarmVerdict;
use super::condition::Condition;
use super::decision::{Dimension, Kappa, Reason, ReasonCode};
use super::early_stop::EarlyStopReason;
use super::evidence::{EpisodeValues, EvidenceBinding, HardStop, Pair, PairedEvidence, Signature};
use super::finding::{EvidenceGap, Finding};
use super::outcome::{Assessment, Basis, BehaviorOutcome};
use super::profile::{BehaviorSettings, Profile};
use super::worst_case_search::SearchFinding;
use crate::stats::{self, PairedBound, PairedCounts};

/// Non-zero differences from which Student's t is used for retries; below, a bound valid for any distribution.
const STUDENT_FROM: usize = 20;

/// `kappa_B` with everything it was made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BehaviorAssessment {
    /// Outcome, value and reasons.
    pub assessment: Assessment<BehaviorOutcome>,
    /// `kappa_B` counting significant worsenings only.
    pub established: Option<Kappa>,
    /// Interval of the true `kappa_B`, each end at error rate `evaluation.alpha`; from 0 if a component is unbounded.
    #[serde(default)]
    pub interval: Option<[f64; 2]>,
    /// The six components; empty without data.
    pub components: Vec<BehaviorComponent>,
    /// Every measure of harm; empty without data, and in records of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub harm: Vec<HarmComparison>,
    /// Every comparison of whole sequences; empty if none ran, and in records of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sequences: Vec<SequenceComparison>,
    /// The live-like pairs by themselves; absent if there is none, and in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live_like: Option<LiveLikeComparison>,
    /// The comparison with the family's anchor; absent if that is the active version, and in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<AnchorComparison>,
    /// Mean values of the active version; absent without usable episodes.
    pub active: Option<Signature>,
    /// Mean values of the candidate; absent without usable episodes.
    pub candidate: Option<Signature>,
    /// Whether the success rate is significantly higher than the active version's.
    pub improved: bool,
    /// Episode pairs the assessment rests on; 0 for an estimate or without data.
    pub pairs: u32,
    /// The rule that ended the evaluation, if it was named and the evidence confirms it.
    #[serde(default)]
    pub ended: Option<EarlyStopReason>,
}

/// `kappa_B = clamp(1 - sum_j c_j max(0, worsening_j))` over (component, worsening) values.
#[must_use]
pub fn kappa(
    settings: &BehaviorSettings,
    worsenings: impl IntoIterator<Item = (ComponentName, f64)>,
) -> Option<Kappa> {
    let mut loss = 0.0;
    for (name, worsening) in worsenings {
        if !worsening.is_finite() {
            return None;
        }
        loss += name.cost(settings) * worsening.max(0.0);
    }
    Kappa::clamped(1.0 - loss)
}

/// Adds a concern to a compatible version that had a hard stop in a scene without a valid episode of the other version. It
/// rejects nothing: that the other version does otherwise is not shown.
pub fn add_uncompared_concern(result: &mut BehaviorAssessment, stops: &[HardStop], profile: &Profile) {
    if let Some(stop) = stops.first()
        && result.assessment.outcome == BehaviorOutcome::Compatible
    {
        add_concern(result, reason(Finding::StopUncompared { stop: *stop }), profile);
    }
}

/// Adds a concern to a compatible version that was unsafe under stress (paper section 6.6). It rejects nothing.
pub fn add_stress_concern(
    result: &mut BehaviorAssessment,
    unsafe_episodes: u32,
    episodes: u64,
    profile: &Profile,
) {
    let share = f64::from(unsafe_episodes) / (episodes.max(1) as f64);
    let share_max = profile.evaluation.stress_share_max;
    if share <= share_max || result.assessment.outcome != BehaviorOutcome::Compatible {
        return;
    }
    let concern = reason(Finding::UnsafeUnderStress { unsafe_episodes, episodes });
    add_concern(result, concern.with(share, share_max), profile);
}

/// Adds a concern to a compatible version that passes a limit at a place in the envelope where the active one does not.
pub fn add_search_concern(
    result: &mut BehaviorAssessment,
    searched: Option<&SearchFinding>,
    profile: &Profile,
) {
    if result.assessment.outcome != BehaviorOutcome::Compatible {
        return;
    }
    if let Some(doubt) = searched.and_then(|searched| searched.concern(profile)) {
        add_concern(result, doubt, profile);
    }
}

fn add_concern(result: &mut BehaviorAssessment, concern: Reason, profile: &Profile) {
    overrule(result, BehaviorOutcome::Suspicious, [concern]);
    result.assessment.conditions = concern_conditions(profile);
}

/// Gives an assessment this outcome for these reasons, which stand first; none says any more that it is compatible.
fn overrule(
    result: &mut BehaviorAssessment,
    outcome: BehaviorOutcome,
    why: impl IntoIterator<Item = Reason>,
) {
    let assessment = &mut result.assessment;
    assessment.outcome = outcome;
    assessment.conditions.clear();
    assessment.reasons.retain(|reason| reason.code != ReasonCode::BehaviorCompatible);
    assessment.reasons.splice(0..0, why);
}

/// What another comparison found, as a finding about it with the same numbers.
fn within(found: &Reason, finding: impl FnOnce(Box<Finding>) -> Finding) -> Option<Reason> {
    let by = Box::new(found.finding.clone()?);
    let (evidence, limit) = (found.evidence.unwrap_or(f64::NAN), found.limit.unwrap_or(f64::NAN));
    Some(reason(finding(by)).with(evidence, limit))
}

/// Conditions under which an inconclusive version may continue.
fn concern_conditions(profile: &Profile) -> Vec<Condition> {
    vec![
        Condition::StricterThresholds { factor: profile.behavior.concern_factor },
        Condition::ShadowFirst { sequences: profile.evaluation.shadow_sequences_max },
        Condition::RollbackCoupled,
    ]
}

/// Means of episodes; `None` without episodes or with non-finite values.
#[must_use]
pub fn signature<'a>(episodes: impl Iterator<Item = &'a EpisodeValues> + Clone) -> Option<Signature> {
    if episodes.clone().any(|episode| !episode.is_valid()) {
        return None;
    }
    let mean = |value: &dyn Fn(&EpisodeValues) -> f64| {
        let (sum, count) = episodes.clone().fold((0.0, 0.0), |(sum, n), e| (sum + value(e), n + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    let share = |flag: &dyn Fn(&EpisodeValues) -> bool| mean(&|e| if flag(e) { 1.0 } else { 0.0 });
    Some(Signature {
        success: share(&|e| e.success)?,
        time_s: mean(&|e| e.time_s)?,
        retry: mean(&|e| f64::from(e.retries))?,
        violation: share(&|e| e.violation)?,
        anomaly: share(&|e| e.anomaly)?,
        recovery: share(&|e| e.recovery)?,
        intervention: share(&|e| e.intervention)?,
        timeout: share(&|e| e.timeout)?,
        policy_warning: share(&|e| e.policy_warning)?,
        near_limit: share(&|e| e.near_violation)?,
        time_p95_s: time_p95_s(episodes)?,
    })
}

/// The shortest of the times that at most one episode in twenty exceeds, s; `None` without episodes.
fn time_p95_s<'a>(episodes: impl Iterator<Item = &'a EpisodeValues>) -> Option<f64> {
    let mut times: Vec<f64> = episodes.map(|episode| episode.time_s).collect();
    let rank = times.len() - times.len() / 20;
    let at = rank.checked_sub(1)?;
    times.select_nth_unstable_by(at, f64::total_cmp);
    times.get(at).copied()
}

/// Assesses measured pairs (design rule 3.4). `current` is what evidence has to be bound to now.
#[must_use]
pub fn assess(evidence: &PairedEvidence, current: &EvidenceBinding, profile: &Profile) -> BehaviorAssessment {
    if evidence.binding != *current {
        return without_value(EvidenceGap::OtherBinding);
    }
    if let Some(stop) = evidence.hard_stops.first() {
        let reason = reason(Finding::SandboxHardStop { stop: *stop });
        let mut result =
            measured(evidence, profile).unwrap_or_else(|_| without_value(EvidenceGap::NoEpisodes));
        result.assessment.outcome = BehaviorOutcome::Incompatible;
        result.assessment.reasons.insert(0, reason);
        result.assessment.conditions.clear();
        return result;
    }
    if let Some(problem) = unusable(&evidence.pairs) {
        return without_value(problem);
    }
    measured(evidence, profile).unwrap_or_else(without_value)
}

/// The estimate that stage 2 may carry, from declared or earlier traces; no gate uses it.
#[must_use]
pub fn estimate(candidate: &Signature, active: &Signature, profile: &Profile) -> BehaviorAssessment {
    if !candidate.is_valid() || !active.is_valid() {
        return without_value(EvidenceGap::TracesNotFinite);
    }
    let relative = |new: f64, old: f64| if old > 0.0 { new / old - 1.0 } else { new };
    let worsenings = [
        (ComponentName::Success, active.success - candidate.success),
        (ComponentName::Time, relative(candidate.time_s, active.time_s)),
        (ComponentName::Retry, candidate.retry - active.retry),
        (ComponentName::Violation, candidate.violation - active.violation),
        (ComponentName::Anomaly, candidate.anomaly - active.anomaly),
        (ComponentName::Recovery, candidate.recovery - active.recovery),
    ];
    let threshold = profile.thresholds.behavior();
    let Some(value) = kappa(&profile.behavior, worsenings) else {
        return without_value(EvidenceGap::TracesNotFinite);
    };
    let outcome =
        if value.get() < threshold { BehaviorOutcome::Incompatible } else { BehaviorOutcome::Suspicious };
    let reason = reason(Finding::Estimated).with(value.get(), threshold);
    let assessment = Assessment {
        kappa: Some(value),
        ..Assessment::without_value(outcome, Basis::Estimated, vec![reason])
    };
    BehaviorAssessment {
        active: Some(*active),
        candidate: Some(*candidate),
        ..without_measurements(assessment)
    }
}

/// An assessment without a value: nothing advances on it.
#[must_use]
pub fn without_value(gap: EvidenceGap) -> BehaviorAssessment {
    let reasons = vec![reason(Finding::BehaviorGap { gap })];
    without_measurements(Assessment::without_value(BehaviorOutcome::NoData, Basis::Measured, reasons))
}

const fn without_measurements(assessment: Assessment<BehaviorOutcome>) -> BehaviorAssessment {
    BehaviorAssessment {
        assessment,
        established: None,
        interval: None,
        components: Vec::new(),
        harm: Vec::new(),
        sequences: Vec::new(),
        live_like: None,
        anchor: None,
        active: None,
        candidate: None,
        improved: false,
        pairs: 0,
        ended: None,
    }
}

/// Whether an assessment rejects nothing yet, so that further comparisons count.
const fn is_open(result: &BehaviorAssessment) -> bool {
    matches!(result.assessment.outcome, BehaviorOutcome::Compatible | BehaviorOutcome::Suspicious)
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Behavior, finding)
}

fn unusable(pairs: &[Pair]) -> Option<EvidenceGap> {
    let mut seeds = std::collections::BTreeSet::new();
    if pairs.len() < 2 {
        Some(EvidenceGap::NoEpisodes)
    } else if !pairs.iter().all(|pair| pair.active.is_valid() && pair.candidate.is_valid()) {
        Some(EvidenceGap::Implausible)
    } else if !pairs.iter().all(|pair| seeds.insert(pair.seed)) {
        Some(EvidenceGap::RepeatedSeed)
    } else {
        None
    }
}

fn measured(evidence: &PairedEvidence, profile: &Profile) -> Result<BehaviorAssessment, EvidenceGap> {
    measured_within(evidence, profile.evaluation.sandbox_pairs, profile)
}

/// `budget`: the number of pairs from which the rules conclude.
fn measured_within(
    evidence: &PairedEvidence,
    budget: u32,
    profile: &Profile,
) -> Result<BehaviorAssessment, EvidenceGap> {
    let pairs = &evidence.pairs;
    if let Some(problem) = unusable(pairs) {
        return Err(problem);
    }
    let each = profile.evaluation.alpha / 6.0;
    let mut components = Vec::new();
    let (mut least_loss, mut most_loss) = (0.0, 0.0);
    for name in ComponentName::ALL {
        let cost = name.cost(&profile.behavior);
        let (component, shared_upper) = component(name, pairs, each, profile)?;
        least_loss += cost * component.lower.max(0.0);
        most_loss += shared_upper.map_or(f64::INFINITY, |upper| cost * upper.max(0.0));
        components.push(component);
    }
    let ends = [1.0 - most_loss, 1.0 - least_loss].map(|end| end.clamp(0.0, 1.0));
    let value = kappa(&profile.behavior, components.iter().map(|c| (c.name, c.worsening)));
    let counted = components.iter().filter(|c| c.is_established()).map(|c| (c.name, c.worsening));
    let established = kappa(&profile.behavior, counted);
    let (Some(value), Some(established)) = (value, established) else {
        return Err(EvidenceGap::WorseningNotFinite);
    };
    let gained = PairedCounts::of(pairs.iter().map(|pair| (pair.candidate.success, pair.active.success)));
    let success = stats::binary_pairs(gained, each).map_err(|_| EvidenceGap::SuccessUnbounded)?;
    let assessment = Assessment {
        kappa: Some(value),
        ..Assessment::without_value(BehaviorOutcome::Compatible, Basis::Measured, Vec::new())
    };
    let mut result = BehaviorAssessment {
        established: Some(established),
        interval: Some(ends),
        active: signature(pairs.iter().map(|pair| &pair.active)),
        candidate: signature(pairs.iter().map(|pair| &pair.candidate)),
        improved: success.lower > 0.0,
        pairs: u32::try_from(pairs.len()).unwrap_or(u32::MAX),
        components,
        harm: harm::compare(pairs, profile)?,
        ..without_measurements(assessment)
    };
    let excess_concern = harm::limit_request_concern(pairs, profile);
    conclude_behavior(&mut result, budget, success.mean > 0.0, excess_concern, profile);
    Ok(result)
}

/// `excess_concern`: the concern about a version that requests more than its limits permit.
fn conclude_behavior(
    result: &mut BehaviorAssessment,
    budget: u32,
    success_rose: bool,
    excess_concern: Option<Reason>,
    profile: &Profile,
) {
    let threshold = profile.thresholds.behavior();
    let value = result.assessment.kappa.map_or(f64::NAN, Kappa::get);
    let established = result.established.map_or(f64::NAN, Kappa::get);
    let mut reasons = Vec::new();
    let traded =
        result.components.iter().find(|c| c.name.is_safety() && c.is_established()).filter(|_| success_rose);
    let HarmVerdict { established: harmful, possible } = harm::verdict(&result.harm);
    // Within its margin, more recovery counts against a version only if success rose with it.
    let blocked = traded.is_some() || result.components.iter().any(BehaviorComponent::decides_alone);
    let outcome = if result.pairs < budget {
        reasons.push(reason(Finding::TooFewPairs).with(f64::from(result.pairs), f64::from(budget)));
        BehaviorOutcome::Inconclusive
    } else if established < threshold || blocked || !harmful.is_empty() {
        for c in result.components.iter().filter(|c| c.is_established()) {
            reasons.push(reason(Finding::ComponentWorse { component: c.name }).with(c.worsening, c.limit()));
        }
        reasons.extend(harmful);
        BehaviorOutcome::Incompatible
    } else {
        let open: Vec<&BehaviorComponent> =
            result.components.iter().filter(|c| !c.is_within_tolerance()).collect();
        for c in &open {
            let upper = c.upper.unwrap_or(f64::NAN);
            reasons
                .push(reason(Finding::ComponentPossiblyWorse { component: c.name }).with(upper, c.tolerance));
        }
        let settled = open.is_empty() && possible.is_empty();
        reasons.extend(possible);
        // Written so that NaN is inconclusive.
        if value >= threshold && settled {
            reasons.push(reason(Finding::BehaviorCompatible).with(value, threshold));
            BehaviorOutcome::Compatible
        } else {
            if reasons.is_empty() {
                reasons.push(reason(Finding::WorseningsAddUp).with(value, threshold));
            }
            BehaviorOutcome::Suspicious
        }
    };
    if let Some(c) = traded {
        reasons.push(reason(Finding::SafetyTraded { component: c.name }).with(c.worsening, 0.0));
    }
    reasons.extend(excess_concern);
    for c in result.components.iter().filter(|c| c.worsening < 0.0) {
        reasons.push(reason(Finding::ComponentBetter { component: c.name }).with(-c.worsening, 0.0));
    }
    if outcome == BehaviorOutcome::Suspicious {
        result.assessment.conditions = concern_conditions(profile);
    }
    result.assessment.outcome = outcome;
    result.assessment.reasons = reasons;
    order::deciding_first(&mut result.assessment.reasons, &result.components);
}

/// The pairs as a component that is a share of episodes counts them.
fn counts(name: ComponentName, pairs: &[Pair]) -> PairedCounts {
    PairedCounts::of(pairs.iter().filter_map(|pair| name.is_bad_in(pair)))
}

/// The component, and the upper bound that shares the error rate with the other five.
fn component(
    name: ComponentName,
    pairs: &[Pair],
    each: f64,
    profile: &Profile,
) -> Result<(BehaviorComponent, Option<f64>), EvidenceGap> {
    let tolerance = (1.0 - profile.thresholds.behavior()) / name.cost(&profile.behavior);
    let success_loss_max = profile.behavior.success_loss_max;
    let upper_alpha = profile.evaluation.upper_alpha;
    let both = |bound: &dyn Fn(f64) -> Result<PairedBound, stats::StatsError>| {
        let failed = EvidenceGap::ComponentUnbounded;
        Ok::<_, EvidenceGap>((bound(each).map_err(|_| failed)?, bound(upper_alpha).map_err(|_| failed)?))
    };
    let (low, high) = match name {
        ComponentName::Success
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => both(&|alpha| stats::binary_pairs(counts(name, pairs), alpha))?,
        ComponentName::Retry => {
            let more = |pair: &Pair| f64::from(pair.candidate.retries) - f64::from(pair.active.retries);
            let differences: Vec<f64> = pairs.iter().map(more).collect();
            both(&|alpha| real_pairs(&differences, 1.0, alpha))?
        }
        ComponentName::Time => {
            let done = pairs.iter().filter(|pair| name.is_compared_in(pair));
            let longer: Vec<f64> = done
                .filter(|pair| pair.active.time_s > 0.0)
                .map(|pair| pair.candidate.time_s / pair.active.time_s - 1.0)
                .collect();
            if longer.len() < 2 {
                // Nothing to compare: not worse as far as known, and not bounded either.
                let unbounded = BehaviorComponent {
                    name,
                    worsening: 0.0,
                    lower: 0.0,
                    upper: None,
                    tolerance,
                    success_loss_max,
                    upper_alpha,
                };
                return Ok((unbounded, None));
            }
            both(&|alpha| real_pairs(&longer, 1.0, alpha))?
        }
    };
    let (worsening, lower, upper) = (low.mean, low.lower, Some(high.upper));
    let found = BehaviorComponent { name, worsening, lower, upper, tolerance, success_loss_max, upper_alpha };
    Ok((found, Some(low.upper)))
}

/// Student's t if enough pairs differ, otherwise a bound that holds for any distribution on the range seen, which is
/// taken for `range_min` at least to either side.
fn real_pairs(differences: &[f64], range_min: f64, alpha: f64) -> Result<PairedBound, stats::StatsError> {
    let differing = differences.iter().filter(|d| **d != 0.0).count();
    if differing >= STUDENT_FROM
        && let Ok(bound) = stats::student_pairs(differences, alpha)
    {
        return Ok(bound);
    }
    let largest = differences.iter().fold(range_min, |largest, d| largest.max(d.abs()));
    stats::bernstein_pairs(differences, -largest, largest, alpha)
}
