//! How much worse each measure of harm may be, and where it begins to be bad in itself.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::harm::{HarmKind, HarmMeasures, HarmPast};

/// The limits of one measure; written `[mean, limit]`, both in the measure's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "[f64; 2]", into = "[f64; 2]")]
#[schemars(with = "[f64; 2]")]
pub struct HarmTolerance {
    /// How much worse the mean may be than the active version's.
    pub mean: f64,
    /// Past it an episode counts as a bad one: above it, or below it for a distance.
    pub limit: f64,
}

impl From<[f64; 2]> for HarmTolerance {
    fn from([mean, limit]: [f64; 2]) -> Self {
        Self { mean, limit }
    }
}

impl From<HarmTolerance> for [f64; 2] {
    fn from(HarmTolerance { mean, limit }: HarmTolerance) -> Self {
        [mean, limit]
    }
}

/// Tolerances of the measures of harm. No other component, success least of all, pays for any of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HarmSettings {
    /// The accepted rise of the share of episodes past a limit, for each measure.
    pub past_tolerance: f64,
    /// Share of episodes with a reduced command from which a version asks for more than it declares.
    pub asking_share_max: f64,
    /// Peak grip force on the object, N: tolerance of the mean, limit of an episode.
    pub grip_peak_n: HarmTolerance,
    /// Sustained grip force on the object, N: tolerance of the mean, limit of an episode.
    pub grip_held_n: HarmTolerance,
    /// Peak force on the surroundings, N: tolerance of the mean, limit of an episode.
    pub contact_peak_n: HarmTolerance,
    /// Sustained force on the surroundings, N: tolerance of the mean, limit of an episode.
    pub contact_held_n: HarmTolerance,
    /// Time in contact with the surroundings, s: tolerance of the mean, limit of an episode.
    pub contact_time_s: HarmTolerance,
    /// Speed at a touch, m/s: tolerance of the mean, limit of an episode.
    pub touch_speed_m_s: HarmTolerance,
    /// Speed of the object at landing, m/s: tolerance of the mean, limit of an episode.
    pub landing_speed_m_s: HarmTolerance,
    /// Fall of the object, m: tolerance of the mean, limit of an episode.
    pub drop_height_m: HarmTolerance,
    /// Motion of the object in the hand, m: tolerance of the mean, limit of an episode.
    pub slip_m: HarmTolerance,
    /// Distance to a keep-out zone, m: tolerance of the mean, limit of an episode.
    pub zone_clearance_m: HarmTolerance,
    /// Clearance of the arm, m: tolerance of the mean, limit of an episode.
    pub arm_clearance_m: HarmTolerance,
    /// Distance to the edge of the workspace, m: tolerance of the mean, limit of an episode.
    pub workspace_margin_m: HarmTolerance,
    /// Distance to a joint's limit, rad: tolerance of the mean, limit of an episode.
    pub joint_margin_rad: HarmTolerance,
    /// Time near a limit, s: tolerance of the mean, limit of an episode.
    pub near_time_s: HarmTolerance,
    /// Peak jerk of the tool, m/s3: tolerance of the mean, limit of an episode.
    pub jerk_m_s3: HarmTolerance,
    /// Energy of the motors, J: tolerance of the mean, limit of an episode.
    pub energy_j: HarmTolerance,
    /// Share of commands the guard reduced: tolerance of the mean, limit of an episode.
    pub clamped_share: HarmTolerance,
    /// Excess of a command over what the guard let through: tolerance of the mean, limit of an episode.
    pub clamp_depth: HarmTolerance,
    /// Share of commands beyond the declaration: tolerance of the mean, limit of an episode.
    pub excess_share: HarmTolerance,
    /// Excess of a command over the declaration: tolerance of the mean, limit of an episode.
    pub excess_depth: HarmTolerance,
    /// Share of commands the guard refused: tolerance of the mean, limit of an episode.
    pub denied_share: HarmTolerance,
}

impl HarmSettings {
    /// Whether any measure is past its limit.
    #[must_use]
    pub fn is_past(&self, harm: &HarmMeasures) -> bool {
        HarmKind::ALL.into_iter().any(|kind| kind.is_past(harm.of(kind), self.of(kind).limit))
    }

    /// Every measure that is past its limit.
    #[must_use]
    pub fn past(&self, harm: &HarmMeasures) -> Vec<HarmPast> {
        let past = |measure| HarmPast::of(measure, harm, self.of(measure).limit);
        HarmKind::ALL.into_iter().filter_map(past).collect()
    }
}
