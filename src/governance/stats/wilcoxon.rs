//! The Wilcoxon signed-rank test (Wilcoxon 1945; Hollander & Wolfe), exact also with ties.
//!
//! Zero differences are dropped, and their number is reported: a p-value without n, zeros, ties and "exact"
//! beside it cannot be checked by its reader.

use serde::{Deserialize, Serialize};

use super::{StatsError, finite, normal_cdf};

/// Up to this many non-zero pairs the distribution is computed exactly; beyond it is approximated.
pub const EXACT_PAIRS_MAX: usize = 60;

/// The outcome of [`signed_rank`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedRank {
    /// The smaller of the two rank sums.
    pub w: f64,
    /// The sum of the ranks of positive differences.
    pub w_plus: f64,
    /// The sum of the ranks of negative differences.
    pub w_minus: f64,
    /// Pairs with a difference other than zero: the n of the test.
    pub n: usize,
    /// Pairs that were dropped because their difference is zero.
    pub zeros: usize,
    /// Non-zero pairs whose absolute difference occurs more than once.
    pub ties: usize,
    /// Whether the p-values are exact; otherwise the normal approximation with tie correction.
    pub exact: bool,
    /// Two-sided p-value of "differences are symmetric about zero".
    pub p_two_sided: f64,
    /// One-sided p-value against "differences tend to be positive".
    pub p_greater: f64,
    /// One-sided p-value against "differences tend to be negative".
    pub p_less: f64,
}

/// Tests whether paired differences are symmetric about zero.
///
/// # Errors
/// Non-finite differences, or none other than zero.
pub fn signed_rank(differences: &[f64]) -> Result<SignedRank, StatsError> {
    finite(differences, 1)?;
    let mut nonzero: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0).collect();
    let n = nonzero.len();
    if n == 0 {
        return Err(StatsError::TooFew { got: 0, needed: 1 });
    }
    nonzero.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let (ranks2, ties, tie_cubes) = doubled_midranks(&nonzero);
    let plus2: usize = ranks2.iter().zip(&nonzero).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank).sum();
    let total2 = n * (n + 1);
    let minus2 = total2 - plus2;
    let exact = n <= EXACT_PAIRS_MAX;
    let (p_less, p_greater) = if exact {
        let at_most = lower_tails(&ranks2);
        (at_most[plus2], at_most[minus2])
    } else {
        let size = n as f64;
        let centre = size * (size + 1.0) / 4.0;
        let spread = ((size * (size + 1.0) * (2.0 * size + 1.0) - tie_cubes / 2.0) / 24.0).sqrt();
        let z = (plus2 as f64 / 2.0 - centre) / spread;
        (normal_cdf(z), normal_cdf(-z))
    };
    Ok(SignedRank {
        w: plus2.min(minus2) as f64 / 2.0,
        w_plus: plus2 as f64 / 2.0,
        w_minus: minus2 as f64 / 2.0,
        n,
        zeros: differences.len() - n,
        ties,
        exact,
        p_two_sided: (2.0 * p_less.min(p_greater)).min(1.0),
        p_greater,
        p_less,
    })
}

/// Twice the mid-ranks (so that they are whole), the number of tied values, and the sum of t^3 - t.
fn doubled_midranks(sorted: &[f64]) -> (Vec<usize>, usize, f64) {
    let mut ranks2 = Vec::with_capacity(sorted.len());
    let (mut ties, mut tie_cubes) = (0, 0.0);
    for group in sorted.chunk_by(|a, b| a.abs() == b.abs()) {
        let (first, size) = (ranks2.len() + 1, group.len());
        ranks2.extend(std::iter::repeat_n(2 * first + size - 1, size));
        if size > 1 {
            ties += size;
            tie_cubes += (size as f64).powi(3) - size as f64;
        }
    }
    (ranks2, ties, tie_cubes)
}

/// `P(W2 <= w)` for each doubled rank sum w under random signs: each rank is in the sum with odds 1/2.
fn lower_tails(ranks2: &[usize]) -> Vec<f64> {
    let total: usize = ranks2.iter().sum();
    let mut odds = vec![0.0; total + 1];
    odds[0] = 1.0;
    let mut reached = 0;
    for &rank in ranks2 {
        reached += rank;
        for sum in (0..=reached).rev() {
            let with = if sum >= rank { odds[sum - rank] } else { 0.0 };
            odds[sum] = 0.5 * (odds[sum] + with);
        }
    }
    let mut cumulative = 0.0;
    for value in &mut odds {
        cumulative += *value;
        *value = f64::min(cumulative, 1.0);
    }
    odds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signed_rank_counts_zeros_and_ties() {
        let test = signed_rank(&[0.0, 1.0, -1.0, 2.0, 0.0, 3.0]).unwrap();
        assert_eq!((test.n, test.zeros, test.ties, test.exact), (4, 2, 2, true));
        assert_eq!((test.w_plus, test.w_minus, test.w), (8.5, 1.5, 1.5));
    }

    #[test]
    fn signed_rank_refuses_nan_and_empty_input() {
        assert!(signed_rank(&[]).is_err());
        assert!(signed_rank(&[0.0, 0.0]).is_err());
        assert!(signed_rank(&[1.0, f64::NAN]).is_err());
        assert!(signed_rank(&[1.0, f64::INFINITY]).is_err());
    }

    proptest::proptest! {
        #[test]
        fn signed_rank_p_values_equal_full_enumeration(differences in proptest::collection::vec(-4i8..=4, 1..11)) {
            let differences: Vec<f64> = differences.into_iter().map(f64::from).collect();
            let Ok(test) = signed_rank(&differences) else {
                proptest::prop_assert!(differences.iter().all(|d| *d == 0.0));
                return Ok(());
            };
            let mut sorted: Vec<f64> = differences.into_iter().filter(|d| *d != 0.0).collect();
            sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
            let (ranks2, _, _) = doubled_midranks(&sorted);
            let all = 1u32 << sorted.len();
            let below = (0..all).filter(|signs| {
                let sum: usize = ranks2.iter().enumerate().filter(|(i, _)| signs >> i & 1 == 1).map(|(_, r)| r).sum();
                sum as f64 / 2.0 <= test.w_plus
            }).count();
            proptest::prop_assert!((test.p_less - below as f64 / f64::from(all)).abs() < 1e-12);
        }
    }
}
