//! Evidence that a rate rose, valid at any time of an unlimited life.
//!
//! A weighted sum of test martingales, one that starts before each observation. The sum is a martingale of mean 1 at the
//! normal rate, and a supermartingale below it. So it ever reaches `1 / alpha` with probability at most `alpha` (Ville
//! 1939). It needs no reset: the terms that start late find a late rise, the first ones an early rise. Decides nothing.

use serde::{Deserialize, Serialize};

use super::{STATISTIC_MAX, StatsError, mean, open_unit};

/// By how much the rates that a [`RateRise`] bets on exceed the normal one. Each is four times the one before.
const RISES: [f64; 4] = [0.002_5, 0.01, 0.04, 0.16];

/// The evidence that a rate of bad observations is above `rate_normal`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateRise {
    rate_normal: f64,
    observations: u64,
    /// Sums of the started terms, one for each rate.
    started: [f64; RISES.len()],
}

impl RateRise {
    /// Evidence before the first observation.
    ///
    /// # Errors
    /// A rate outside (0, 1).
    pub fn new(rate_normal: f64) -> Result<Self, StatsError> {
        open_unit("rate_normal", rate_normal)?;
        Ok(Self { rate_normal, observations: 0, started: [0.0; RISES.len()] })
    }

    /// The rate that counts as normal.
    #[must_use]
    pub const fn rate_normal(&self) -> f64 {
        self.rate_normal
    }

    /// Takes in one observation.
    pub fn update(&mut self, bad: bool) {
        let next = self.observations.saturating_add(1);
        let weight = unstarted(self.observations) - unstarted(next);
        let normal = self.rate_normal;
        for (sum, rise) in self.started.iter_mut().zip(RISES) {
            let risen = (normal + rise).min(0.5 * (1.0 + normal));
            let ratio = if bad { risen / normal } else { (1.0 - risen) / (1.0 - normal) };
            *sum = ((*sum + weight) * ratio).min(STATISTIC_MAX);
        }
        self.observations = next;
    }

    /// The evidence: 1 at first, and the probability that it ever reaches `1 / alpha` at the normal rate is at most `alpha`.
    #[must_use]
    pub fn value(&self) -> f64 {
        unstarted(self.observations) + mean(&self.started)
    }
}

/// The weight of the terms that start after this number of observations.
fn unstarted(observations: u64) -> f64 {
    1.0 / (1.0 + libm::log2(observations as f64 + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_is_a_martingale_at_the_normal_rate() {
        for normal in [0.001, 0.063, 0.5, 0.95] {
            let mut evidence = RateRise::new(normal).unwrap();
            assert_eq!(evidence.value(), 1.0);
            for task in 0..200_u64 {
                let after = |bad| {
                    let mut next = evidence.clone();
                    next.update(bad);
                    next.value()
                };
                let expected = normal * after(true) + (1.0 - normal) * after(false);
                let now = evidence.value();
                assert!((expected - now).abs() < 1e-9 * now, "{normal}, task {task}: {expected} after {now}");
                evidence.update(task % 7 == 3);
            }
        }
    }

    /// The recursion equals the sum that it computes.
    #[test]
    fn evidence_equals_the_sum_over_all_starts() {
        let mut evidence = RateRise::new(0.02).unwrap();
        let observations = [false, false, true, false, true];
        for bad in observations {
            evidence.update(bad);
        }
        let weight = |start: usize| unstarted(start as u64) - unstarted(start as u64 + 1);
        let product = |start: usize, risen: f64| -> f64 {
            let rest = observations.iter().skip(start);
            rest.map(|bad| if *bad { risen / 0.02 } else { (1.0 - risen) / 0.98 }).product()
        };
        let sum = |rise: f64| (0..5).map(|start| weight(start) * product(start, 0.02 + rise)).sum::<f64>();
        let expected = unstarted(5) + RISES.into_iter().map(sum).sum::<f64>() / 4.0;
        assert!((evidence.value() - expected).abs() < 1e-12, "{} is not {expected}", evidence.value());
    }

    #[test]
    fn rate_outside_its_range_is_refused_and_sums_stay_finite() {
        for rate in [0.0, 1.0, -0.1, f64::NAN] {
            assert!(RateRise::new(rate).is_err(), "{rate}");
        }
        let mut evidence = RateRise::new(0.01).unwrap();
        (0..10_000).for_each(|_| evidence.update(true));
        assert!(evidence.value().is_finite() && evidence.value() > 1e90);
    }
}
