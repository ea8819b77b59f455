//! What episodes are drawn from: ranges of objects, starts and perturbations, and named drifts.
//!
//! Parsed strictly. A range is `[min, max]`; sampling is in [`crate::episode`].

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::CellError;
pub use crate::number::Range;
use crate::number::{parse_toml, read_text};

/// Where the object lies and what it is like.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectRange {
    /// Position on the table, m.
    pub x_m: Range,
    /// Position on the table, m.
    pub y_m: Range,
    /// Yaw, rad.
    pub yaw_rad: Range,
    /// Mass, kg.
    pub mass_kg: Range,
    /// Friction coefficient (the smaller of object and pad counts).
    pub friction: Range,
}

/// Position of the tray.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetRange {
    /// Position, m.
    pub x_m: Range,
    /// Position, m.
    pub y_m: Range,
    /// Yaw, rad.
    pub yaw_rad: Range,
}

/// The arm at the start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmRange {
    /// Offset of each joint from home, rad.
    pub home_offset_rad: Range,
}

/// Starts with the object in the hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldRange {
    /// Height of the object's center above the table, m (align).
    pub height_m: Range,
    /// Object center along the pads, m.
    pub along_pad_m: Range,
    /// Object center along the approach axis, m.
    pub depth_m: Range,
    /// Yaw of the object in the hand before the pads square it, rad.
    pub yaw_rad: Range,
    /// Left over by alignment, each axis, m (place).
    pub residual_xy_m: Range,
    /// Left over by alignment, yaw, rad (place).
    pub residual_yaw_rad: Range,
}

/// The camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRange {
    /// Exposure to delivery, per episode.
    pub delay_ms: Range,
    /// Added to the delay, per picture.
    pub delay_jitter_ms: Range,
    /// First exposure after the start.
    pub phase_ms: Range,
    /// Added to the 33 ms period, per picture.
    pub period_jitter_ms: Range,
    /// Probability of a lost camera frame, per episode.
    pub drop_probability: Range,
    /// Standard deviation of x and y, per episode; z has half of it.
    pub sigma_m: Range,
    /// Standard deviation of yaw, per episode.
    pub sigma_yaw_rad: Range,
    /// Constant error of x and of y, per episode.
    pub bias_m: Range,
    /// Constant error of yaw, per episode.
    pub bias_yaw_rad: Range,
    /// Correlation of the noise of consecutive camera frames, AR(1), below 1.
    pub correlation: Range,
}

/// Standard deviations of the robot's own sensors, per episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorRange {
    /// Joint position.
    pub joint_rad: Range,
    /// Joint speed.
    pub joint_speed_rad_s: Range,
    /// Joint torque.
    pub torque_n_m: Range,
    /// Gripper, wrist and contact force.
    pub force_n: Range,
    /// Gripper width.
    pub width_m: Range,
    /// Slip sensor in the pads.
    pub slip_m: Range,
}

/// From command to servo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionRange {
    /// Latency, per episode.
    pub latency_ms: Range,
    /// Added to it, per command; order is kept.
    pub jitter_ms: Range,
}

/// Pushes on the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushRange {
    /// Chance of a push, per episode.
    pub probability: Range,
    /// When, s.
    pub time_s: Range,
    /// Speed it gives the object, m/s, horizontal, in any direction.
    pub speed_m_s: Range,
}

/// Windows in which the gripper does not answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolRange {
    /// Chance of each of the two windows.
    pub probability: Range,
    /// Begin, s.
    pub start_s: Range,
    /// Length, s.
    pub length_s: Range,
}

/// Clutter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClutterRange {
    /// Chance of each piece of the scene.
    pub probability: Range,
}

/// Everything an episode is drawn from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Distribution {
    /// Version of the file's format; 1.
    pub format: u32,
    /// Name, recorded with every episode.
    pub name: String,
    /// The object.
    pub object: ObjectRange,
    /// The tray.
    pub target: TargetRange,
    /// The arm at the start.
    pub arm: ArmRange,
    /// Starts with the object in the hand.
    pub held: HeldRange,
    /// The camera.
    pub camera: CameraRange,
    /// The robot's sensors.
    pub sensors: SensorRange,
    /// From command to servo.
    pub action: ActionRange,
    /// Pushes.
    pub push: PushRange,
    /// Gripper failures.
    pub tool: ToolRange,
    /// Clutter.
    pub clutter: ClutterRange,
}

impl Distribution {
    /// A distribution from a file.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn load(path: &Path) -> Result<Self, CellError> {
        Self::from_toml(&path.display().to_string(), &read_text(path)?)
    }

    /// A distribution from a TOML text; `file` is used in errors.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, CellError> {
        let distribution: Self = parse_toml(file, text)?;
        distribution.check(file)?;
        Ok(distribution)
    }

    /// Ranges whose sign or bound matters: key, range, lowest, highest allowed.
    fn bounds(&self) -> [(&'static str, &Range, f64, f64); 24] {
        const ANY: f64 = f64::INFINITY;
        [
            ("object.mass_kg", &self.object.mass_kg, 1e-3, 5.0),
            ("object.friction", &self.object.friction, 1e-3, 2.0),
            ("held.height_m", &self.held.height_m, 0.04, 0.5),
            ("camera.delay_ms", &self.camera.delay_ms, 0.0, 1000.0),
            ("camera.delay_jitter_ms", &self.camera.delay_jitter_ms, 0.0, 1000.0),
            ("camera.phase_ms", &self.camera.phase_ms, 0.0, 1000.0),
            ("camera.period_jitter_ms", &self.camera.period_jitter_ms, 0.0, 1000.0),
            ("camera.drop_probability", &self.camera.drop_probability, 0.0, 1.0),
            ("camera.sigma_m", &self.camera.sigma_m, 0.0, ANY),
            ("camera.sigma_yaw_rad", &self.camera.sigma_yaw_rad, 0.0, ANY),
            ("camera.correlation", &self.camera.correlation, 0.0, 0.999),
            ("sensors.joint_rad", &self.sensors.joint_rad, 0.0, ANY),
            ("sensors.joint_speed_rad_s", &self.sensors.joint_speed_rad_s, 0.0, ANY),
            ("sensors.torque_n_m", &self.sensors.torque_n_m, 0.0, ANY),
            ("sensors.force_n", &self.sensors.force_n, 0.0, ANY),
            ("sensors.width_m", &self.sensors.width_m, 0.0, ANY),
            ("sensors.slip_m", &self.sensors.slip_m, 0.0, ANY),
            ("action.latency_ms", &self.action.latency_ms, 0.0, 500.0),
            ("action.jitter_ms", &self.action.jitter_ms, 0.0, 500.0),
            ("push.probability", &self.push.probability, 0.0, 1.0),
            ("push.speed_m_s", &self.push.speed_m_s, 0.0, 5.0),
            ("tool.probability", &self.tool.probability, 0.0, 1.0),
            ("tool.length_s", &self.tool.length_s, 0.0, 60.0),
            ("clutter.probability", &self.clutter.probability, 0.0, 1.0),
        ]
    }

    /// Checks the ranges; `file` is used in errors.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn check(&self, file: &str) -> Result<(), CellError> {
        if self.format != 1 {
            return Err(CellError::file(
                file,
                "format",
                format!("\"{}\" is not known; this build reads 1", self.format),
            ));
        }
        for (key, range, low, high) in self.bounds() {
            if range.min < low || range.max > high {
                let problem = format!("\"[{}, {}]\" must lie within {low} to {high}", range.min, range.max);
                return Err(CellError::file(file, key, problem));
            }
        }
        Ok(())
    }
}
