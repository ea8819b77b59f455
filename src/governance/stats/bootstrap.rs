//! Seeded bootstrap intervals for reports: BCa (Efron 1987).
//!
//! The same values, statistic and seed give the same interval on every platform.

use super::special::{normal_cdf, normal_quantile};
use super::{Interval, StatsError, finite, open_unit};

/// The most resamples one interval may use.
pub const RESAMPLES_MAX: usize = 100_000;

/// The bias-corrected and accelerated interval of `statistic` over `values`.
///
/// # Errors
/// Fewer than two or non-finite values, a statistic that is not finite, a level outside (0, 1), no or too many
/// resamples; [`StatsError::NoSpread`] if every resample or every jackknife value is the same.
pub fn bca(
    values: &[f64],
    statistic: impl Fn(&[f64]) -> f64,
    level: f64,
    resamples: usize,
    seed: u64,
) -> Result<Interval, StatsError> {
    let draws = resample(values, &statistic, level, resamples, seed)?;
    let no_spread = StatsError::NoSpread { n: values.len() };
    let estimate = statistic(values);
    let count = draws.len() as f64;
    let below = draws.iter().filter(|draw| **draw < estimate).count() as f64;
    let equal = draws.iter().filter(|draw| **draw == estimate).count() as f64;
    // Equal draws count half, so that a discrete statistic is not read as biased.
    let bias = normal_quantile((below + equal / 2.0) / count).ok_or(no_spread.clone())?;
    let acceleration = acceleration(values, &statistic).ok_or(no_spread.clone())?;
    let end = |p: f64| {
        let z = normal_quantile(p).ok_or(no_spread.clone())? + bias;
        Ok::<f64, StatsError>(quantile(&draws, normal_cdf(bias + z / (1.0 - acceleration * z))))
    };
    let alpha = (1.0 - level) / 2.0;
    Ok(Interval { lower: end(alpha)?, upper: end(1.0 - alpha)?, level })
}

/// Efron's acceleration from the jackknife, or `None` if the jackknife values are all equal.
fn acceleration(values: &[f64], statistic: impl Fn(&[f64]) -> f64) -> Option<f64> {
    let jackknife: Vec<f64> = (0..values.len())
        .map(|left_out| {
            let rest: Vec<f64> =
                values.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, value)| *value).collect();
            statistic(&rest)
        })
        .collect();
    let centre = super::mean(&jackknife);
    let sum = |power: i32| jackknife.iter().map(|value| (centre - value).powi(power)).sum::<f64>();
    let squares = sum(2);
    (squares > 0.0 && squares.is_finite()).then(|| sum(3) / (6.0 * squares.powf(1.5)))
}

fn resample(
    values: &[f64],
    statistic: impl Fn(&[f64]) -> f64,
    level: f64,
    resamples: usize,
    seed: u64,
) -> Result<Vec<f64>, StatsError> {
    finite(values, 2)?;
    open_unit("level", level)?;
    if resamples == 0 {
        return Err(StatsError::TooFew { got: 0, needed: 1 });
    }
    if resamples > RESAMPLES_MAX {
        return Err(StatsError::TooMany { got: resamples, limit: RESAMPLES_MAX });
    }
    let mut stream = ResamplingStream::new(seed);
    let mut drawn = vec![0.0; values.len()];
    let mut draws = Vec::with_capacity(resamples);
    for _ in 0..resamples {
        drawn.fill_with(|| values[stream.index(values.len())]);
        draws.push(statistic(&drawn));
    }
    finite(&draws, 1)?;
    draws.sort_by(f64::total_cmp);
    Ok(draws)
}

/// The linearly interpolated quantile (type 7) of sorted values.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a position within the list")]
fn quantile(sorted: &[f64], p: f64) -> f64 {
    let position = p.clamp(0.0, 1.0) * (sorted.len() as f64 - 1.0);
    let (below, above) = (position.floor(), position.ceil());
    let (low, high) = (sorted[below as usize], sorted[above as usize]);
    low + (high - low) * (position - below)
}

/// SplitMix64 (Steele, Lea & Flood 2014): a small portable stream, enough for resampling.
pub(super) struct ResamplingStream(u64);

impl ResamplingStream {
    pub(super) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number in [0, 1).
    #[cfg(test)]
    pub(super) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// An index below `len` (multiply-shift; its bias is below `len` / 2^64).
    #[allow(clippy::cast_possible_truncation, reason = "below `len`")]
    fn index(&mut self, len: usize) -> usize {
        ((u128::from(self.next()) * len as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::mean;

    #[test]
    fn bootstrap_is_seeded_and_refuses_bad_input() {
        let values = [1.0, 4.0, 2.0, 8.0, 5.0];
        let at = |seed| bca(&values, mean, 0.95, 500, seed).unwrap();
        assert_eq!(at(1), at(1));
        assert_ne!(at(1), at(2));
        assert!(bca(&[1.0], mean, 0.95, 100, 0).is_err());
        assert!(bca(&[1.0, f64::NAN], mean, 0.95, 100, 0).is_err());
        assert!(bca(&values, mean, 1.0, 100, 0).is_err());
        assert!(bca(&values, mean, 0.95, 0, 0).is_err());
        assert!(bca(&values, mean, 0.95, RESAMPLES_MAX + 1, 0).is_err());
        assert!(bca(&values, |_| f64::NAN, 0.95, 100, 0).is_err());
        assert!(bca(&[2.0, 2.0, 2.0], mean, 0.95, 100, 0).is_err());
    }

    proptest::proptest! {
        #[test]
        fn bca_interval_contains_the_mean(values in proptest::collection::vec(-10.0..10.0f64, 8..40), seed in 0u64..1000) {
            let interval = bca(&values, mean, 0.99, 400, seed).unwrap();
            proptest::prop_assert!(interval.contains(mean(&values)));
        }
    }
}
