//! The number of cached results of a block to re-run, so that an edited share is detected.
//!
//! Sampling without replacement, exactly (hypergeometric): at least `edited` of `cached` results are false. `n` are
//! sampled, each set of `n` as likely as any other. `1 - C(cached - edited, n) / C(cached, n)` is the chance that the
//! sample has a false one. Fewer edits are found less often: [`detection_probability`] gives the chance.

/// The edited share that a spot check is designed for: one in twenty, rounded up to whole results.
pub const EDITED_ONE_IN: u32 = 20;

/// The chance that a spot check detects that share.
pub const SPOT_CHECK_POWER: f64 = 0.95;

/// Tolerance against rounding, so that a rounding error does not add a result to the sample.
const ROUNDING_TOLERANCE: f64 = 1e-12;

/// The least number of edited results that a spot check of `cached` results is designed for.
#[must_use]
pub const fn assumed_edits(cached: u32) -> u32 {
    cached.div_ceil(EDITED_ONE_IN)
}

/// The chance that a sample of `sampled` results has one of the `edited` false ones among `cached`.
#[must_use]
pub fn detection_probability(cached: u32, edited: u32, sampled: u32) -> f64 {
    let sampled = sampled.min(cached);
    let Some(unedited) = cached.checked_sub(edited) else { return 1.0 };
    if sampled > unedited {
        return 1.0;
    }
    let missed: f64 =
        (0..sampled).map(|turn| f64::from(unedited - turn) / f64::from(cached - turn)).product();
    1.0 - missed
}

/// Sample size among `cached` results for [`SPOT_CHECK_POWER`]: 59 of very many, 54 of 300, 19 of 20, all of fewer.
#[must_use]
pub fn spot_check(cached: u32) -> u32 {
    let is_enough = |sampled: &u32| {
        detection_probability(cached, assumed_edits(cached), *sampled)
            >= SPOT_CHECK_POWER - ROUNDING_TOLERANCE
    };
    // With replacement 59 are enough, so they are without it.
    (0..=cached).find(is_enough).unwrap_or(cached)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against exact binomial coefficients, computed with Python's `math.comb`.
    #[test]
    fn sample_sizes_match_the_hypergeometric_distribution() {
        for (cached, sampled) in [
            (1, 1),
            (2, 2),
            (19, 19),
            (20, 19),
            (21, 16),
            (60, 38),
            (100, 45),
            (200, 51),
            (300, 54),
            (1_000, 57),
            (10_000, 59),
            (4_000_000_000, 59),
        ] {
            assert_eq!(spot_check(cached), sampled, "of {cached}");
            assert!(
                sampled == 0
                    || detection_probability(cached, assumed_edits(cached), sampled - 1) < SPOT_CHECK_POWER,
                "of {cached}"
            );
        }
        assert_eq!(spot_check(0), 0);
        assert!((detection_probability(300, 15, 54) - 0.952_945_859_891_852_1).abs() < 1e-12);
    }

    #[test]
    fn fewer_edits_are_detected_less_often() {
        assert!(
            detection_probability(300, 1, 54) < 0.19,
            "one of 300 is found with the chance of being sampled"
        );
        assert!(detection_probability(300, 300, 1) >= 1.0);
        assert!(detection_probability(300, 0, 300) <= 0.0);
    }
}
