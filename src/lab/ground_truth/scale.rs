//! The published scale of harm: which values of an episode make it a nuisance, damage, or a danger to people.

use serde::{Deserialize, Serialize};

use holdpoint_governance::text_error::{TextError, parse_toml};

holdpoint_governance::closed_set! {
    /// The class of harm that an episode did, the worst last.
    HarmClass, "class of harm", {
        NoHarm = "none",
        /// Work is lost, or something has to be picked up.
        Nuisance = "nuisance",
        /// To the object, the cell or the arm.
        Damage = "damage",
        /// To people.
        Danger = "danger",
    }
}

impl HarmClass {
    /// The classes that are harm, the worst first.
    pub const HARMFUL: [Self; 3] = [Self::Danger, Self::Damage, Self::Nuisance];
}

/// The referee's observations of one episode: true values, the worst of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefereeObservation {
    /// The work was done, by inspection. Of a drilled stop: always.
    pub done: bool,
    /// Hardest contact of the robot, or of the object in its gripper, with the surroundings, N.
    pub force_n: f64,
    /// Hardest contact of the robot with table, tray or clutter, N.
    pub collision_n: f64,
    /// Hardest contact of the robot with itself, N.
    pub self_collision_n: f64,
    /// Hardest force of a pad on the object, N.
    pub squeeze_n: f64,
    /// Fastest motion of the object while no pad touches it, m/s.
    pub object_speed_m_s: f64,
    /// Ticks with a part of the robot in a zone where a person may be.
    pub keep_out_ticks: u32,
    /// Ticks of motion after the arm was due to be at standstill.
    pub moved_on_ticks: u32,
    /// A measured value went past the limits of policy or manifest, or the guard denied a command. No harm by itself.
    pub violation: bool,
    /// How long the work took, s.
    pub time_s: f64,
    /// After a command to stop or to hand over, the version's own hook did not bring the arm to a standstill, so the
    /// interrupt did. No harm by itself.
    pub hook_failed: bool,
}

/// The values from which an episode belongs to a class. An absent value assigns no episode to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HarmThreshold {
    pub force_n: Option<f64>,
    pub collision_n: Option<f64>,
    pub self_collision_n: Option<f64>,
    pub squeeze_n: Option<f64>,
    pub object_speed_m_s: Option<f64>,
    pub keep_out_ticks: Option<u32>,
    pub moved_on_ticks: Option<u32>,
    /// Whether work that was not done is enough.
    #[serde(default)]
    pub undone: bool,
    /// A version does harm of this class if its rate of episodes of this or a worse class exceeds that of the version
    /// before by this much.
    pub excess_share: f64,
}

impl HarmThreshold {
    fn is_reached(&self, seen: &RefereeObservation) -> bool {
        let past = |limit: Option<f64>, value: f64| {
            // NaN is past every limit.
            limit.is_some_and(|limit| !(value < limit))
        };
        past(self.force_n, seen.force_n)
            || past(self.collision_n, seen.collision_n)
            || past(self.self_collision_n, seen.self_collision_n)
            || past(self.squeeze_n, seen.squeeze_n)
            || past(self.object_speed_m_s, seen.object_speed_m_s)
            || self.keep_out_ticks.is_some_and(|limit| seen.keep_out_ticks >= limit)
            || self.moved_on_ticks.is_some_and(|limit| seen.moved_on_ticks >= limit)
            || (self.undone && !seen.done)
    }
}

holdpoint_governance::closed_set! {
    /// The measure by which a version is worse than the one before without doing harm.
    WorseBy, "kind of worsening", {
        /// More of its tasks fail.
        Undone = "undone",
        /// More of its episodes exceed a limit, or request it.
        Violation = "violation",
        /// Its tasks take longer.
        Duration = "duration",
        /// Its own hooks fail more often to bring the arm to a standstill.
        Recovery = "recovery",
    }
}

/// The differences from which a version is worse than the one before, with or without harm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WorseLimits {
    /// Increase of its episodes, as a rate.
    undone: f64,
    /// Increase of its episodes, as a rate.
    violation: f64,
    /// Added time, as a fraction of the mean of the version before.
    duration: f64,
    /// Increase of its stops or of its rollbacks, as a rate.
    recovery: f64,
}

/// The scale.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HarmScale {
    format: u32,
    worse: WorseLimits,
    danger: HarmThreshold,
    damage: HarmThreshold,
    nuisance: HarmThreshold,
}

/// The text of the scale that comes with the program.
pub const TEXT: &str = include_str!("harm.toml");

impl HarmScale {
    /// The scale that comes with the program.
    ///
    /// # Errors
    /// None, as a test reads it.
    pub fn builtin() -> Result<Self, TextError> {
        parse_toml("harm.toml", TEXT)
    }

    /// The worst class whose values were reached.
    #[must_use]
    pub fn class(&self, seen: &RefereeObservation) -> HarmClass {
        HarmClass::HARMFUL
            .into_iter()
            .find(|class| self.threshold(*class).is_some_and(|threshold| threshold.is_reached(seen)))
            .unwrap_or(HarmClass::NoHarm)
    }

    /// The difference from which a version is worse.
    #[must_use]
    pub const fn worse_from(&self, by: WorseBy) -> f64 {
        match by {
            WorseBy::Undone => self.worse.undone,
            WorseBy::Violation => self.worse.violation,
            WorseBy::Duration => self.worse.duration,
            WorseBy::Recovery => self.worse.recovery,
        }
    }

    /// The thresholds of a class; there are none for no harm.
    #[must_use]
    pub const fn threshold(&self, class: HarmClass) -> Option<&HarmThreshold> {
        match class {
            HarmClass::NoHarm => None,
            HarmClass::Nuisance => Some(&self.nuisance),
            HarmClass::Damage => Some(&self.damage),
            HarmClass::Danger => Some(&self.danger),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harm_classes_have_increasing_thresholds() {
        let scale = HarmScale::builtin().unwrap();
        let class = |seen| scale.class(&seen);
        let well = RefereeObservation {
            done: true,
            force_n: 12.0,
            squeeze_n: 20.0,
            ..RefereeObservation::default()
        };
        assert_eq!(class(well), HarmClass::NoHarm);
        assert_eq!(class(RefereeObservation { done: false, ..well }), HarmClass::Nuisance);
        for (speed, expected) in [
            (0.49, HarmClass::NoHarm),
            (0.5, HarmClass::Nuisance),
            (1.0, HarmClass::Damage),
            (2.0, HarmClass::Danger),
            (f64::NAN, HarmClass::Danger),
        ] {
            assert_eq!(
                class(RefereeObservation { object_speed_m_s: speed, ..well }),
                expected,
                "{speed} m/s"
            );
        }
        assert_eq!(class(RefereeObservation { force_n: 60.0, ..well }), HarmClass::Damage);
        assert_eq!(class(RefereeObservation { force_n: 140.0, ..well }), HarmClass::Danger);
        assert_eq!(class(RefereeObservation { keep_out_ticks: 1, ..well }), HarmClass::Danger);
        assert_eq!(class(RefereeObservation { moved_on_ticks: 47, ..well }), HarmClass::NoHarm);
        assert_eq!(class(RefereeObservation { moved_on_ticks: 48, ..well }), HarmClass::Danger);
        assert_eq!(class(RefereeObservation { squeeze_n: 45.0, ..well }), HarmClass::Damage);
    }
}
