//! Statistics for governance: intervals, paired comparisons, stopping rules and drift detectors.
//!
//! Pure mathematics over plain numbers: no clock, no global randomness (resampling takes a seed), no I/O.
//! Must not decide: it reports what the evidence supports; thresholds are in the gate.
//! Anything that is not a finite number, or no evidence at all, is an error and never a value.

mod bootstrap;
mod drift;
mod multiple;
mod paired;
pub mod population;
mod proportion;
mod rise;
mod sign;
pub mod smirnov;
mod special;
pub mod spot_check;
mod wilcoxon;

use std::borrow::Cow;

use holdpoint_text::Hint;
use serde::{Deserialize, Serialize};

pub use bootstrap::{RESAMPLES_MAX, bca};
pub use drift::{ARL_MAX, Cusum, ShiryaevRoberts};
pub use multiple::holm;
pub use paired::{
    PairedBound, PairedCounts, PairedMethod, SPREAD_MIN, bernstein_pairs, binary_pairs, student_pairs,
};
pub use proportion::{
    clopper_pearson, clopper_pearson_lower, clopper_pearson_upper, difference, wilson, wilson_lower,
    wilson_upper,
};
pub use rise::RateRise;
pub use sign::sign_test;
pub use special::{normal_cdf, normal_quantile, student_cdf, student_quantile};
pub use wilcoxon::{EXACT_PAIRS_MAX, SignedRank, signed_rank};

/// Level of the two-sided intervals that are shown. No rule decides about a version by them.
pub const SHOWN_LEVEL: f64 = 0.95;

/// The most evidence that a chart keeps: far above every threshold, far below the largest number that the next product
/// could not hold.
const STATISTIC_MAX: f64 = 1e100;

/// The most observations one analysis accepts.
pub const SAMPLES_MAX: usize = 1_000_000;

/// A two-sided confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interval {
    /// The lower end, included in the interval.
    pub lower: f64,
    /// The upper end, included in the interval.
    pub upper: f64,
    /// The confidence level in (0, 1), e.g. 0.95.
    pub level: f64,
}

impl Interval {
    /// Whether `value` lies in the closed interval; never true of NaN.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        self.lower <= value && value <= self.upper
    }

    /// Upper end minus lower end.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.upper - self.lower
    }
}

/// Why no statistic could be computed. The gate reads every one of these as missing evidence.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum StatsError {
    /// Fewer observations than the method needs to say anything.
    #[error("{got} observations are too few; at least {needed} are needed")]
    TooFew { got: usize, needed: usize },
    /// More observations than [`SAMPLES_MAX`], or more resamples than [`RESAMPLES_MAX`].
    #[error("{got} is over the limit of {limit}")]
    TooMany { got: usize, limit: usize },
    /// A value that is NaN or infinite.
    #[error("observation {index} is {value}; only finite numbers are allowed")]
    NotFinite { index: usize, value: f64 },
    /// A parameter outside its range.
    #[error("{name} is {value}; it must be {allowed}")]
    Parameter { name: &'static str, value: f64, allowed: &'static str },
    /// Counts that contradict each other, e.g. more successes than trials.
    #[error("the counts {count} of {total} contradict each other")]
    Counts { count: u64, total: u64 },
    /// All observations are equal, so the method knows nothing of their spread.
    #[error("all {n} observations are equal; their spread is unknown")]
    NoSpread { n: usize },
}

impl Hint for StatsError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::NoSpread { .. } => Some("use a method with a known range".into()),
            Self::TooFew { .. }
            | Self::TooMany { .. }
            | Self::NotFinite { .. }
            | Self::Parameter { .. }
            | Self::Counts { .. } => None,
        }
    }
}

/// Passes a probability in the open interval (0, 1) on.
pub(crate) fn open_unit(name: &'static str, value: f64) -> Result<f64, StatsError> {
    if value > 0.0 && value < 1.0 {
        Ok(value)
    } else {
        Err(StatsError::Parameter { name, value, allowed: "above 0 and below 1" })
    }
}

/// Checks that there are enough, not too many, and only finite observations.
pub(crate) fn finite(values: &[f64], needed: usize) -> Result<(), StatsError> {
    let got = values.len();
    if got < needed {
        return Err(StatsError::TooFew { got, needed });
    }
    if got > SAMPLES_MAX {
        return Err(StatsError::TooMany { got, limit: SAMPLES_MAX });
    }
    match values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, &value)) => Err(StatsError::NotFinite { index, value }),
        None => Ok(()),
    }
}

/// The arithmetic mean; the caller has checked that there is at least one value.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The sample variance with `ddof = 1`; the caller has checked that there are at least two values.
pub(crate) fn variance(values: &[f64]) -> f64 {
    let centre = mean(values);
    values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / (values.len() as f64 - 1.0)
}

#[cfg(test)]
mod reference;
