//! What a trial cell shows of an episode, for later viewing.

use holdpoint_body::{JointVec, Telemetry};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Ticks between two frames: 30 a second of the cell's time.
pub const FRAME_EVERY_TICKS: u64 = 8;

/// The most frames that are kept: two minutes. What comes later is not seen.
pub const FRAMES_MAX: usize = 3_600;

/// One moment of a world, with the peaks since the frame before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpisodeFrame {
    /// Ticks since the reset.
    pub tick: u64,
    /// What the sensors gave at this tick.
    pub seen: Telemetry,
    /// Joint torques as measured, N m.
    pub tau: JointVec,
    /// Where the object truly is, world frame, m.
    pub object: Isometry3<f64>,
    /// Largest measured speed of the tool since the frame before, m/s.
    pub speed_m_s: f64,
    /// Largest measured force of the pads on the object since the frame before, N.
    pub grip_n: f64,
    /// Largest measured force on the surroundings since the frame before, N.
    pub contact_n: f64,
    /// Whether something touched since the frame before that no task touches.
    pub touched: bool,
    /// Whether a stop or a failure was declared and stands.
    pub stopped: bool,
}
