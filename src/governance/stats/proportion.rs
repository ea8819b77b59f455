//! Intervals for one proportion: Wilson (1927) and the exact one of Clopper and Pearson (1934); for the difference of
//! two: Newcombe (1998), of both Wilson intervals.

use super::special::{beta_quantile, normal_quantile};
use super::{Interval, StatsError, open_unit};

/// The Wilson score interval of `successes` of `trials` at the two-sided `level`, e.g. 0.95.
///
/// # Errors
/// No trials, more successes than trials, or a level outside (0, 1).
pub fn wilson(successes: u64, trials: u64, level: f64) -> Result<Interval, StatsError> {
    open_unit("level", level)?;
    let alpha = (1.0 - level) / 2.0;
    let (lower, upper) = wilson_ends(successes, trials, alpha)?;
    Ok(Interval { lower, upper, level })
}

/// The one-sided Wilson lower bound: true of at least `1 - alpha` of samples, approximately.
///
/// # Errors
/// As [`wilson`].
pub fn wilson_lower(successes: u64, trials: u64, alpha: f64) -> Result<f64, StatsError> {
    Ok(wilson_ends(successes, trials, alpha)?.0)
}

/// The one-sided Wilson upper bound.
///
/// # Errors
/// As [`wilson`].
pub fn wilson_upper(successes: u64, trials: u64, alpha: f64) -> Result<f64, StatsError> {
    Ok(wilson_ends(successes, trials, alpha)?.1)
}

/// The exact (Clopper-Pearson) interval: it covers the true proportion with at least the stated level.
///
/// # Errors
/// No trials, more successes than trials, or a level outside (0, 1).
pub fn clopper_pearson(successes: u64, trials: u64, level: f64) -> Result<Interval, StatsError> {
    open_unit("level", level)?;
    let alpha = (1.0 - level) / 2.0;
    let lower = clopper_pearson_lower(successes, trials, alpha)?;
    let upper = clopper_pearson_upper(successes, trials, alpha)?;
    Ok(Interval { lower, upper, level })
}

/// The exact one-sided lower bound: 0 if nothing succeeded.
///
/// # Errors
/// As [`clopper_pearson`].
pub fn clopper_pearson_lower(successes: u64, trials: u64, alpha: f64) -> Result<f64, StatsError> {
    counts(successes, trials)?;
    open_unit("alpha", alpha)?;
    if successes == 0 {
        return Ok(0.0);
    }
    Ok(beta_quantile(alpha, successes as f64, (trials - successes) as f64 + 1.0))
}

/// The exact one-sided upper bound: 1 - alpha^(1/n) if nothing succeeded, 1 if all did.
///
/// # Errors
/// As [`clopper_pearson`].
pub fn clopper_pearson_upper(successes: u64, trials: u64, alpha: f64) -> Result<f64, StatsError> {
    counts(successes, trials)?;
    // "x of n succeeded" bounds from above what "n - x of n failed" bounds from below.
    Ok(1.0 - clopper_pearson_lower(trials - successes, trials, alpha)?)
}

/// The difference of two independent proportions, `second` minus `first`, each as successes and trials: Newcombe's hybrid
/// score interval (1998, method 10). It stays within -1 to 1, and is none for a share of 0 or 1 alone.
///
/// # Errors
/// As [`wilson`], of either.
pub fn difference(first: (u64, u64), second: (u64, u64), level: f64) -> Result<Interval, StatsError> {
    let (one, two) = (wilson(first.0, first.1, level)?, wilson(second.0, second.1, level)?);
    let (p, q) = (first.0 as f64 / first.1 as f64, second.0 as f64 / second.1 as f64);
    let difference = q - p;
    let lower = difference - (q - two.lower).hypot(one.upper - p);
    let upper = difference + (two.upper - q).hypot(p - one.lower);
    Ok(Interval { lower: lower.max(-1.0), upper: upper.min(1.0), level })
}

fn wilson_ends(successes: u64, trials: u64, alpha: f64) -> Result<(f64, f64), StatsError> {
    counts(successes, trials)?;
    let out_of_range =
        StatsError::Parameter { name: "alpha", value: alpha, allowed: "above 0 and below 0.5" };
    if !(alpha > 0.0 && alpha < 0.5) {
        return Err(out_of_range);
    }
    let z = -normal_quantile(alpha).ok_or(out_of_range)?;
    let n = trials as f64;
    let p = successes as f64 / n;
    let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    // At the ends the algebra is exact and rounding must not exclude the estimate.
    let lower = if successes == 0 { 0.0 } else { (centre - half).max(0.0) };
    let upper = if successes == trials { 1.0 } else { (centre + half).min(1.0) };
    Ok((lower, upper))
}

fn counts(successes: u64, trials: u64) -> Result<(), StatsError> {
    if trials == 0 {
        return Err(StatsError::TooFew { got: 0, needed: 1 });
    }
    if trials > super::SAMPLES_MAX as u64 {
        let got = usize::try_from(trials).unwrap_or(usize::MAX);
        return Err(StatsError::TooMany { got, limit: super::SAMPLES_MAX });
    }
    if successes > trials {
        return Err(StatsError::Counts { count: successes, total: trials });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_refuse_bad_input() {
        assert!(wilson(0, 0, 0.95).is_err());
        assert!(wilson(2, 1, 0.95).is_err());
        assert!(clopper_pearson_upper(2, 1, 0.05).is_err());
        for level in [0.0, 1.0, f64::NAN, -1.0, 2.0] {
            assert!(wilson(1, 2, level).is_err(), "{level}");
            assert!(clopper_pearson(1, 2, level).is_err(), "{level}");
            assert!(wilson_upper(1, 2, level).is_err(), "{level}");
            assert!(clopper_pearson_lower(1, 2, level).is_err(), "{level}");
        }
    }

    /// Worked values of Newcombe's paper (Statistics in Medicine 17, 873-890, table II, method 10).
    #[test]
    fn newcombe_differences_are_those_of_the_paper() {
        for (second, first, lower, upper) in [
            ((56, 70), (48, 80), 0.0524, 0.3339),
            ((9, 10), (3, 10), 0.1705, 0.8090),
            ((5, 56), (0, 29), -0.0381, 0.1926),
            ((10, 10), (0, 10), 0.6075, 1.0),
        ] {
            let found = difference(first, second, 0.95).unwrap();
            assert!((found.lower - lower).abs() < 6e-5, "{found:?}");
            assert!((found.upper - upper).abs() < 6e-5, "{found:?}");
            let turned = difference(second, first, 0.95).unwrap();
            assert!((turned.lower + found.upper).abs() < 1e-12 && (turned.upper + found.lower).abs() < 1e-12);
        }
        assert!(difference((0, 0), (1, 2), 0.95).is_err() && difference((1, 2), (3, 2), 0.95).is_err());
    }

    proptest::proptest! {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
        #[test]
        fn intervals_contain_the_estimate_and_narrow_with_n(n in 1u64..400, part in 0.0..1.0f64, level in 0.5..0.999) {
            let k = (part * n as f64).round() as u64;
            let estimate = k as f64 / n as f64;
            for method in [wilson, clopper_pearson] {
                let interval = method(k, n, level).unwrap();
                proptest::prop_assert!(interval.contains(estimate));
                proptest::prop_assert!(interval.lower >= 0.0 && interval.upper <= 1.0);
                let larger = method(4 * k, 4 * n, level).unwrap();
                proptest::prop_assert!(larger.width() < interval.width());
            }
        }
    }
}
