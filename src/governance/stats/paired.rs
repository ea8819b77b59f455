//! One-sided bounds for the mean difference of pairs: candidate minus active version on equal seeds.
//!
//! Both ends of a [`PairedBound`] are *one-sided* bounds, each with its own error rate `alpha`.
//!
//! **Binary pairs.** Only discordant pairs count: `candidate_only` and `active_only`. The bound is the exact
//! Clopper-Pearson bound of the net count, and if both kinds occur the wider of it and Tango's score bound
//! (Statistics in Medicine 17:891, 1998). With one kind only the difference *is* one binomial proportion, for
//! which Clopper-Pearson is exact: with no discordant pair of 120 the upper 95 % bound is
//! 1 - 0.05^(1/120) = 2.47 %, not 0. The score bound alone would be too optimistic there.
//!
//! **Other pairs.** [`student_pairs`] for measured quantities with spread (time, force); [`bernstein_pairs`] for
//! quantities with a known range (retries), which stays valid for any distribution and also when all are equal.

use serde::{Deserialize, Serialize};

use super::proportion::{clopper_pearson_lower, clopper_pearson_upper};
use super::special::{bisect, normal_quantile, student_quantile};
use super::{StatsError, finite, mean, open_unit, variance};

/// Below this standard error, relative to the largest absolute value, differences count as all equal.
pub const SPREAD_MIN: f64 = 1e-12;

/// The part of `alpha` the score bound is computed at. At the full `alpha` its true error rate reaches 1.2 times
/// the stated one; at half it stays within it over all outcomes (enumerated at 20 to 300 pairs, see the tests).
const SCORE_SHARE: f64 = 0.5;

/// How a [`PairedBound`] was computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PairedMethod {
    /// Tango's score bound widened to Clopper-Pearson.
    ScoreOrExact,
    /// Student's t for the mean of differences.
    Student,
    /// The empirical Bernstein bound of Maurer and Pontil (2009).
    EmpiricalBernstein,
}

/// The mean difference of pairs with a lower and an upper one-sided bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairedBound {
    /// Mean of candidate minus active version.
    pub mean: f64,
    /// One-sided lower bound: the true mean is below it with probability at most `alpha`.
    pub lower: f64,
    /// One-sided upper bound: the true mean is above it with probability at most `alpha`.
    pub upper: f64,
    /// All pairs, those without a difference included.
    pub n: u64,
    /// Pairs that differ: the only ones that carry information on binary outcomes.
    pub discordant: u64,
    /// Error rate of each of the two bounds.
    pub alpha: f64,
    /// How it was computed.
    pub method: PairedMethod,
}

/// Counts of binary pairs. An event is what the metric counts, e.g. a violation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairedCounts {
    /// All pairs, the concordant ones included.
    pub pairs: u64,
    /// Pairs with the event in the candidate alone.
    pub candidate_only: u64,
    /// Pairs with the event in the active version alone.
    pub active_only: u64,
}

impl PairedCounts {
    /// Counts pairs of (candidate, active version).
    pub fn of(pairs: impl IntoIterator<Item = (bool, bool)>) -> Self {
        let mut counts = Self { pairs: 0, candidate_only: 0, active_only: 0 };
        for (candidate, active) in pairs {
            counts.pairs += 1;
            counts.candidate_only += u64::from(candidate && !active);
            counts.active_only += u64::from(active && !candidate);
        }
        counts
    }

    /// The same pairs seen from the other side, e.g. failures instead of successes.
    #[must_use]
    pub const fn swapped(self) -> Self {
        Self { pairs: self.pairs, candidate_only: self.active_only, active_only: self.candidate_only }
    }
}

/// Bounds the difference of two proportions over pairs, each end at `alpha`.
///
/// # Errors
/// No pairs, contradicting counts, or `alpha` outside (0, 0.5).
pub fn binary_pairs(counts: PairedCounts, alpha: f64) -> Result<PairedBound, StatsError> {
    let PairedCounts { pairs, candidate_only, active_only } = counts;
    let discordant = candidate_only.saturating_add(active_only);
    if discordant > pairs {
        return Err(StatsError::Counts { count: discordant, total: pairs });
    }
    let upper = binary_upper(pairs, candidate_only, active_only, alpha)?;
    let lower = -binary_upper(pairs, active_only, candidate_only, alpha)?;
    let mean = (candidate_only as f64 - active_only as f64) / pairs as f64;
    Ok(PairedBound { mean, lower, upper, n: pairs, discordant, alpha, method: PairedMethod::ScoreOrExact })
}

/// Bounds the mean of real differences by Student's t, each end at `alpha`.
///
/// # Errors
/// Fewer than two, non-finite or all equal differences (their spread is then unknown), or a bad `alpha`.
pub fn student_pairs(differences: &[f64], alpha: f64) -> Result<PairedBound, StatsError> {
    finite(differences, 2)?;
    let n = differences.len();
    let quantile = small_alpha(alpha).and_then(|()| {
        student_quantile(alpha, n as f64 - 1.0).ok_or(StatsError::TooFew { got: n, needed: 2 })
    })?;
    let centre = mean(differences);
    let error = (variance(differences) / n as f64).sqrt();
    let largest = differences.iter().fold(0.0, |largest: f64, d| largest.max(d.abs()));
    if error <= SPREAD_MIN * largest || largest == 0.0 {
        return Err(StatsError::NoSpread { n });
    }
    let half = -quantile * error;
    Ok(bound_around(differences, centre, half, alpha, PairedMethod::Student))
}

/// Bounds the mean of differences known to lie in `[lowest, highest]`, for any distribution, each end at `alpha`.
///
/// Empirical Bernstein (Maurer & Pontil 2009, theorem 4): with probability 1 - alpha the mean is at most
/// `m + sqrt(2 V ln(2/alpha) / n) + 7 R ln(2/alpha) / (3 (n - 1))`, V the sample variance, R the range.
///
/// # Errors
/// Fewer than two or non-finite differences, one outside the range, or a bad range or `alpha`.
pub fn bernstein_pairs(
    differences: &[f64],
    lowest: f64,
    highest: f64,
    alpha: f64,
) -> Result<PairedBound, StatsError> {
    finite(differences, 2)?;
    finite(&[lowest, highest], 2)?;
    small_alpha(alpha)?;
    if lowest >= highest {
        return Err(StatsError::Parameter { name: "highest", value: highest, allowed: "above the lowest" });
    }
    if let Some(&value) = differences.iter().find(|d| !(lowest..=highest).contains(*d)) {
        return Err(StatsError::Parameter { name: "difference", value, allowed: "within the stated range" });
    }
    let n = differences.len() as f64;
    let log = libm::log(2.0 / alpha);
    let half =
        (2.0 * variance(differences) * log / n).sqrt() + 7.0 * (highest - lowest) * log / (3.0 * (n - 1.0));
    let bound = bound_around(differences, mean(differences), half, alpha, PairedMethod::EmpiricalBernstein);
    Ok(PairedBound { lower: bound.lower.max(lowest), upper: bound.upper.min(highest), ..bound })
}

fn bound_around(differences: &[f64], mean: f64, half: f64, alpha: f64, method: PairedMethod) -> PairedBound {
    let n = differences.len() as u64;
    let discordant = differences.iter().filter(|d| **d != 0.0).count() as u64;
    PairedBound { mean, lower: mean - half, upper: mean + half, n, discordant, alpha, method }
}

fn small_alpha(alpha: f64) -> Result<(), StatsError> {
    open_unit("alpha", alpha)?;
    if alpha < 0.5 {
        Ok(())
    } else {
        Err(StatsError::Parameter { name: "alpha", value: alpha, allowed: "above 0 and below 0.5" })
    }
}

/// The upper bound of `p_worse - p_better`.
fn binary_upper(pairs: u64, worse: u64, better: u64, alpha: f64) -> Result<f64, StatsError> {
    small_alpha(alpha)?;
    // Below zero net worsening the mirrored statement is the exact one: the difference is at most minus the
    // lower bound of the net improvement.
    let exact = if worse >= better {
        clopper_pearson_upper(worse - better, pairs, alpha)?
    } else {
        -clopper_pearson_lower(better - worse, pairs, alpha)?
    };
    if better == 0 {
        return Ok(exact);
    }
    let z = -normal_quantile(SCORE_SHARE * alpha).unwrap_or(f64::NEG_INFINITY);
    let score = score_upper(pairs as f64, worse as f64, better as f64, z);
    Ok(exact.max(score))
}

/// Tango's score bound: the largest difference whose score statistic is still within `z`.
fn score_upper(n: f64, worse: f64, better: f64, z: f64) -> f64 {
    let plausible = |difference: f64| {
        // The likelihood's maximum for the rate of "better" pairs, given the difference (Tango 1998, eq. 2.7).
        let b = (2.0 * n - worse + better) * difference - worse - better;
        let c = -better * difference * (1.0 - difference);
        let rate = (((b * b - 8.0 * n * c).max(0.0)).sqrt() - b) / (4.0 * n);
        let spread = (n * (2.0 * rate.max(0.0) + difference * (1.0 - difference))).max(0.0).sqrt();
        n * difference - (worse - better) <= z * spread
    };
    bisect((worse - better) / n, 1.0, plausible)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn upper(pairs: u64, candidate_only: u64, active_only: u64) -> f64 {
        binary_pairs(PairedCounts { pairs, candidate_only, active_only }, 0.05).unwrap().upper
    }

    #[test]
    fn bound_without_discordant_pairs_is_above_zero() {
        assert!((upper(120, 0, 0) - (1.0 - 0.05f64.powf(1.0 / 120.0))).abs() < 1e-9);
        assert!((upper(300, 0, 0) - (1.0 - 0.05f64.powf(1.0 / 300.0))).abs() < 1e-9);
    }

    /// The largest chance that the upper bound misses, over a grid of rates; each chance is summed over every
    /// outcome of the trinomial, not simulated.
    fn worst_miss(pairs: u64, alpha: f64, rates: &[f64]) -> (f64, f64, f64) {
        use crate::stats::special::ln_choose;
        let outcomes: Vec<(u64, u64, f64, f64)> = (0..=pairs)
            .flat_map(|worse| (0..=pairs - worse).map(move |better| (worse, better)))
            .map(|(worse, better)| {
                let (n, w, b) = (pairs as f64, worse as f64, better as f64);
                let bound = binary_upper(pairs, worse, better, alpha).unwrap();
                (worse, better, ln_choose(n, w) + ln_choose(n - w, b), bound)
            })
            .collect();
        let ln = |rate: f64, count: u64| if count == 0 { 0.0 } else { count as f64 * rate.ln() };
        let mut worst = (0.0, 0.0, 0.0);
        for (&rate_worse, &rate_better) in rates.iter().flat_map(|w| rates.iter().map(move |b| (w, b))) {
            let rest = 1.0 - rate_worse - rate_better;
            let missed = outcomes
                .iter()
                .filter(|(_, _, _, bound)| *bound < rate_worse - rate_better)
                .map(|&(worse, better, ln_ways, _)| {
                    (ln_ways
                        + ln(rate_worse, worse)
                        + ln(rate_better, better)
                        + ln(rest, pairs - worse - better))
                    .exp()
                })
                .sum();
            if missed > worst.0 {
                worst = (missed, rate_worse, rate_better);
            }
        }
        worst
    }

    #[test]
    fn binary_bound_errs_at_most_at_alpha() {
        let rates = [0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4];
        for pairs in [20, 60, 120] {
            for alpha in [0.05, 0.05 / 6.0] {
                let (missed, worse, better) = worst_miss(pairs, alpha, &rates);
                assert!(missed <= alpha, "{pairs} pairs, alpha {alpha}: {missed} at {worse}, {better}");
            }
        }
    }

    /// What is established of one outcome is established of every outcome with more candidate-only pairs, with fewer
    /// active-only ones, and with the same net count from fewer discordant pairs. Early rejection rests on it.
    #[test]
    fn significance_is_monotone_in_the_counts() {
        for pairs in [60, 120] {
            for alpha in [0.05 / 6.0, 0.01 / 6.0] {
                let established = |candidate_only: u64, active_only: u64| {
                    binary_pairs(PairedCounts { pairs, candidate_only, active_only }, alpha).unwrap().lower
                        > 0.0
                };
                let mut found = 0;
                for active_only in 0..pairs / 2 {
                    // The smallest significant count: all larger ones are significant, too.
                    let rest = pairs - active_only;
                    let least = (0..=rest).find(|worse| established(*worse, active_only));
                    let Some(least) = least else { continue };
                    found += 1;
                    assert!(
                        (least..=rest).all(|worse| established(worse, active_only)),
                        "{least} {active_only}"
                    );
                    if active_only > 0 {
                        assert!(established(least, active_only - 1), "{least} {active_only}");
                        assert!(established(least - 1, active_only - 1), "{least} {active_only}");
                    }
                }
                assert!(found > 10, "{pairs} {alpha}");
            }
        }
    }

    #[test]
    fn paired_bounds_refuse_bad_input() {
        let counts = |pairs, candidate_only, active_only| PairedCounts { pairs, candidate_only, active_only };
        assert!(binary_pairs(counts(0, 0, 0), 0.05).is_err());
        assert!(binary_pairs(counts(3, 2, 2), 0.05).is_err());
        for alpha in [0.0, 0.5, 1.0, f64::NAN] {
            assert!(binary_pairs(counts(3, 1, 1), alpha).is_err(), "{alpha}");
            assert!(student_pairs(&[1.0, 2.0], alpha).is_err(), "{alpha}");
            assert!(bernstein_pairs(&[1.0, 2.0], 0.0, 3.0, alpha).is_err(), "{alpha}");
        }
        for bad in [&[][..], &[1.0], &[1.0, f64::NAN], &[2.0, 2.0], &[0.0, 0.0]] {
            assert!(student_pairs(bad, 0.05).is_err(), "{bad:?}");
        }
        assert!(bernstein_pairs(&[1.0, 5.0], 0.0, 3.0, 0.05).is_err());
        assert!(bernstein_pairs(&[1.0, 2.0], 3.0, 0.0, 0.05).is_err());
        assert!(bernstein_pairs(&[1.0, f64::NAN], 0.0, 3.0, 0.05).is_err());
        // Equal values are no proof that the mean is known.
        let bound = bernstein_pairs(&[0.0; 300], -3.0, 3.0, 0.05).unwrap();
        assert!(bound.upper > 0.1 && bound.upper < 0.2, "{bound:?}");
    }

    proptest::proptest! {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
        #[test]
        fn binary_bounds_hold_the_mean_and_narrow(n in 4u64..300, w in 0.0..0.5f64, b in 0.0..0.5f64) {
            let counts = PairedCounts {
                pairs: n, candidate_only: (w * n as f64) as u64, active_only: (b * n as f64) as u64,
            };
            let bound = binary_pairs(counts, 0.05).unwrap();
            proptest::prop_assert!(bound.lower <= bound.mean && bound.mean <= bound.upper);
            proptest::prop_assert!(bound.lower >= -1.0 && bound.upper <= 1.0);
            let mirrored = binary_pairs(counts.swapped(), 0.05).unwrap();
            proptest::prop_assert_eq!(mirrored.upper, -bound.lower);
            let four = PairedCounts {
                pairs: 4 * n, candidate_only: 4 * counts.candidate_only, active_only: 4 * counts.active_only,
            };
            let larger = binary_pairs(four, 0.05).unwrap();
            proptest::prop_assert!(larger.upper - larger.lower < bound.upper - bound.lower);
            let stricter = binary_pairs(counts, 0.01).unwrap();
            proptest::prop_assert!(stricter.upper >= bound.upper && stricter.lower <= bound.lower);
        }

        #[test]
        fn real_bounds_hold_the_mean(values in proptest::collection::vec(-1.0..1.0f64, 3..60)) {
            let wide = bernstein_pairs(&values, -1.0, 1.0, 0.05).unwrap();
            proptest::prop_assert!(wide.lower <= wide.mean && wide.mean <= wide.upper);
            if let Ok(bound) = student_pairs(&values, 0.05) {
                proptest::prop_assert!(bound.lower < bound.mean && bound.mean < bound.upper);
            }
        }
    }
}
