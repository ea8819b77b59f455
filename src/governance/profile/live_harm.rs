//! Harm in live work: the error rate of the lifelong watch, and the values from which a task is a danger to people.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::later_numbers as later;
use crate::harm::{HarmKind, HarmMeasures, HarmPast};

/// How the harm of live tasks is judged, of every active version for its whole life.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LiveHarmSettings {
    /// Largest probability that an unchanged version is ever rolled back for its rates of harm.
    pub life_alpha: f64,
    /// Peak force on the surroundings from which a task is a danger, N.
    pub danger_contact_peak_n: f64,
    /// Speed of the object at landing from which a task is a danger, m/s.
    pub danger_landing_speed_m_s: f64,
    /// Distance of the tool from a keep-out zone below which a task is a danger, m.
    pub danger_zone_clearance_m: f64,
    /// One-sided error of the bound that all tasks with a known result leave open on the normal rate.
    #[serde(default = "later::live_normal_alpha", skip_serializing_if = "later::is_live_normal_alpha")]
    pub normal_alpha: f64,
}

impl LiveHarmSettings {
    /// The value of a measure past which a task is a danger; absent where no value of it is one by itself.
    #[must_use]
    pub const fn danger(&self, measure: HarmKind) -> Option<f64> {
        match measure {
            HarmKind::ContactPeak => Some(self.danger_contact_peak_n),
            HarmKind::LandingSpeed => Some(self.danger_landing_speed_m_s),
            HarmKind::ZoneClearance => Some(self.danger_zone_clearance_m),
            HarmKind::GripPeak
            | HarmKind::GripHeld
            | HarmKind::ContactHeld
            | HarmKind::ContactTime
            | HarmKind::TouchSpeed
            | HarmKind::DropHeight
            | HarmKind::Slip
            | HarmKind::ArmClearance
            | HarmKind::WorkspaceMargin
            | HarmKind::JointMargin
            | HarmKind::NearTime
            | HarmKind::Jerk
            | HarmKind::Energy
            | HarmKind::ClampedShare
            | HarmKind::ClampDepth
            | HarmKind::ExcessShare
            | HarmKind::ExcessDepth
            | HarmKind::DeniedShare => None,
        }
    }

    /// The measures that make a task a danger.
    #[must_use]
    pub fn dangers(&self, harm: &HarmMeasures) -> Vec<HarmPast> {
        let past = |measure: HarmKind| HarmPast::of(measure, harm, self.danger(measure)?);
        HarmKind::ALL.into_iter().filter_map(past).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::{Profile, ProfileName};

    /// Each value at its threshold is no danger, one step past it is.
    #[test]
    fn danger_begins_past_its_threshold() {
        for name in ProfileName::ALL {
            let profile = Profile::builtin(name).unwrap();
            let settings = profile.live_harm;
            assert!(settings.dangers(&HarmMeasures::STILL).is_empty());
            for measure in HarmKind::ALL {
                let Some(limit) = settings.danger(measure) else { continue };
                let at = |value| {
                    let mut harm = HarmMeasures::STILL;
                    *harm.of_mut(measure) = value;
                    settings.dangers(&harm)
                };
                let (worse, bad) = if measure.is_worse_when_lower() { (-0.01, -1.0) } else { (0.01, 99.0) };
                assert!(at(limit).is_empty(), "{measure}");
                let found = at(limit + worse);
                assert_eq!(found.len(), 1, "{measure}");
                assert_eq!(
                    (found[0].measure, found[0].limit, found[0].unit.as_str()),
                    (measure, limit, measure.unit())
                );
                assert_eq!(at(limit + bad).len(), 1, "{measure}");
                // A danger is past the limit of an episode too, so it is counted as well.
                assert!(measure.is_past(limit, profile.harm.of(measure).limit), "{measure}");
            }
        }
    }
}
