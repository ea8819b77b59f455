//! What the three native controllers share: poses with the hand pointing down, averages of camera frames, arrival
//! tests and the behavior of the hooks.

use holdpoint_body::{Command, Estimate, Observation, Pose, TICK_SECS};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Hook;
use std::f64::consts::{FRAC_PI_2, PI};

/// Below this pad distance the hand is empty, m.
pub const EMPTY_WIDTH_M: f64 = 0.012;

/// Half the edge of the object, m: its center rests this far above its support.
pub const OBJECT_HALF_M: f64 = 0.025;

/// Tool pose at a point with the hand straight down and the pads turned by `yaw_rad`.
#[must_use]
pub fn hand_down(position: [f64; 3], yaw_rad: f64) -> Pose {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    Pose::from(&Isometry3::from_parts(Translation3::from(position), turn * down))
}

/// The same pose at another height.
#[must_use]
pub const fn at_height(pose: Pose, height_m: f64) -> Pose {
    let [x, y, _] = pose.position;
    Pose { position: [x, y, height_m], rotation: pose.rotation }
}

/// Heading of a body's x axis about the vertical, rad.
#[must_use]
pub fn yaw_of(pose: &Pose) -> f64 {
    let x = pose.isometry().rotation * Vector3::x();
    libm::atan2(x.y, x.x)
}

/// An angle reduced to within an eighth of a turn, by the square object's symmetry.
#[must_use]
pub fn wrap_quarter(angle_rad: f64) -> f64 {
    angle_rad - libm::round(angle_rad / FRAC_PI_2) * FRAC_PI_2
}

/// Mean of several measurements of one square object.
#[derive(Clone, Debug, Default)]
pub struct PoseAverage {
    last_sequence: Option<u32>,
    count: u32,
    sum: [f64; 3],
    // Headings are averaged on the circle of quarter turns.
    sum_sin: f64,
    sum_cos: f64,
}

impl PoseAverage {
    /// Adds a measurement unless it was added before; returns whether it is new.
    pub fn add(&mut self, seen: &Estimate) -> bool {
        if self.last_sequence == Some(seen.sequence) {
            return false;
        }
        self.last_sequence = Some(seen.sequence);
        self.count += 1;
        for (sum, value) in self.sum.iter_mut().zip(seen.pose.position) {
            *sum += value;
        }
        let four_yaw = 4.0 * yaw_of(&seen.pose);
        self.sum_sin += libm::sin(four_yaw);
        self.sum_cos += libm::cos(four_yaw);
        true
    }

    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Mean position and heading (within an eighth of a turn); absent before the first picture.
    #[must_use]
    pub fn mean(&self) -> Option<([f64; 3], f64)> {
        (self.count > 0).then(|| {
            let n = f64::from(self.count);
            (self.sum.map(|sum| sum / n), libm::atan2(self.sum_sin, self.sum_cos) / 4.0)
        })
    }
}

/// Whether the tool stands at a pose: within `tolerance_m` and slower than 2 cm/s.
#[must_use]
pub fn arrived(seen: &Observation, target: &Pose, tolerance_m: f64) -> bool {
    seen.tool.distance_m(target) <= tolerance_m
        && seen.tool_twist.speed_m_s() < 0.02
        && seen.tool.isometry().rotation.angle_to(&target.isometry().rotation) < 0.02
}

/// Whether the pads hold something: they are apart and pressed.
#[must_use]
pub fn holds_something(seen: &Observation) -> bool {
    seen.gripper_width_m > EMPTY_WIDTH_M && seen.gripper_force_n > 1.0
}

/// Ticks in a span of seconds.
#[must_use]
pub fn ticks(secs: f64) -> u64 {
    // Parameters are validated to lie within minutes; the cast cannot lose anything that matters.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let ticks = libm::round(secs.max(0.0) / TICK_SECS) as u64;
    ticks
}

/// What a controller does when an abort is requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AbortStyle {
    /// Brake, keep the grip, stay.
    Hold,
    /// Brake, keep the grip, then rise slowly to the safe height.
    Retract,
    /// Open the hand at once.
    Release,
    /// No hook: carry on.
    None,
}

/// What a controller does when its predecessor is to take over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RollbackStyle {
    /// Rise to the handover height, keeping the grip.
    Handover,
    /// Bring the hand to the handover height from above too, keeping the grip: with a low one the arm rests.
    Lower,
    /// Leave the arm wherever it is.
    Stay,
    None,
}

/// The hooks of a controller, once one of them has been entered.
#[derive(Clone, Debug)]
pub enum HookRun {
    /// Aborting in a style; the tick it began at and whether the rise was commanded.
    Abort(AbortStyle, Option<u64>),
    /// Handing over in a style.
    Rollback(RollbackStyle, Option<u64>),
}

impl HookRun {
    /// A hook that is entered now, in the style the version has for it.
    #[must_use]
    pub const fn begin(hook: Hook, abort: AbortStyle, rollback: RollbackStyle) -> Self {
        match hook {
            Hook::SafeAbort => Self::Abort(abort, None),
            Hook::Rollback => Self::Rollback(rollback, None),
        }
    }

    /// One decision of the hook. `safe_height_m` is where a rise ends, `speed_m_s` how fast.
    pub fn tick(&mut self, seen: &Observation, safe_height_m: f64, speed_m_s: f64) -> Command {
        let rise_after = ticks(0.15);
        let rise = at_height(seen.tool, safe_height_m);
        match self {
            Self::Abort(AbortStyle::None, _) => Command::Hold,
            Self::Abort(AbortStyle::Release, began) => {
                let first = began.is_none();
                began.get_or_insert(seen.tick);
                if first {
                    Command::Gripper { width_m: 0.08, speed_m_s: 0.2, force_n: 20.0 }
                } else {
                    Command::Stop
                }
            }
            Self::Abort(style, began) => {
                let since = seen.tick - *began.get_or_insert(seen.tick);
                match (*style, since) {
                    (AbortStyle::Retract, s) if s == rise_after && seen.tool.position[2] < safe_height_m => {
                        Command::ToolPose { pose: rise, max_speed_m_s: speed_m_s }
                    }
                    (_, s) if s < rise_after => Command::Stop,
                    _ => Command::Hold,
                }
            }
            Self::Rollback(style @ (RollbackStyle::Handover | RollbackStyle::Lower), began) => {
                let low = seen.tool.position[2] < safe_height_m;
                let moves = low || *style == RollbackStyle::Lower;
                let since = seen.tick - *began.get_or_insert(seen.tick);
                let still = seen.tool_twist.speed_m_s() < 0.02;
                if since < rise_after {
                    Command::Stop
                } else if since == rise_after && moves {
                    Command::ToolPose { pose: rise, max_speed_m_s: speed_m_s }
                } else if since > rise_after + ticks(0.1) && still {
                    Command::Done
                } else {
                    Command::Hold
                }
            }
            Self::Rollback(RollbackStyle::Stay, _) => Command::Done,
            Self::Rollback(RollbackStyle::None, _) => Command::Hold,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wraps_by_quarter_turns() {
        for (angle, expected) in [(0.1, 0.1), (FRAC_PI_2 + 0.1, 0.1), (-0.2, -0.2), (PI - 0.05, -0.05)] {
            assert!((wrap_quarter(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }

    #[test]
    fn averages_headings_across_the_seam() {
        let mut average = PoseAverage::default();
        for (sequence, yaw) in [(1, FRAC_PI_2 / 2.0 - 0.02), (2, -FRAC_PI_2 / 2.0 + 0.02)] {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let pose = Pose::from(&Isometry3::from_parts(Translation3::new(1.0, 2.0, 3.0), rotation));
            assert!(average.add(&Estimate { pose, age_ticks: 0, sequence }));
            assert!(!average.add(&Estimate { pose, age_ticks: 1, sequence }), "the same picture counts once");
        }
        let (position, yaw) = average.mean().unwrap();
        assert!((position[1] - 2.0).abs() < 1e-12);
        // Both headings lie next to the seam at an eighth of a turn; the mean lies on it.
        assert!((yaw.abs() - FRAC_PI_2 / 2.0).abs() < 1e-9, "{yaw}");
    }

    #[test]
    fn hand_down_points_down_and_turns() {
        let pose = hand_down([0.5, 0.1, 0.2], 0.3);
        assert!(pose.is_valid());
        let z = pose.isometry().rotation * Vector3::z();
        assert!((z.z + 1.0).abs() < 1e-12);
        assert!((yaw_of(&pose) - 0.3).abs() < 1e-12);
    }
}
