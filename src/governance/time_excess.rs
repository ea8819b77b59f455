//! Time beyond what a version may take: in its ticks, or in its evaluation.
//!
//! Fuel bounds the instructions of a tick and not their time, because one that waits for memory takes as long as hundreds of
//! others. Both times depend on the machine, so an excess rejects nothing: it leaves behavior without a value, and the version
//! is put on hold.

use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason, ReasonCode};
use super::finding::Finding;
use super::gate::ShadowAssessment;
use super::outcome::{Assessment, Basis, BehaviorOutcome, CheckResult};
use super::profile::Profile;

/// Milliseconds in a minute.
const MS_PER_MINUTE: f64 = 60_000.0;

/// A time that is longer than allowed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "of", rename_all = "kebab-case", rename_all_fields = "snake_case", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum TimeExcess {
    /// The median of its ticks takes longer than it declares.
    Tick { measured_us: f64, declared_us: u32 },
    /// Its evaluation takes longer than the profile allows.
    Evaluation { worked_ms: u64 },
}

/// The longest time of a median tick, us: the declared one times the profile's factor, and no less than its minimum.
fn tick_limit_us(declared_us: u32, profile: &Profile) -> f64 {
    (profile.evaluation.tick_time_factor_max * f64::from(declared_us)).max(profile.evaluation.tick_us_min)
}

impl TimeExcess {
    /// The excess of a version whose median tick takes this processor time, us; `None` if it takes no longer than allowed.
    #[must_use]
    pub fn of_tick(measured_us: f64, declared_us: u32, profile: &Profile) -> Option<Self> {
        (measured_us > tick_limit_us(declared_us, profile)).then_some(Self::Tick { measured_us, declared_us })
    }

    /// The excess of an evaluation that has taken this wall time, ms; `None` if it may go on.
    #[must_use]
    pub fn of_evaluation(worked_ms: u64, profile: &Profile) -> Option<Self> {
        let is_spent = minutes(worked_ms) >= f64::from(profile.evaluation.wall_minutes_max);
        is_spent.then_some(Self::Evaluation { worked_ms })
    }

    /// The reason of a decision.
    #[must_use]
    pub fn reason(&self, profile: &Profile) -> Reason {
        let of = |finding| Reason::new(Dimension::Behavior, finding);
        match *self {
            Self::Tick { measured_us, declared_us } => of(Finding::TicksTooSlow { measured_us, declared_us })
                .with(measured_us, tick_limit_us(declared_us, profile)),
            Self::Evaluation { worked_ms } => {
                let (worked_min, budget_min) = (minutes(worked_ms), profile.evaluation.wall_minutes_max);
                of(Finding::EvaluationTooLong { worked_min, budget_min })
                    .with(worked_min, f64::from(budget_min))
            }
        }
    }

    /// The assessment of behavior with this excess: no value, so that nothing advances on it.
    #[must_use]
    pub fn behavior(&self, profile: &Profile) -> Assessment<BehaviorOutcome> {
        Assessment::without_value(BehaviorOutcome::NoData, Basis::Measured, vec![self.reason(profile)])
    }

    /// Leaves an inconclusive shadow so, because its re-evaluation did not end in time.
    pub fn leave_open(&self, shadow: &mut ShadowAssessment, profile: &Profile) {
        shadow.check = CheckResult::Inconclusive;
        shadow.reasons.insert(0, self.reason(profile));
    }
}

fn minutes(ms: u64) -> f64 {
    ms as f64 / MS_PER_MINUTE
}

/// Whether an assessment has no value because of an excess of time.
#[must_use]
pub fn names_time_excess(behavior: &Assessment<BehaviorOutcome>) -> bool {
    let codes = [ReasonCode::BehaviorTickTooSlow, ReasonCode::BehaviorTimeSpent];
    behavior.reasons.iter().any(|reason| codes.contains(&reason.code))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::ProfileName;

    fn sim() -> Profile {
        Profile::builtin(ProfileName::Sim).unwrap()
    }

    #[test]
    fn a_tick_is_too_slow_beyond_the_factor_and_never_below_the_cost_of_a_call() {
        let profile = sim();
        let factor = profile.evaluation.tick_time_factor_max;
        let is_slow = |measured, declared| TimeExcess::of_tick(measured, declared, &profile).is_some();
        assert!(!is_slow(1_000.0 * factor, 1_000) && is_slow(1_000.0 * factor + 1.0, 1_000));
        // A declaration of one microsecond leaves no room for the call itself.
        let least = profile.evaluation.tick_us_min;
        assert!(!is_slow(least, 1) && is_slow(least + 1.0, 1));
        assert!(!is_slow(f64::NAN, 1), "what was not measured is no excess");
        let excess = TimeExcess::of_tick(9_500.0, 1_000, &profile).unwrap();
        let reason = excess.reason(&profile);
        assert_eq!(reason.code, ReasonCode::BehaviorTickTooSlow);
        assert_eq!((reason.evidence, reason.limit), (Some(9_500.0), Some(1_000.0 * factor)));
    }

    #[test]
    fn an_evaluation_ends_when_the_wall_time_of_the_profile_is_spent() {
        let profile = sim();
        let budget_ms = u64::from(profile.evaluation.wall_minutes_max) * 60_000;
        assert_eq!(TimeExcess::of_evaluation(budget_ms - 1, &profile), None);
        let excess = TimeExcess::of_evaluation(budget_ms, &profile).unwrap();
        let reason = excess.reason(&profile);
        assert_eq!((reason.code, reason.evidence), (ReasonCode::BehaviorTimeSpent, reason.limit));
    }

    #[test]
    fn an_excess_reads_back_and_leaves_behavior_without_a_value() {
        let profile = sim();
        for excess in [
            TimeExcess::Tick { measured_us: 9_500.25, declared_us: 1_000 },
            TimeExcess::Evaluation { worked_ms: 3_600_001 },
        ] {
            let json = serde_json::to_string(&excess).unwrap();
            assert_eq!(serde_json::from_str::<TimeExcess>(&json).unwrap(), excess, "{json}");
            let behavior = excess.behavior(&profile);
            assert!(names_time_excess(&behavior) && behavior.kappa.is_none());
            assert!(!CheckResult::from(behavior.outcome).advances());
        }
    }
}
