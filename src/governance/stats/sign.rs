//! The exact sign test of paired outcomes (Dixon & Mood 1946).

use super::special::beta_cdf;

/// The probability that of all discordant pairs at least `worse` are worse by chance, if worse and better are equally
/// likely. 1 if none is worse.
#[must_use]
pub fn sign_test(worse: u64, better: u64) -> f64 {
    if worse == 0 {
        return 1.0;
    }
    // P(X >= k) of n fair draws is the incomplete beta function at one half of k and n - k + 1.
    beta_cdf(0.5, worse as f64, better as f64 + 1.0).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of binomial coefficients over powers of two.
    #[test]
    fn sign_test_is_the_binomial_tail() {
        for (worse, better, expected) in [
            (0, 0, 1.0),
            (0, 7, 1.0),
            (1, 0, 0.5),
            (4, 0, 0.062_5),
            (5, 0, 0.031_25),
            (6, 1, 8.0 / 128.0),
            (7, 1, 9.0 / 256.0),
            (9, 2, 67.0 / 2_048.0),
            (3, 3, 42.0 / 64.0),
        ] {
            let found = sign_test(worse, better);
            assert!((found - expected).abs() < 1e-12, "{worse} {better}: {found} is not {expected}");
        }
    }
}
