//! The numbers guard and watcher work with, derived from a profile and a version's conditions.

use serde::{Deserialize, Serialize};

/// The least share of speed and force that an envelope is tightened to, so that an arm can still be moved clear. It is the
/// least that a profile may set as a share of them, too.
const SHARE_MIN: f64 = 0.05;

/// What the guard enforces at every tick, outside the skill. SI units, world frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope {
    /// The tool's highest speed, m/s.
    pub tool_speed_max_m_s: f64,
    /// The fastest joint's highest speed, rad/s.
    pub joint_speed_max_rad_s: f64,
    /// Force per finger, N.
    pub grip_force_max_n: f64,
    /// Force of the robot or the held object on its surroundings, N.
    pub contact_force_max_n: f64,
    /// Motion after a stop was demanded, ms.
    pub unsafe_continuation_max_ms: u64,
    /// Lowest corner of the workspace of the tool, m.
    pub workspace_min_m: [f64; 3],
    /// Highest corner of the workspace of the tool, m.
    pub workspace_max_m: [f64; 3],
    /// Share of a limit from which a measured value counts as a near violation.
    pub near_share: f64,
    /// Distance of the tool from a keep-out zone from which it counts as near it, m.
    pub near_zone_m: f64,
    /// New attempts a version may make in one task.
    pub retries_max: u32,
}

impl Envelope {
    /// The same envelope with tool speed and grip force capped. The joints' speed shrinks with the tool's.
    #[must_use]
    pub fn capped(mut self, speed_max_m_s: f64, force_max_n: f64) -> Self {
        let share = (speed_max_m_s / self.tool_speed_max_m_s).clamp(0.0, 1.0);
        self.joint_speed_max_rad_s *= share;
        self.tool_speed_max_m_s = self.tool_speed_max_m_s.min(speed_max_m_s);
        self.grip_force_max_n = self.grip_force_max_n.min(force_max_n);
        self
    }

    /// The envelope of a version that was admitted with restrictions.
    ///
    /// Speed and force are multiplied by `share`, which lies in (0, 1].
    #[must_use]
    pub fn tightened(mut self, share: f64) -> Self {
        let share = if share.is_finite() { share.clamp(SHARE_MIN, 1.0) } else { SHARE_MIN };
        self.tool_speed_max_m_s *= share;
        self.joint_speed_max_rad_s *= share;
        self.grip_force_max_n *= share;
        self.contact_force_max_n *= share;
        self
    }
}

/// What the watcher compares telemetry with.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WatchLimits {
    /// Motion of the object in the hand, m.
    pub slip_max_m: f64,
    /// Distance of a joint from its servo target, rad.
    pub tracking_max_rad: f64,
    /// Force from which a contact is noticed, N.
    pub contact_noticed_n: f64,
    /// Age of the newest camera frame while the arm moves, ticks.
    pub picture_age_max_ticks: u32,
    /// How long a commanded gripper may do nothing, ticks.
    pub grip_fault_ticks: u32,
    /// Duration from which a task counts as overrun, ticks.
    pub overrun_ticks: u64,
    /// Tool speed above which the arm counts as moving on its camera frames, m/s.
    pub moving_m_s: f64,
    /// Grip force below which a hand that is commanded to close presses on nothing, N.
    pub idle_force_n: f64,
    /// Pad distance up to which the hand counts as closed, m.
    pub closed_width_m: f64,
    /// A commanded width that differs by less from the measured one, m, neither opens nor closes the hand.
    pub width_step_m: f64,
}

#[cfg(test)]
mod tests {
    use holdpoint_body::RATE_HZ;

    use super::*;

    /// The limits that tests use.
    impl Default for WatchLimits {
        fn default() -> Self {
            Self {
                slip_max_m: 0.005,
                tracking_max_rad: 0.05,
                contact_noticed_n: 2.0,
                picture_age_max_ticks: RATE_HZ / 2,
                grip_fault_ticks: RATE_HZ,
                overrun_ticks: 12 * u64::from(RATE_HZ),
                moving_m_s: 0.03,
                idle_force_n: 0.5,
                closed_width_m: 0.004,
                width_step_m: 0.002,
            }
        }
    }

    #[test]
    fn nan_share_gives_the_tightest_envelope() {
        let envelope = Envelope {
            tool_speed_max_m_s: 1.0,
            joint_speed_max_rad_s: 2.0,
            grip_force_max_n: 60.0,
            contact_force_max_n: 60.0,
            unsafe_continuation_max_ms: 500,
            workspace_min_m: [0.0; 3],
            workspace_max_m: [1.0; 3],
            near_share: 0.9,
            near_zone_m: 0.02,
            retries_max: 3,
        };
        for (share, speed) in [(0.5, 0.5), (1.0, 1.0), (7.0, 1.0), (0.0, 0.05), (f64::NAN, 0.05)] {
            assert!((envelope.tightened(share).tool_speed_max_m_s - speed).abs() < 1e-12, "{share}");
        }
    }
}
