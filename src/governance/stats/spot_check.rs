//! The number of results of a block to re-run, so that an edited share is detected.
//!
//! Sampling without replacement, exactly (hypergeometric): of `cached` cells at least `edited` are false, `n` are
//! sampled, each set of `n` as likely as any other. `1 - C(cached - edited, n) / C(cached, n)` is the chance that the
//! sample holds a false one. Fewer edits are found less often: [`detection_probability`] says how often.

/// The edited share that a spot check is designed for: one in twenty, rounded up to whole cells.
pub const EDITED_ONE_IN: u32 = 20;

/// The chance with which a spot check finds that share.
pub const SPOT_CHECK_POWER: f64 = 0.95;

/// Tolerance against rounding, so that a rounding error does not add a cell to the sample.
const SLACK: f64 = 1e-12;

/// The least number of edited cells that a spot check of `cached` cells is designed for.
#[must_use]
pub const fn assumed_edits(cached: u32) -> u32 {
    cached.div_ceil(EDITED_ONE_IN)
}

/// The chance that a sample of `sampled` cells holds one of the `edited` false ones among `cached`.
#[must_use]
pub fn detection_probability(cached: u32, edited: u32, sampled: u32) -> f64 {
    let sampled = sampled.min(cached);
    let Some(honest) = cached.checked_sub(edited) else { return 1.0 };
    if sampled > honest {
        return 1.0;
    }
    let missed: f64 = (0..sampled).map(|turn| f64::from(honest - turn) / f64::from(cached - turn)).product();
    1.0 - missed
}

/// Sample size among `cached` cells for [`SPOT_CHECK_POWER`]: 59 of very many, 54 of 300, 19 of 20, all of fewer.
#[must_use]
pub fn spot_check(cached: u32) -> u32 {
    let enough = |sampled: &u32| {
        detection_probability(cached, assumed_edits(cached), *sampled) >= SPOT_CHECK_POWER - SLACK
    };
    // With replacement 59 are enough, so they are without it.
    (0..=cached).find(enough).unwrap_or(cached)
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
    fn what_is_edited_less_is_found_less_often() {
        assert!(detection_probability(300, 1, 54) < 0.19, "one of 300 is found with the share that is drawn");
        assert!(detection_probability(300, 300, 1) >= 1.0);
        assert!(detection_probability(300, 0, 300) <= 0.0);
    }
}
