//! Detectors of a rising failure rate after activation (section 3.8 of the design, paper stage 6).
//!
//! [`Cusum`] is the early warning (Page 1954); [`ShiryaevRoberts`] is an e-detector (Shin, Ramdas & Rinaldo 2023)
//! whose mean run length to a false alarm is at least the stated number, for any failure rate up to `rate_normal`.
//! Both latch: once alarmed they stay so until replaced.

use serde::{Deserialize, Serialize};

use super::{STATISTIC_MAX, StatsError, open_unit};

/// The longest supported false-alarm run length, in observations.
pub const ARL_MAX: f64 = 1e9;

/// The failure rates a [`ShiryaevRoberts`] bets on, as parts of the way from the normal rate to 1.
const BETS: [f64; 3] = [0.05, 0.15, 0.35];

/// NaN compares with nothing, so an unusable statistic is an alarm.
fn is_alarm(statistic: f64, threshold: f64) -> bool {
    !(statistic < threshold)
}

/// `S = max(0, S + ln(likelihood ratio))`; alarm once `S >= threshold`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cusum {
    rate_normal: f64,
    rate_degraded: f64,
    threshold: f64,
    statistic: f64,
    alarmed: bool,
}

impl Cusum {
    /// A detector of a change from `rate_normal` to `rate_degraded` with decision interval `threshold` (in nats).
    ///
    /// # Errors
    /// Rates outside (0, 1) or not rising, or a threshold that is not positive and finite.
    pub fn new(rate_normal: f64, rate_degraded: f64, threshold: f64) -> Result<Self, StatsError> {
        open_unit("rate_normal", rate_normal)?;
        open_unit("rate_degraded", rate_degraded)?;
        if rate_degraded <= rate_normal {
            let (name, value) = ("rate_degraded", rate_degraded);
            return Err(StatsError::Parameter { name, value, allowed: "above rate_normal" });
        }
        if !(threshold > 0.0 && threshold.is_finite()) {
            return Err(StatsError::Parameter {
                name: "threshold",
                value: threshold,
                allowed: "above 0 and finite",
            });
        }
        Ok(Self { rate_normal, rate_degraded, threshold, statistic: 0.0, alarmed: false })
    }

    /// Takes one episode's result and returns whether there is an alarm, from it or from an earlier one.
    pub fn update(&mut self, failed: bool) -> bool {
        self.statistic =
            (self.statistic + libm::log(ratio(self.rate_normal, self.rate_degraded, failed))).max(0.0);
        self.alarmed |= is_alarm(self.statistic, self.threshold);
        self.alarmed
    }

    /// The statistic, in nats; 0 is no evidence.
    #[must_use]
    pub const fn statistic(&self) -> f64 {
        self.statistic
    }

    /// The decision interval, in nats.
    #[must_use]
    pub const fn threshold(&self) -> f64 {
        self.threshold
    }
}

/// `R_i = (R_i + 1) * likelihood ratio_i` for several degraded rates; alarm once the mean of `R_i` reaches the
/// wanted run length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShiryaevRoberts {
    rate_normal: f64,
    arl: f64,
    statistics: [f64; BETS.len()],
    alarmed: bool,
}

impl ShiryaevRoberts {
    /// A detector of a failure rate above `rate_normal` with a mean of at least `arl` observations to a false
    /// alarm.
    ///
    /// # Errors
    /// A rate outside (0, 1), or a run length outside [1, [`ARL_MAX`]].
    pub fn new(rate_normal: f64, arl: f64) -> Result<Self, StatsError> {
        open_unit("rate_normal", rate_normal)?;
        if !(1.0..=ARL_MAX).contains(&arl) {
            return Err(StatsError::Parameter { name: "arl", value: arl, allowed: "from 1 to 1e9" });
        }
        Ok(Self { rate_normal, arl, statistics: [0.0; BETS.len()], alarmed: false })
    }

    /// Takes one episode's result and returns whether there is an alarm, from it or from an earlier one.
    pub fn update(&mut self, failed: bool) -> bool {
        for (statistic, bet) in self.statistics.iter_mut().zip(BETS) {
            let rate_degraded = self.rate_normal + bet * (1.0 - self.rate_normal);
            *statistic =
                ((*statistic + 1.0) * ratio(self.rate_normal, rate_degraded, failed)).min(STATISTIC_MAX);
        }
        self.alarmed |= is_alarm(self.statistic(), self.arl);
        self.alarmed
    }

    /// The statistic; the alarm is raised once it reaches [`ShiryaevRoberts::arl`].
    #[must_use]
    pub fn statistic(&self) -> f64 {
        super::mean(&self.statistics)
    }

    /// The guaranteed mean run length to a false alarm, which is also the threshold, in observations.
    #[must_use]
    pub const fn arl(&self) -> f64 {
        self.arl
    }
}

/// The likelihood ratio of one Bernoulli observation.
fn ratio(rate_normal: f64, rate_degraded: f64, failed: bool) -> f64 {
    if failed { rate_degraded / rate_normal } else { (1.0 - rate_degraded) / (1.0 - rate_normal) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::bootstrap::ResamplingStream;

    /// Mean observations to the alarm over 200 streams, each ended at `limit`.
    fn run_length(rate: f64, limit: u32, mut detector: impl FnMut() -> Box<dyn FnMut(bool) -> bool>) -> f64 {
        let mut stream = ResamplingStream::new(7);
        let runs = 200;
        let total: u32 = (0..runs)
            .map(|_| {
                let mut update = detector();
                (1..=limit).find(|_| update(stream.unit() < rate)).unwrap_or(limit)
            })
            .sum();
        f64::from(total) / f64::from(runs)
    }

    #[test]
    fn run_lengths_meet_their_bounds() {
        let shiryaev = || -> Box<dyn FnMut(bool) -> bool> {
            let mut detector = ShiryaevRoberts::new(0.05, 500.0).unwrap();
            Box::new(move |failed| detector.update(failed))
        };
        assert!(run_length(0.05, 20_000, shiryaev) >= 500.0);
        assert!(run_length(0.20, 20_000, shiryaev) < 60.0);
        let cusum = || -> Box<dyn FnMut(bool) -> bool> {
            let mut detector = Cusum::new(0.05, 0.15, 5.0).unwrap();
            Box::new(move |failed| detector.update(failed))
        };
        assert!(run_length(0.05, 20_000, cusum) >= libm::exp(5.0));
        assert!(run_length(0.40, 20_000, cusum) < 30.0);
    }

    #[test]
    fn drift_alarm_latches_and_nan_raises_it() {
        let mut cusum = Cusum::new(0.05, 0.15, 2.0).unwrap();
        assert!(!cusum.update(true) && cusum.update(true));
        assert!((0..100).all(|_| cusum.update(false)));
        let mut shiryaev = ShiryaevRoberts::new(0.05, 50.0).unwrap();
        assert!((0..10_000).any(|_| shiryaev.update(true)));
        assert!(shiryaev.statistic().is_finite());
        assert!(is_alarm(f64::NAN, 1.0));
    }

    #[test]
    fn drift_charts_refuse_bad_parameters() {
        for rate in [0.0, 1.0, f64::NAN] {
            assert!(Cusum::new(rate, 0.5, 1.0).is_err());
            assert!(Cusum::new(0.05, rate, 1.0).is_err());
            assert!(ShiryaevRoberts::new(rate, 100.0).is_err());
        }
        assert!(Cusum::new(0.2, 0.1, 1.0).is_err());
        for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Cusum::new(0.1, 0.2, value).is_err());
            assert!(ShiryaevRoberts::new(0.1, value).is_err());
        }
    }
}
