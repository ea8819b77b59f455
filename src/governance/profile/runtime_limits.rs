//! The limits of a profile that guard, watcher and recovery enforce, whatever a manifest declares.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::later_numbers as later;
use crate::mode::ZoneName;

/// The limits that the guard enforces in every tick, whatever a manifest declares.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RuntimeLimits {
    /// Largest speed of the tool center point, m/s.
    pub tool_speed_max_m_s: f64,
    /// Largest force on the surroundings, N.
    pub contact_force_max_n: f64,
    /// Largest grip force per finger, N.
    pub grip_force_max_n: f64,
    /// Largest speed of any joint, rad/s.
    pub joint_speed_max_rad_s: f64,
    /// Most retries in one episode.
    pub retries_max: u32,
    /// Longest motion after a declared failure or a stop, ms.
    pub unsafe_continuation_max_ms: f64,
    /// Share of a limit from which a value counts as near it.
    pub near_margin: f64,
    /// Distance of the tool from a keep-out zone from which it counts as near it, m.
    pub near_zone_m: f64,
    /// Lowest corner of where the tool may be, world frame, m.
    pub workspace_min_m: [f64; 3],
    /// Highest corner of where the tool may be, world frame, m.
    pub workspace_max_m: [f64; 3],
    /// Zones the tool must keep out of.
    pub keep_out: BTreeSet<ZoneName>,
    /// Highest authority level granted without a review, 0 to 3.
    pub authority_max: u8,
    /// Most processor time a version may ask for, microseconds per tick.
    pub cpu_us_per_tick_max: u32,
    /// Most memory a version may ask for, KiB.
    pub memory_kib_max: u32,
    /// Longest an episode may take, simulated s; then it counts as timed out.
    pub episode_max_s: f64,
    /// How far ahead the guard predicts a collision, s.
    #[serde(default = "later::look_ahead_s", skip_serializing_if = "later::is_look_ahead_s")]
    pub look_ahead_s: f64,
    /// Share of a limit to which the guard clamps a command.
    #[serde(default = "later::clamp_share", skip_serializing_if = "later::is_clamp_share")]
    pub clamp_share: f64,
    /// Factor on the force limit that a transient contact may reach (ISO/TS 15066).
    #[serde(default = "later::transient_factor", skip_serializing_if = "later::is_transient_factor")]
    pub transient_factor: f64,
    /// Factor on a limit up to which a measured value is no violation.
    #[serde(default = "later::measure_share", skip_serializing_if = "later::is_measure_share")]
    pub measure_share: f64,
    /// Share of a limit above which a declared speed or force is of high risk.
    #[serde(default = "later::high_share", skip_serializing_if = "later::is_high_share")]
    pub high_share: f64,
    /// Height to which the retreat raises the tool, m.
    #[serde(default = "later::retreat_height_m", skip_serializing_if = "later::is_retreat_height_m")]
    pub retreat_height_m: f64,
    /// Height above which the tool counts as clear after the retreat, m.
    #[serde(default = "later::retreat_clear_m", skip_serializing_if = "later::is_retreat_clear_m")]
    pub retreat_clear_m: f64,
    /// Speed of the retreat, m/s.
    #[serde(default = "later::retreat_speed_m_s", skip_serializing_if = "later::is_retreat_speed_m_s")]
    pub retreat_speed_m_s: f64,
    /// Longest time of the retreat, s.
    #[serde(default = "later::retreat_max_s", skip_serializing_if = "later::is_retreat_max_s")]
    pub retreat_max_s: f64,
    /// Longest time from the interrupt to the standstill of every joint, s.
    #[serde(default = "later::interrupt_max_s", skip_serializing_if = "later::is_interrupt_max_s")]
    pub interrupt_max_s: f64,
    /// Farthest that the tool of a braked arm may creep by contact, m; an arm that creeps farther moves.
    #[serde(default = "later::creep_max_m", skip_serializing_if = "later::is_creep_max_m")]
    pub creep_max_m: f64,
    /// Time for which a measured force may be above its limit, s.
    #[serde(default = "later::transient_max_s", skip_serializing_if = "later::is_transient_max_s")]
    pub transient_max_s: f64,
    /// Time for which every command of a version may be denied, s; then its task ends in recovery.
    #[serde(default = "later::denied_max_s", skip_serializing_if = "later::is_denied_max_s")]
    pub denied_max_s: f64,
}

/// Tolerances beyond which the watcher raises a signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WatcherTolerances {
    /// Motion of the object in the hand, m.
    pub slip_max_m: f64,
    /// Distance of a joint from its servo target, rad.
    pub tracking_error_max_rad: f64,
    /// Age of the camera frame acted on, ms.
    pub picture_age_max_ms: f64,
    /// Time in which a failure has to be named, ms.
    pub detect_max_ms: f64,
    /// Force from which a contact is noticed, N.
    #[serde(default = "later::contact_noticed_n", skip_serializing_if = "later::is_contact_noticed_n")]
    pub contact_noticed_n: f64,
    /// Tool speed above which the arm counts as moving on its camera frames, m/s.
    #[serde(default = "later::moving_m_s", skip_serializing_if = "later::is_moving_m_s")]
    pub moving_m_s: f64,
    /// Grip force below which a hand that is commanded to close presses on nothing, N.
    #[serde(default = "later::idle_force_n", skip_serializing_if = "later::is_idle_force_n")]
    pub idle_force_n: f64,
    /// Pad distance up to which the hand counts as closed, m.
    #[serde(default = "later::closed_width_m", skip_serializing_if = "later::is_closed_width_m")]
    pub closed_width_m: f64,
    /// Difference to the measured width from which a commanded one opens or closes the hand, m.
    #[serde(default = "later::width_step_m", skip_serializing_if = "later::is_width_step_m")]
    pub width_step_m: f64,
}

impl RuntimeLimits {
    /// The ticks of one of these times.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 600 s, checked")]
    pub fn ticks(secs: f64) -> u32 {
        libm::round(secs * f64::from(holdpoint_body::RATE_HZ)) as u32
    }

    /// Ticks of the longest episode; also the most commands a task can send, one a tick.
    #[must_use]
    pub fn ticks_max(&self) -> u32 {
        Self::ticks(self.episode_max_s)
    }
}
