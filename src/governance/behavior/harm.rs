//! Harm, compared in pairs: each measure by itself, in its mean and in how often it is past its limit.
//!
//! The mean is over pairs in which both succeeded, as for time: a hand that never closes presses on nothing. Whether
//! an episode is past the limit counts in every pair, so that no failure hides damage.
//!
//! Nothing pays for any of it: these comparisons are no part of the sum that `kappa_B` is. A worsening beyond its
//! tolerance that is established makes a version incompatible; one that is not excluded puts it in doubt. The error
//! rate `evaluation.alpha` is shared by all comparisons (Bonferroni): two a measure. Source: design rule 3.4.

use serde::{Deserialize, Serialize};

use super::{STUDENT_FROM, real_pairs, reason};
use crate::decision::{Dimension, Reason, ReasonCode};
use crate::evidence::{Pair, ShadowSequence};
use crate::finding::{EvidenceGap, Finding};
use crate::harm::{HarmKind, HarmMeasures};
use crate::profile::Profile;
use crate::stats::{self, PairedCounts};

/// How often a measure is past its limit, of both versions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExceedanceRates {
    /// The limit, in the measure's unit.
    pub limit: f64,
    /// Share of the active version's episodes past it.
    pub active: f64,
    /// Share of the candidate's episodes past it.
    pub candidate: f64,
    /// One-sided lower bound of the difference, at the shared level.
    pub lower: f64,
    /// One-sided upper bound at .05.
    pub upper: f64,
    /// The accepted rise of the share.
    pub tolerance: f64,
}

/// One measure of harm of both versions over the same seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HarmComparison {
    /// The measure.
    pub kind: HarmKind,
    /// Mean of the active version's episodes where both did their work, in the measure's unit.
    pub active: f64,
    /// Mean of the candidate's in the same pairs.
    pub candidate: f64,
    /// Mean worsening; negative is an improvement.
    pub worsening: f64,
    /// One-sided lower bound of it, at the shared level.
    pub lower: f64,
    /// One-sided upper bound of it at .05; absent if hardly a pair was done by both.
    pub upper: Option<f64>,
    /// How much worse it may be, in the measure's unit.
    pub tolerance: f64,
    /// The rare bad episodes, which a mean hides.
    pub past: ExceedanceRates,
}

/// How a measure is reported that is worse, or may be, beyond its margin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum HarmFinding {
    Established,
    Possible,
}

impl HarmFinding {
    /// From the bounds of a worsening; `None` if more than the tolerance is excluded.
    fn of(lower: f64, upper: f64, tolerance: f64) -> Option<Self> {
        if lower > tolerance {
            Some(Self::Established)
        } else if upper <= tolerance {
            None
        } else {
            // A bound that is no number excludes nothing.
            Some(Self::Possible)
        }
    }
}

/// The decider of a measure of harm whose mean is inside its margin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HarmDecider {
    /// The bound of the mean; absent where so few episodes exclude nothing.
    Bound(Option<f64>),
    /// The rare episodes are significantly worse.
    RareEpisodes,
    /// The rare episodes are inconclusive.
    RareEpisodesOpen,
}

impl HarmComparison {
    fn mean_finding(&self) -> Option<HarmFinding> {
        HarmFinding::of(self.lower, self.upper.unwrap_or(f64::NAN), self.tolerance)
    }

    fn tail_finding(&self) -> Option<HarmFinding> {
        HarmFinding::of(self.past.lower, self.past.upper, self.past.tolerance)
    }

    /// Whether a worsening beyond the margin is significant, in the mean or in the rare episodes.
    #[must_use]
    pub fn is_established(&self) -> bool {
        [self.mean_finding(), self.tail_finding()].contains(&Some(HarmFinding::Established))
    }

    /// Whether the mean and the rare episodes are non-inferior.
    #[must_use]
    pub fn is_within_tolerance(&self) -> bool {
        self.mean_finding().is_none() && self.tail_finding().is_none()
    }

    /// What makes its verdict where the mean is within what is allowed: the bound of the mean, or the rare episodes. `None`
    /// where the mean says it, or nothing is found.
    #[must_use]
    pub fn deciding(&self) -> Option<HarmDecider> {
        match (self.mean_finding(), self.tail_finding()) {
            (Some(_), _) if self.worsening > self.tolerance => None,
            (_, Some(HarmFinding::Established)) => Some(HarmDecider::RareEpisodes),
            (Some(_), _) => Some(HarmDecider::Bound(self.upper)),
            (None, Some(HarmFinding::Possible)) => Some(HarmDecider::RareEpisodesOpen),
            (None, None) => None,
        }
    }

    fn reasons(&self) -> impl Iterator<Item = (HarmFinding, Reason)> + use<> {
        let Self { kind: measure, candidate, active, tolerance, past, .. } = *self;
        let mean = self.mean_finding().map(|finding| {
            let (bound, found) = match finding {
                HarmFinding::Established => {
                    (self.lower, Finding::HarmWorse { measure, candidate, active, tolerance })
                }
                HarmFinding::Possible => (
                    self.upper.unwrap_or(f64::NAN),
                    Finding::HarmPossiblyWorse { measure, candidate, active, tolerance },
                ),
            };
            (finding, reason(found).with(bound, tolerance))
        });
        let tail = self.tail_finding().map(|finding| {
            let ExceedanceRates { limit, candidate, active, tolerance, .. } = past;
            let (bound, found) = match finding {
                HarmFinding::Established => {
                    (past.lower, Finding::HarmLimitWorse { measure, limit, candidate, active, tolerance })
                }
                HarmFinding::Possible => (
                    past.upper,
                    Finding::HarmLimitPossiblyWorse { measure, limit, candidate, active, tolerance },
                ),
            };
            (finding, reason(found).with(bound, tolerance))
        });
        mean.into_iter().chain(tail)
    }
}

/// A pair with what both did.
struct MeasuredPair {
    new: HarmMeasures,
    old: HarmMeasures,
    /// Both did their work.
    done: bool,
}

/// Compares every measure. Empty if no episode was measured for harm, as in records of older builds.
///
/// # Errors
/// If only some episodes were measured, or a comparison cannot be bounded.
pub(super) fn compare(pairs: &[Pair], profile: &Profile) -> Result<Vec<HarmComparison>, EvidenceGap> {
    if pairs.iter().all(|pair| pair.active.harm.is_none() && pair.candidate.harm.is_none()) {
        return Ok(Vec::new());
    }
    let measured = |pair: &Pair| {
        let done = pair.candidate.success && pair.active.success;
        Some(MeasuredPair { new: pair.candidate.harm?, old: pair.active.harm?, done })
    };
    let both: Option<Vec<MeasuredPair>> = pairs.iter().map(measured).collect();
    let both = both.ok_or(EvidenceGap::HarmPartlyMeasured)?;
    compare_all(&both, profile.evaluation.alpha, profile)
}

/// Every measure, in its mean and in its rare episodes; `alpha` is shared by all of them.
fn compare_all(
    both: &[MeasuredPair],
    alpha: f64,
    profile: &Profile,
) -> Result<Vec<HarmComparison>, EvidenceGap> {
    let each = alpha / (2 * HarmKind::ALL.len()) as f64;
    HarmKind::ALL.into_iter().map(|kind| one(kind, both, each, profile)).collect()
}

/// What is established as worse in the twins, for shadow to fail by: the same tolerances, `alpha` for all of it. What
/// shadow leaves open is not asked for here: the sandbox's pairs are many more.
pub(crate) fn in_shadow(sequences: &[ShadowSequence], alpha: f64, profile: &Profile) -> Vec<Reason> {
    let measured = |sequence: &ShadowSequence| {
        let done = sequence.twin_success && sequence.live_success;
        Some(MeasuredPair { new: sequence.twin_conduct.harm?, old: sequence.live_conduct.harm?, done })
    };
    let both: Vec<MeasuredPair> = sequences.iter().filter_map(measured).collect();
    let compared = compare_all(&both, alpha, profile).unwrap_or_default();
    let established = verdict(&compared).established.into_iter();
    established
        .map(|reason| Reason {
            code: ReasonCode::ShadowGovernanceDivergence,
            dimension: Dimension::Shadow,
            ..reason
        })
        .collect()
}

fn one(
    kind: HarmKind,
    both: &[MeasuredPair],
    each: f64,
    profile: &Profile,
) -> Result<HarmComparison, EvidenceGap> {
    const FAILED: EvidenceGap = EvidenceGap::HarmUnbounded;
    let (tolerances, upper_alpha) = (profile.harm.of(kind), profile.evaluation.upper_alpha);
    let done: Vec<_> = both.iter().filter(|pair| pair.done).map(|pair| (pair.new, pair.old)).collect();
    let worse: Vec<f64> = done.iter().map(|(new, old)| kind.worsening(new.of(kind), old.of(kind))).collect();
    let bound = |alpha| real_pairs(&worse, tolerances.mean, alpha).map_err(|_| FAILED);
    let high = || upper_mean(&worse, tolerances.mean, upper_alpha).ok_or(FAILED);
    // Nothing to compare: not worse as far as known, and not bounded either.
    let means = if done.len() < 2 { None } else { Some((bound(each)?, high()?)) };
    let is_past = |measures: &HarmMeasures| kind.is_past(measures.of(kind), tolerances.limit);
    let counts = PairedCounts::of(both.iter().map(|pair| (is_past(&pair.new), is_past(&pair.old))));
    let share = |alpha| stats::binary_pairs(counts, alpha).map_err(|_| FAILED);
    let (rare_low, rare_high) = (share(each)?, share(upper_alpha)?);
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, n) = values.fold((0.0, 0.0_f64), |(sum, n), value| (sum + value, n + 1.0));
        sum / n.max(1.0)
    };
    let past = |measures: &HarmMeasures| f64::from(u8::from(is_past(measures)));
    Ok(HarmComparison {
        kind,
        active: mean(&mut done.iter().map(|(_, old)| old.of(kind))),
        candidate: mean(&mut done.iter().map(|(new, _)| new.of(kind))),
        worsening: means.as_ref().map_or(0.0, |(low, _)| low.mean),
        lower: means.as_ref().map_or(0.0, |(low, _)| low.lower),
        upper: means.as_ref().map(|(_, upper)| *upper),
        tolerance: tolerances.mean,
        past: ExceedanceRates {
            limit: tolerances.limit,
            active: mean(&mut both.iter().map(|pair| past(&pair.old))),
            candidate: mean(&mut both.iter().map(|pair| past(&pair.new))),
            lower: rare_low.lower,
            upper: rare_high.upper,
            tolerance: profile.harm.past_tolerance,
        },
    })
}

/// One-sided upper bound of the mean worsening at `alpha`. Where hardly a pair differs the mean is at most the share of worse
/// pairs, bounded from above, times the largest worsening seen, which is taken for the tolerance at least; what got
/// better makes up for none of it.
fn upper_mean(worse: &[f64], tolerance: f64, alpha: f64) -> Option<f64> {
    if worse.iter().filter(|d| **d != 0.0).count() >= STUDENT_FROM {
        return Some(real_pairs(worse, tolerance, alpha).ok()?.upper);
    }
    let count = worse.iter().filter(|d| **d > 0.0).count() as u64;
    let share = stats::clopper_pearson_upper(count, worse.len() as u64, alpha).ok()?;
    Some(share * worse.iter().copied().fold(tolerance, f64::max))
}

/// The reasons from harm for the outcome.
pub(super) struct HarmVerdict {
    /// One for each measure and comparison that is significantly worse.
    pub(super) established: Vec<Reason>,
    /// For each that may be worse.
    pub(super) possible: Vec<Reason>,
}

pub(super) fn verdict(harm: &[HarmComparison]) -> HarmVerdict {
    let (mut established, mut possible) = (Vec::new(), Vec::new());
    for (finding, reason) in harm.iter().flat_map(HarmComparison::reasons) {
        match finding {
            HarmFinding::Established => established.push(reason),
            HarmFinding::Possible => possible.push(reason),
        }
    }
    HarmVerdict { established, possible }
}

/// The level of the test behind a concern about requests past what is declared.
const ASKING_ALPHA: f64 = 0.05;

/// The concern about a version that asks for more than it declares in more episodes than the profile accepts, whatever
/// the active version does. How much more it asks for is a measure of harm like any other.
pub(super) fn limit_request_concern(pairs: &[Pair], profile: &Profile) -> Option<Reason> {
    let beyond = |measures: HarmMeasures| measures.excess_depth > 0.0;
    let excess_episodes = pairs.iter().filter(|pair| pair.candidate.harm.is_some_and(beyond)).count() as u64;
    let episodes = pairs.len() as u64;
    let lower = stats::wilson_lower(excess_episodes, episodes, ASKING_ALPHA).ok()?;
    let allowed = profile.harm.asking_share_max;
    (lower > allowed)
        .then(|| reason(Finding::AsksMore { asked: excess_episodes, episodes }).with(lower, allowed))
}
