//! The drills of one kind side by side: intervals, and whether the candidate is significantly worse.
//!
//! Reports what the counts support; the rule of [`super`] gives the outcome.

use serde::{Deserialize, Serialize};

use crate::decision::Reason;
use crate::evidence::{DrillKind, DrillTallies, DrillTally, RecoveryEvidence};
use crate::finding::{DrillSide, Finding};
use crate::profile::Profile;
use crate::stats::{self, PairedCounts, SHOWN_LEVEL};

/// A pass rate with its Wilson interval at 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateInterval {
    /// Share of feasible drills passed, 0 to 1.
    pub rate: f64,
    /// Feasible drills the rate was counted over.
    pub n: u32,
    /// Lower end of the Wilson interval.
    pub lower: f64,
    /// Upper end of the Wilson interval.
    pub upper: f64,
}

/// One kind of drill, both versions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KindRates {
    /// The kind of drill the two rates are about.
    pub kind: DrillKind,
    /// How often the candidate passed.
    pub candidate: RateInterval,
    /// How often the active version passed the same drills.
    pub active: RateInterval,
    /// The candidate's rate is significantly lower at `evaluation.alpha / 4`.
    pub established_worse: bool,
    /// The candidate's rate leans toward lower, at a weaker level.
    #[serde(default)]
    pub leans_worse: bool,
}

/// The four kinds, or the first with fewer than `drills_min` feasible drills and whose they are.
pub(super) fn kinds(
    evidence: &RecoveryEvidence,
    profile: &Profile,
    drills_min: u32,
) -> Result<Vec<KindRates>, (DrillSide, DrillKind)> {
    let alpha = profile.evaluation.alpha / DrillKind::ALL.len() as f64;
    DrillKind::ALL
        .into_iter()
        .map(|kind| {
            let (new, old) = (evidence.candidate.of(kind), evidence.active.of(kind));
            let candidate = interval(new, drills_min).ok_or((DrillSide::Candidate, kind))?;
            let active = interval(old, drills_min).ok_or((DrillSide::Active, kind))?;
            let (established_worse, leans_worse) =
                (is_worse(new, old, alpha), is_worse(new, old, profile.recovery.lean_alpha));
            Ok(KindRates { kind, candidate, active, established_worse, leans_worse })
        })
        .collect()
}

/// The interval of `kappa_R`: exact bounds of all eight pass rates, each at an eighth of `evaluation.alpha`, put
/// together at their least and at their most favourable.
pub(super) fn interval_of_kappa(evidence: &RecoveryEvidence, profile: &Profile) -> Option<[f64; 2]> {
    let alpha = profile.evaluation.alpha / (2 * DrillKind::ALL.len()) as f64;
    let rho_at = |drills: &DrillTallies, bound: IntervalEnd| {
        let rates: Option<Vec<(DrillKind, f64)>> = DrillKind::ALL
            .into_iter()
            .map(|kind| {
                let tally = drills.of(kind);
                let rate = bound(u64::from(tally.passed), u64::from(tally.feasible()), alpha).ok()?;
                Some((kind, rate))
            })
            .collect();
        super::rho(&rates?, &profile.recovery)
    };
    let (lower, upper): (IntervalEnd, IntervalEnd) =
        (stats::clopper_pearson_lower, stats::clopper_pearson_upper);
    let least = super::kappa(rho_at(&evidence.active, upper)?, rho_at(&evidence.candidate, lower)?)?;
    let most = super::kappa(rho_at(&evidence.active, lower)?, rho_at(&evidence.candidate, upper)?)?;
    Some([least.get(), most.get()])
}

/// One end of an exact interval: of successes, trials and error rate.
type IntervalEnd = fn(u64, u64, f64) -> Result<f64, stats::StatsError>;

/// The reason if a kind is significantly worse or leans toward it. Leaning decides nothing: it opens a concern that
/// fresh drills settle, so that an equally good version loses its place only if it leans twice.
pub(super) fn reason(kind: &KindRates) -> Option<Reason> {
    let drill = kind.kind;
    let finding = if kind.established_worse {
        Finding::DrillsWorse { drill }
    } else if kind.leans_worse {
        Finding::DrillsLean { drill }
    } else {
        return None;
    };
    Some(super::reason(finding).with(kind.candidate.rate, kind.active.rate))
}

pub(super) fn interval(tally: &DrillTally, drills_min: u32) -> Option<RateInterval> {
    let n = tally.feasible();
    if n < drills_min.max(1) {
        return None;
    }
    let found = stats::wilson(u64::from(tally.passed), u64::from(n), SHOWN_LEVEL).ok()?;
    let rate = f64::from(tally.passed) / f64::from(n);
    Some(RateInterval { rate, n, lower: found.lower, upper: found.upper })
}

/// Whether the counts establish that the candidate fails more often, whatever pairs them.
///
/// Both versions do the same drills, but only counts are kept. With equally many drills the failures are paired so
/// that they meet as seldom as the counts allow: the net count is known, and the most discordance gives the widest
/// bound. With unequally many the two exact bounds at half the level each must not meet.
pub(super) fn is_worse(candidate: &DrillTally, active: &DrillTally, alpha: f64) -> bool {
    let (n, m) = (u64::from(candidate.feasible()), u64::from(active.feasible()));
    if n == m {
        let (worse, better) = (u64::from(candidate.failed), u64::from(active.failed));
        let both = (worse + better).saturating_sub(n);
        let counts = PairedCounts { pairs: n, candidate_only: worse - both, active_only: better - both };
        return stats::binary_pairs(counts, alpha).is_ok_and(|bound| bound.lower > 0.0);
    }
    let upper = stats::clopper_pearson_upper(u64::from(candidate.passed), n, alpha / 2.0);
    let lower = stats::clopper_pearson_lower(u64::from(active.passed), m, alpha / 2.0);
    matches!((upper, lower), (Ok(upper), Ok(lower)) if upper < lower)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::ProfileName;

    #[test]
    fn few_failures_are_inconclusive() {
        let lean_alpha = Profile::builtin(ProfileName::Sim).unwrap().recovery.lean_alpha;
        let of = |passed, failed| DrillTally { passed, failed, infeasible: 0, failed_alone: 0 };
        for (candidate, active, leans) in [
            (of(37, 3), of(40, 0), false),
            (of(36, 4), of(40, 0), true),
            // A kind that both versions often fail needs a larger difference.
            (of(28, 12), of(33, 7), false),
            (of(26, 14), of(29, 11), false),
            (of(20, 20), of(33, 7), true),
        ] {
            assert_eq!(is_worse(&candidate, &active, lean_alpha), leans, "{candidate:?} {active:?}");
        }
    }

    #[test]
    fn significant_worsening_follows_from_the_counts() {
        let of = |passed, failed| DrillTally { passed, failed, infeasible: 0, failed_alone: 0 };
        for (candidate, active, worse) in [
            (of(40, 0), of(40, 0), false),
            (of(34, 6), of(40, 0), false),
            (of(32, 8), of(40, 0), true),
            (of(32, 8), of(36, 4), false),
            (of(40, 0), of(32, 8), false),
            (of(0, 40), of(40, 0), true),
            // Every pairing of these has at least 20 pairs in common.
            (of(10, 30), of(10, 30), false),
            (of(0, 40), of(10, 30), true),
            // Unequally many.
            (of(24, 16), of(60, 0), true),
            (of(36, 4), of(60, 0), false),
        ] {
            assert_eq!(is_worse(&candidate, &active, 0.0125), worse, "{candidate:?} {active:?}");
        }
    }
}
