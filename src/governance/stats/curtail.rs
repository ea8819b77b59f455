//! When a fixed rule over N runs may be decided early.
//!
//! [`PassRule::curtail`] is exact: its decision equals the full run's, in any order. [`PassRule::ppr`] is faster:
//! it needs a pre-committed random order and differs from the full run with probability at most alpha
//! (prior-posterior-ratio martingale for sampling without replacement, Waudby-Smith & Ramdas 2020,
//! arXiv 2006.04347, uniform prior).

use serde::{Deserialize, Serialize};

use super::special::ln_choose;
use super::{SAMPLES_MAX, StatsError, open_unit};

/// The present knowledge of the rule's outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurtailVerdict {
    /// The full run would pass.
    Pass,
    /// The full run would fail.
    Fail,
    /// The runs seen do not decide yet; continue.
    Open,
}

/// Runs seen so far and their decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curtailment {
    /// The decision of the runs seen so far.
    pub verdict: CurtailVerdict,
    /// Runs seen when it was decided.
    pub seen: u64,
    /// Runs of the full number that were not needed.
    pub saved: u64,
}

/// "Pass if at least `needed` of `runs` succeed."
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "PassRuleText")]
pub struct PassRule {
    runs: u64,
    needed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PassRuleText {
    runs: u64,
    needed: u64,
}

impl TryFrom<PassRuleText> for PassRule {
    type Error = StatsError;
    fn try_from(text: PassRuleText) -> Result<Self, StatsError> {
        Self::new(text.runs, text.needed)
    }
}

impl PassRule {
    /// The rule "at least `needed` of `runs`".
    ///
    /// # Errors
    /// No runs, too many, or more needed than there are.
    pub fn new(runs: u64, needed: u64) -> Result<Self, StatsError> {
        if runs == 0 {
            return Err(StatsError::TooFew { got: 0, needed: 1 });
        }
        if runs > SAMPLES_MAX as u64 {
            let got = usize::try_from(runs).unwrap_or(usize::MAX);
            return Err(StatsError::TooMany { got, limit: SAMPLES_MAX });
        }
        if needed > runs {
            return Err(StatsError::Counts { count: needed, total: runs });
        }
        Ok(Self { runs, needed })
    }

    /// The full number of runs.
    #[must_use]
    pub const fn runs(self) -> u64 {
        self.runs
    }

    /// Successes at which the rule passes.
    #[must_use]
    pub const fn needed(self) -> u64 {
        self.needed
    }

    /// Decides as soon as the remaining runs can no longer change the outcome.
    ///
    /// # Errors
    /// More successes than runs seen, or more seen than the rule has.
    pub fn curtail(self, successes: u64, seen: u64) -> Result<Curtailment, StatsError> {
        self.check(successes, seen)?;
        let failures = seen - successes;
        let verdict = if successes >= self.needed {
            CurtailVerdict::Pass
        } else if failures > self.runs - self.needed {
            CurtailVerdict::Fail
        } else {
            CurtailVerdict::Open
        };
        Ok(self.answer(verdict, seen))
    }

    /// Decides as soon as the other outcome is excluded at `alpha`; the order of runs must be random and
    /// committed to before the first one. Exact certainty decides here too.
    ///
    /// # Errors
    /// As [`PassRule::curtail`], or `alpha` outside (0, 1).
    pub fn ppr(self, successes: u64, seen: u64, alpha: f64) -> Result<Curtailment, StatsError> {
        open_unit("alpha", alpha)?;
        let exact = self.curtail(successes, seen)?;
        if exact.verdict != CurtailVerdict::Open {
            return Ok(exact);
        }
        // Total K is excluded if L(K) <= alpha / (t + 1), L the hypergeometric likelihood of what was seen.
        let ln_bar = libm::log(alpha / (seen as f64 + 1.0));
        let possible = |total: u64| self.ln_likelihood(total, successes, seen) > ln_bar;
        let verdict = match ((self.needed..=self.runs).any(possible), (0..self.needed).any(possible)) {
            (true, false) => CurtailVerdict::Pass,
            (false, true) => CurtailVerdict::Fail,
            (true, true) | (false, false) => CurtailVerdict::Open,
        };
        Ok(self.answer(verdict, seen))
    }

    fn ln_likelihood(self, total: u64, successes: u64, seen: u64) -> f64 {
        let (all, failures) = (self.runs, seen - successes);
        if successes > total || failures > all - total {
            return f64::NEG_INFINITY;
        }
        let ln = |n: u64, k: u64| ln_choose(n as f64, k as f64);
        ln(total, successes) + ln(all - total, failures) - ln(all, seen)
    }

    fn check(self, successes: u64, seen: u64) -> Result<(), StatsError> {
        if successes > seen {
            return Err(StatsError::Counts { count: successes, total: seen });
        }
        if seen > self.runs {
            return Err(StatsError::Counts { count: seen, total: self.runs });
        }
        Ok(())
    }

    fn answer(self, verdict: CurtailVerdict, seen: u64) -> Curtailment {
        let saved = if verdict == CurtailVerdict::Open { 0 } else { self.runs - seen };
        Curtailment { verdict, seen, saved }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curtailment_reproduces_worked_values() {
        let rule = PassRule::new(150, 135).unwrap();
        for (successes, seen, verdict) in [
            (0, 0, CurtailVerdict::Open),
            (0, 15, CurtailVerdict::Open),
            (0, 16, CurtailVerdict::Fail),
            (134, 149, CurtailVerdict::Open),
            (135, 135, CurtailVerdict::Pass),
            (134, 150, CurtailVerdict::Fail),
        ] {
            assert_eq!(rule.curtail(successes, seen).unwrap().verdict, verdict, "{successes}/{seen}");
        }
        // Reference run: the published means for p = 1 are 51 (alpha 0.05) and 72 (alpha 0.001) runs.
        for (alpha, expected) in [(0.05, 51), (0.001, 72)] {
            let first = (0..=150).find(|&t| rule.ppr(t, t, alpha).unwrap().verdict == CurtailVerdict::Pass);
            assert_eq!(first, Some(expected), "{alpha}");
        }
        assert!(rule.curtail(2, 1).is_err() && rule.curtail(0, 151).is_err());
        assert!(rule.ppr(1, 1, 0.0).is_err() && rule.ppr(1, 1, f64::NAN).is_err());
        assert!(PassRule::new(0, 0).is_err() && PassRule::new(3, 4).is_err());
        assert!(serde_json::from_str::<PassRule>(r#"{"runs":3,"needed":4}"#).is_err());
    }

    proptest::proptest! {
        #[test]
        fn curtailed_decision_equals_the_full_one(outcomes in proptest::collection::vec(proptest::bool::ANY, 1..80), needed in 0u64..80) {
            let runs = outcomes.len() as u64;
            let rule = PassRule::new(runs, needed.min(runs)).unwrap();
            let total = outcomes.iter().filter(|ok| **ok).count() as u64;
            let full = if total >= rule.needed() { CurtailVerdict::Pass } else { CurtailVerdict::Fail };
            let mut successes = 0;
            let mut decided = None;
            for (seen, ok) in outcomes.iter().enumerate() {
                successes += u64::from(*ok);
                let verdict = rule.curtail(successes, seen as u64 + 1).unwrap().verdict;
                if verdict != CurtailVerdict::Open {
                    proptest::prop_assert_eq!(verdict, full);
                    decided = Some(verdict);
                }
            }
            proptest::prop_assert_eq!(decided, Some(full));
        }
    }
}
