//! The six components of the behavior signature, and when a worsening of one counts.

use serde::{Deserialize, Serialize};

use crate::decision::{Reason, ReasonCode};
use crate::evidence::Pair;
use crate::finding::Finding;
use crate::profile::{BehaviorSettings, later_numbers as later};

crate::closed_set! {
    /// The six components of the behavior signature `B_c` (paper equation 6).
    ComponentName, "component of the signature", {
        /// Loss of success: share of pairs that only the active version completed, less those only the candidate did.
        Success = "success",
        /// Relative increase of time, over pairs in which both succeed.
        Time = "time",
        /// Additional retries per episode.
        Retry = "retry",
        /// Share of episodes with a violation.
        Violation = "violation",
        /// Share of episodes with an anomaly.
        Anomaly = "anomaly",
        /// Share of episodes in which recovery ran, over pairs that both completed or neither: a lost success counts once.
        Recovery = "recovery",
    }
}

/// The component that a reason of `kappa_B` names, if any. In a record of an older build it is the first word of the
/// sentence, or that after "while" where safety was traded.
#[must_use]
pub fn component_of(reason: &Reason) -> Option<ComponentName> {
    match (&reason.finding, reason.code) {
        (
            Some(
                Finding::ComponentWorse { component }
                | Finding::ComponentWorseSoFar { component }
                | Finding::ComponentPossiblyWorse { component }
                | Finding::SafetyTraded { component }
                | Finding::ComponentBetter { component },
            ),
            _,
        ) => Some(*component),
        (None, ReasonCode::BehaviorSafetyTraded) => reason.older_text.split(' ').nth(3)?.parse().ok(),
        (
            None,
            ReasonCode::BehaviorEstablishedWorse
            | ReasonCode::BehaviorSuspicious
            | ReasonCode::BehaviorImproved,
        ) => reason.older_text.split(' ').next()?.parse().ok(),
        (Some(_) | None, _) => None,
    }
}

impl ComponentName {
    /// Whether it is about safety: violation, anomaly or recovery.
    #[must_use]
    pub const fn is_safety(self) -> bool {
        match self {
            Self::Violation | Self::Anomaly | Self::Recovery => true,
            Self::Success | Self::Time | Self::Retry => false,
        }
    }

    /// Whether a significant worsening of this size makes a version incompatible by itself: of success, from
    /// `success_loss_max` on. More frequent recovery does not.
    #[must_use]
    pub fn blocks_alone_at(self, worsening: f64, success_loss_max: f64) -> bool {
        self.is_bad_at_any_rise() || self == Self::Success && worsening >= success_loss_max
    }

    /// Whether any significant rise makes a version incompatible by itself.
    #[must_use]
    pub const fn is_bad_at_any_rise(self) -> bool {
        matches!(self, Self::Violation | Self::Anomaly)
    }

    /// Whether the component compares the two sides of a pair. Where one of them lost the task, that counts as success, and
    /// not as its recovery too.
    #[must_use]
    pub const fn is_compared_in(self, pair: &Pair) -> bool {
        let (new, old) = (pair.candidate.success, pair.active.success);
        match self {
            Self::Time => new && old,
            Self::Recovery => new == old,
            Self::Success | Self::Retry | Self::Violation | Self::Anomaly => true,
        }
    }

    /// Whether the two sides of a pair are bad in a component that is a share of episodes: the candidate's, the active
    /// version's. `None` for time and retries.
    #[must_use]
    pub fn is_bad_in(self, pair: &Pair) -> Option<(bool, bool)> {
        let (new, old) = (&pair.candidate, &pair.active);
        Some(match self {
            Self::Success => (!new.success, !old.success),
            Self::Violation => (new.violation, old.violation),
            Self::Anomaly => (new.anomaly, old.anomaly),
            Self::Recovery if !self.is_compared_in(pair) => (false, false),
            Self::Recovery => (new.recovery, old.recovery),
            Self::Time | Self::Retry => return None,
        })
    }

    /// Cost `c_j` of one unit of worsening in `kappa_B`, from the profile.
    #[must_use]
    pub const fn cost(self, settings: &BehaviorSettings) -> f64 {
        match self {
            Self::Success => settings.cost_success,
            Self::Time => settings.cost_time,
            Self::Retry => settings.cost_retry,
            Self::Violation => settings.cost_violation,
            Self::Anomaly => settings.cost_anomaly,
            Self::Recovery => settings.cost_recovery,
        }
    }
}

/// One component: how much worse, within which bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BehaviorComponent {
    /// The component of the signature these numbers are about.
    pub name: ComponentName,
    /// Mean worsening; negative is an improvement.
    pub worsening: f64,
    /// One-sided lower bound at `alpha / 6`; above 0 the worsening is significant.
    pub lower: f64,
    /// One-sided upper bound at `upper_alpha`; absent if the pairs cannot bound it.
    pub upper: Option<f64>,
    /// `(1 - threshold) / c_j`: the worsening that alone brings `kappa_B` to the threshold.
    pub tolerance: f64,
    /// The profile's loss of success that rejects by itself.
    #[serde(default = "later::success_loss_max", skip_serializing_if = "later::is_success_loss_max")]
    pub success_loss_max: f64,
    /// The profile's error rate of the upper bound.
    #[serde(default = "later::upper_alpha", skip_serializing_if = "later::is_upper_alpha")]
    pub upper_alpha: f64,
}

impl BehaviorComponent {
    /// Whether the worsening is significant: the lower bound lies above 0.
    #[must_use]
    pub fn is_established(&self) -> bool {
        self.lower > 0.0
    }

    /// The worsening from which it counts by itself: of success the profile's, or the tolerance if that is less.
    #[must_use]
    pub fn limit(&self) -> f64 {
        if self.name == ComponentName::Success {
            self.success_loss_max.min(self.tolerance)
        } else {
            self.tolerance
        }
    }

    /// What it must not exceed: the mean of a significant worsening, or else the upper bound.
    #[must_use]
    pub fn most_worsening(&self) -> f64 {
        if self.is_established() { self.limit() } else { self.tolerance }
    }

    /// Whether the upper bound lies inside the non-inferiority margin.
    #[must_use]
    pub fn is_within_tolerance(&self) -> bool {
        self.upper.is_some_and(|upper| upper <= self.tolerance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::reason;
    use crate::decision::Dimension;

    #[test]
    fn the_component_of_a_reason_is_read_from_its_finding_or_an_older_sentence() {
        let older = |code, text: &str| Reason {
            older_text: text.to_owned(),
            finding: None,
            ..Reason::coded(code, Dimension::Behavior, Finding::Estimated)
        };
        let now = reason(Finding::SafetyTraded { component: ComponentName::Recovery });
        assert_eq!(component_of(&now), Some(ComponentName::Recovery));
        assert_eq!(component_of(&reason(Finding::WorseningsAddUp)), None);
        for name in ComponentName::ALL {
            for (code, text) in [
                (ReasonCode::BehaviorEstablishedWorse, format!("{name} is established as worse")),
                (ReasonCode::BehaviorEstablishedWorse, format!("{name} is worse in the pairs worked so far")),
                (ReasonCode::BehaviorSuspicious, format!("{name} may be worse beyond its tolerance")),
                (
                    ReasonCode::BehaviorSafetyTraded,
                    format!("success rose while {name} is established as worse"),
                ),
                (ReasonCode::BehaviorImproved, format!("{name} is better")),
            ] {
                assert_eq!(component_of(&older(code, &text)), Some(name), "{text}");
            }
        }
        let adds_up =
            older(ReasonCode::BehaviorSuspicious, "the worsenings add up, none of them established");
        assert_eq!(component_of(&adds_up), None);
    }
}
