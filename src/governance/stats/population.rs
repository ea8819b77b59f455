//! What the whole budget can still come to, from a part of it: confidence sets for a finite population.
//!
//! The budget's outcomes are a fixed, unknown population that is revealed in a random order committed to before
//! the first look. Where `theta` is what the population holds, the prior-posterior ratio of `theta` is a
//! martingale that starts at 1, so by Ville's inequality the set of all `theta` whose ratio stays below `1/alpha`
//! misses the true one *at any look, however many looks there are*, with probability at most `alpha`
//! (Waudby-Smith & Ramdas 2020, arXiv 2006.04347). The prior is uniform over all compositions, for which the
//! chance of what was seen is the same for every possible count and the ratio needs no sum:
//! `theta` stays if `L(theta) > alpha / (number of compositions of what was seen)`, `L` the hypergeometric
//! likelihood. Must not decide anything: it says what is still possible.

use super::paired::PairedCounts;
use super::{SAMPLES_MAX, StatsError, open_unit};

/// What lies this close to the bar, in nats, is kept: rounding must exclude nothing.
const LN_SLACK: f64 = 1e-9;

/// `ln k!` for every count of a population.
#[derive(Clone, Debug)]
struct LnFactorials(Vec<f64>);

impl LnFactorials {
    fn up_to(largest: u64) -> Result<Self, StatsError> {
        let limit = SAMPLES_MAX;
        let too_many = || StatsError::TooMany { got: usize::MAX, limit };
        let size = usize::try_from(largest).ok().filter(|size| *size <= limit).ok_or_else(too_many)?;
        let mut sums = Vec::with_capacity(size + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for count in 1..=size {
            sum += libm::log(count as f64);
            sums.push(sum);
        }
        Ok(Self(sums))
    }

    /// `ln C(n, k)`; minus infinity if there is no such choice.
    fn ln_choose(&self, n: u64, k: u64) -> f64 {
        let of = |count: u64| usize::try_from(count).ok().and_then(|count| self.0.get(count)).copied();
        let Some(rest) = n.checked_sub(k) else { return f64::NEG_INFINITY };
        match (of(n), of(k), of(rest)) {
            (Some(all), Some(chosen), Some(left)) => all - chosen - left,
            _ => f64::NEG_INFINITY,
        }
    }
}

/// A budget of runs that pass or fail.
#[derive(Clone, Debug)]
pub struct RunBudget {
    size: u64,
    ln: LnFactorials,
}

impl RunBudget {
    /// A population of `size` runs, 1 to [`SAMPLES_MAX`].
    ///
    /// # Errors
    /// No runs, or too many.
    pub fn new(size: u64) -> Result<Self, StatsError> {
        if size == 0 {
            return Err(StatsError::TooFew { got: 0, needed: 1 });
        }
        Ok(Self { size, ln: LnFactorials::up_to(size)? })
    }

    /// The smallest and the largest number of passes in the whole budget that `passed` of `seen` leave possible
    /// at `alpha`.
    ///
    /// # Errors
    /// More passed than seen, more seen than there are, or `alpha` outside (0, 1).
    pub fn passes(&self, passed: u64, seen: u64, alpha: f64) -> Result<(u64, u64), StatsError> {
        open_unit("alpha", alpha)?;
        if passed > seen {
            return Err(StatsError::Counts { count: passed, total: seen });
        }
        let Some(unseen) = self.size.checked_sub(seen) else {
            return Err(StatsError::Counts { count: seen, total: self.size });
        };
        let failed = seen - passed;
        let ln_bar = libm::log(alpha / (seen as f64 + 1.0)) - LN_SLACK + self.ln.ln_choose(self.size, seen);
        let possible = |total: &u64| {
            self.ln.ln_choose(*total, passed) + self.ln.ln_choose(self.size - total, failed) > ln_bar
        };
        let mut totals = (passed..=passed + unseen).filter(possible);
        // The likeliest total is above every bar, so there is one.
        let smallest = totals.next().unwrap_or(passed);
        let largest = totals.next_back().unwrap_or(smallest);
        Ok((smallest, largest))
    }
}

/// The possible totals of a budget of pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PairsPossible {
    /// The smallest possible number of candidate-only pairs less active-only pairs.
    pub least_net: i64,
    /// The largest possible number of pairs that differ.
    pub most_discordant: u64,
}

impl PairsPossible {
    /// Counts of `size` pairs that are at least as favourable to the candidate as every possible outcome: the
    /// least net count beside the most discordance. What is established of them is established of every outcome
    /// in the set, for a bound that only widens with discordance and only rises with the net count.
    #[must_use]
    pub fn most_favorable(&self, size: u64) -> PairedCounts {
        let net = self.least_net.unsigned_abs();
        // Net count and discordance are both odd or both even.
        let discordant = self.most_discordant.max(net);
        let larger = (discordant + net).div_ceil(2);
        let smaller = larger - net;
        let (candidate_only, active_only) =
            if self.least_net >= 0 { (larger, smaller) } else { (smaller, larger) };
        PairedCounts { pairs: size.max(larger + smaller), candidate_only, active_only }
    }
}

/// A budget of pairs, each with the event in the candidate alone, in the active version alone, or in neither way
/// different.
#[derive(Clone, Debug)]
pub struct PairBudget {
    size: u64,
    ln: LnFactorials,
}

impl PairBudget {
    /// A population of `size` pairs, 1 to [`SAMPLES_MAX`].
    ///
    /// # Errors
    /// No pairs, or too many.
    pub fn new(size: u64) -> Result<Self, StatsError> {
        let RunBudget { size, ln } = RunBudget::new(size)?;
        Ok(Self { size, ln })
    }

    /// What the totals over the whole budget can be at `alpha`, given the counts `seen` so far.
    ///
    /// With `t` pairs seen a composition stays if its likelihood is above `2 alpha / ((t + 1)(t + 2))`. For each
    /// number of active-only pairs the possible numbers of candidate-only pairs are one interval, because the
    /// likelihood is log-concave along it; its ends are found by bisection from its peak.
    ///
    /// # Errors
    /// Contradicting counts, more pairs seen than there are, or `alpha` outside (0, 1).
    pub fn possible(&self, seen: PairedCounts, alpha: f64) -> Result<PairsPossible, StatsError> {
        open_unit("alpha", alpha)?;
        let PairedCounts { pairs, candidate_only, active_only } = seen;
        let Some(concordant) = candidate_only.checked_add(active_only).and_then(|d| pairs.checked_sub(d))
        else {
            return Err(StatsError::Counts {
                count: candidate_only.saturating_add(active_only),
                total: pairs,
            });
        };
        let Some(unseen) = self.size.checked_sub(pairs) else {
            return Err(StatsError::Counts { count: pairs, total: self.size });
        };
        let t = pairs as f64;
        let ln_bar =
            libm::log(2.0 * alpha / ((t + 1.0) * (t + 2.0))) - LN_SLACK + self.ln.ln_choose(self.size, pairs);
        // The certain bounds until the first slice.
        let mut found: Option<PairsPossible> = None;
        for better in active_only..=active_only + unseen {
            let rest = self.size - better;
            let ln_better = self.ln.ln_choose(better, active_only);
            let possible = |worse: u64| {
                ln_better
                    + self.ln.ln_choose(worse, candidate_only)
                    + self.ln.ln_choose(rest - worse, concordant)
                    > ln_bar
            };
            let (lowest, highest) = (candidate_only, rest - concordant);
            let peak = peak(rest, candidate_only, concordant).clamp(lowest, highest);
            if !possible(peak) {
                continue;
            }
            let least = edge(lowest, peak, &possible);
            let most = highest - edge(0, highest - peak, &|below| possible(highest - below));
            let net = difference(least, better);
            let so_far = found.get_or_insert(PairsPossible { least_net: net, most_discordant: 0 });
            so_far.least_net = so_far.least_net.min(net);
            so_far.most_discordant = so_far.most_discordant.max(most + better);
        }
        // The likeliest composition is above every bar, so something was found; without it nothing is excluded.
        Ok(found.unwrap_or(PairsPossible {
            least_net: difference(candidate_only, active_only + unseen),
            most_discordant: candidate_only + active_only + unseen,
        }))
    }
}

/// The likeliest number of candidate-only pairs among `rest` that hold `worse` of them and `concordant` others in
/// what was seen: the smallest `W` with `L(W + 1) < L(W)`.
fn peak(rest: u64, worse: u64, concordant: u64) -> u64 {
    // L(W + 1) >= L(W) as long as W (worse + concordant) <= worse * rest - concordant.
    match (worse * rest).checked_sub(concordant) {
        Some(above) => above.checked_div(worse + concordant).map_or(0, |below| below + 1),
        None => worse,
    }
}

/// The smallest value in `from..=to` that is possible, given that `to` is and the possible ones are an interval.
fn edge(mut from: u64, mut to: u64, possible: &impl Fn(u64) -> bool) -> u64 {
    while from < to {
        let middle = from + (to - from) / 2;
        if possible(middle) { to = middle } else { from = middle + 1 }
    }
    to
}

fn difference(worse: u64, better: u64) -> i64 {
    // Both are at most SAMPLES_MAX.
    i64::try_from(worse).unwrap_or(i64::MAX).saturating_sub_unsigned(better)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::special::ln_choose;

    /// Every composition, compared with the bar one by one.
    fn enumerated(size: u64, seen: PairedCounts, alpha: f64) -> PairsPossible {
        let PairedCounts { pairs, candidate_only, active_only } = seen;
        let same = pairs - candidate_only - active_only;
        let ln = |n: u64, k: u64| if k > n { f64::NEG_INFINITY } else { ln_choose(n as f64, k as f64) };
        let t = pairs as f64;
        let mut found = PairsPossible { least_net: i64::MAX, most_discordant: 0 };
        for better in 0..=size {
            for worse in 0..=size - better {
                let likelihood =
                    ln(worse, candidate_only) + ln(better, active_only) + ln(size - worse - better, same)
                        - ln(size, pairs);
                if likelihood > (2.0 * alpha / ((t + 1.0) * (t + 2.0))).ln() - LN_SLACK {
                    found.least_net = found.least_net.min(difference(worse, better));
                    found.most_discordant = found.most_discordant.max(worse + better);
                }
            }
        }
        found
    }

    fn counts(pairs: u64, candidate_only: u64, active_only: u64) -> PairedCounts {
        PairedCounts { pairs, candidate_only, active_only }
    }

    #[test]
    fn walk_equals_enumeration() {
        let pairs = PairBudget::new(60).unwrap();
        for seen in [
            counts(0, 0, 0),
            counts(1, 1, 0),
            counts(1, 0, 0),
            counts(20, 0, 0),
            counts(20, 20, 0),
            counts(20, 0, 20),
            counts(20, 5, 1),
            counts(20, 10, 10),
            counts(40, 3, 30),
            counts(59, 9, 4),
            counts(60, 9, 4),
        ] {
            for alpha in [0.0025, 0.05, 0.5] {
                assert_eq!(
                    pairs.possible(seen, alpha).unwrap(),
                    enumerated(60, seen, alpha),
                    "{seen:?} {alpha}"
                );
            }
        }
    }

    #[test]
    fn totals_are_exact_once_the_population_is_seen() {
        let found = PairBudget::new(60).unwrap().possible(counts(60, 9, 4), 0.01).unwrap();
        assert_eq!(found, PairsPossible { least_net: 5, most_discordant: 13 });
        assert_eq!(found.most_favorable(60), counts(60, 9, 4));
        assert_eq!(RunBudget::new(40).unwrap().passes(31, 40, 0.01).unwrap(), (31, 31));
    }

    #[test]
    fn passes_equal_enumeration() {
        let ln = |n: u64, k: u64| if k > n { f64::NEG_INFINITY } else { ln_choose(n as f64, k as f64) };
        let (runs, alpha) = (RunBudget::new(40).unwrap(), 0.01);
        for seen in 0..=40 {
            for passed in 0..=seen {
                let ln_bar = (alpha / (seen as f64 + 1.0)).ln() - LN_SLACK;
                let possible = (0..=40_u64).filter(|total| {
                    ln(*total, passed) + ln(40 - total, seen - passed) - ln(40, seen) > ln_bar
                });
                let totals: Vec<u64> = possible.collect();
                let found = runs.passes(passed, seen, alpha).unwrap();
                assert_eq!(found, (totals[0], totals[totals.len() - 1]), "{passed}/{seen}");
            }
        }
    }

    #[test]
    fn population_bounds_refuse_bad_input() {
        assert!(PairBudget::new(0).is_err() && RunBudget::new(0).is_err());
        assert!(PairBudget::new(SAMPLES_MAX as u64 + 1).is_err());
        let (pairs, runs) = (PairBudget::new(10).unwrap(), RunBudget::new(10).unwrap());
        for seen in [counts(11, 0, 0), counts(3, 2, 2), counts(3, u64::MAX, 2)] {
            assert!(pairs.possible(seen, 0.05).is_err(), "{seen:?}");
        }
        assert!(runs.passes(2, 1, 0.05).is_err() && runs.passes(0, 11, 0.05).is_err());
        for alpha in [0.0, 1.0, f64::NAN, -0.1] {
            assert!(pairs.possible(counts(3, 1, 1), alpha).is_err(), "{alpha}");
            assert!(runs.passes(1, 3, alpha).is_err(), "{alpha}");
        }
    }

    proptest::proptest! {
        /// The true totals are never better than the favourable corner of a set that holds them.
        #[test]
        fn most_favorable_corner_bounds_every_possible_outcome(
            worse in 0u64..30, better in 0u64..30, same in 0u64..30, size in 90u64..200,
        ) {
            let seen = counts(worse + better + same, worse, better);
            let found = PairBudget::new(size).unwrap().possible(seen, 0.01).unwrap();
            let corner = found.most_favorable(size);
            proptest::prop_assert!(corner.candidate_only + corner.active_only <= size + 1);
            proptest::prop_assert_eq!(difference(corner.candidate_only, corner.active_only), found.least_net);
            proptest::prop_assert!(corner.candidate_only + corner.active_only >= found.most_discordant);
            let unseen = size - seen.pairs;
            proptest::prop_assert!(found.least_net >= difference(worse, better + unseen));
            proptest::prop_assert!(found.most_discordant <= worse + better + unseen);
            let wider = PairBudget::new(size).unwrap().possible(seen, 0.001).unwrap();
            proptest::prop_assert!(wider.least_net <= found.least_net);
            proptest::prop_assert!(wider.most_discordant >= found.most_discordant);
        }
    }
}
