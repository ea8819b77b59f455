//! Camera frames at 30 Hz from true poses, and sensor readings from the true joint state.
//!
//! Draws the same count of random numbers for each frame and each tick, whatever happens in the cell.

use arrayvec::ArrayVec;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::dynamics::ARM_JOINTS_MAX;
use holdpoint_body::{Estimate, JointVec, Pose, RATE_HZ};
use holdpoint_cell::episode::{CameraSetup, SensorSetup, upright, yaw_of};
use holdpoint_cell::rng::Stream;

/// Camera frames per second.
pub const CAMERA_HZ: u32 = 30;

const PERIOD_TICKS: f64 = RATE_HZ as f64 / CAMERA_HZ as f64;

/// One camera frame, in transit or delivered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct CameraFrame {
    taken: u64,
    due: u64,
    sequence: u32,
    /// Absent: lost.
    seen: Option<[Pose; 2]>,
}

/// The camera's state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    setup: CameraSetup,
    next_exposure: f64,
    sequence: u32,
    /// Correlated noise of object and target: x, y, z, yaw each.
    noise: [[f64; 4]; 2],
    in_flight: ArrayVec<CameraFrame, 64>,
    delivered: Option<CameraFrame>,
    /// When the newest camera frame that was not lost was taken.
    last_seen: Option<u64>,
}

impl Camera {
    /// A camera that has seen nothing.
    pub fn new(setup: &CameraSetup) -> Self {
        let mut camera = Self {
            setup: setup.clone(),
            next_exposure: setup.phase_ticks,
            sequence: 0,
            noise: [[0.0; 4]; 2],
            in_flight: ArrayVec::new(),
            delivered: None,
            last_seen: None,
        };
        // The stationary state of the AR(1) process.
        for row in &mut camera.noise {
            for value in row {
                *value = camera.setup.noise.normal();
            }
        }
        camera
    }

    /// Loses every camera frame from now on.
    pub fn lose(&mut self) {
        self.setup.drop_probability = 1.0;
    }

    /// Exposes and delivers what is due at `tick`.
    pub fn tick(&mut self, tick: u64, object: &Isometry3<f64>, target: &Isometry3<f64>) {
        if tick as f64 >= self.next_exposure {
            self.expose(tick, object, target);
        }
        while self.in_flight.first().is_some_and(|frame| frame.due <= tick) {
            let frame = self.in_flight.remove(0);
            if frame.seen.is_some() {
                self.last_seen = Some(frame.taken);
            }
            self.delivered = Some(frame);
        }
    }

    fn expose(&mut self, tick: u64, object: &Isometry3<f64>, target: &Isometry3<f64>) {
        let s = &mut self.setup;
        self.next_exposure += PERIOD_TICKS + s.timing.unit() * s.period_jitter_ticks;
        let delay = s.delay_ticks + s.timing.unit() * s.delay_jitter_ticks;
        let lost = s.timing.chance(s.drop_probability);
        for row in &mut self.noise {
            correlate(row, s.correlation, &mut s.noise);
        }
        let seen = [self.perceived(object, &self.noise[0]), self.perceived(target, &self.noise[1])];
        // A camera frame never overtakes the one before it.
        let after = self.in_flight.last().map_or(0, |frame| frame.due);
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a cast saturates, NaN is 0"
        )]
        let due = (tick + libm::round(delay) as u64).max(after);
        self.sequence += 1;
        let frame = CameraFrame { taken: tick, due, sequence: self.sequence, seen: (!lost).then_some(seen) };
        if self.in_flight.is_full() {
            self.in_flight.remove(0);
        }
        self.in_flight.push(frame);
    }

    /// A pose with bias and noise: translation, and a turn about the world's z.
    pub fn perceived(&self, truth: &Isometry3<f64>, n: &[f64; 4]) -> Pose {
        let s = &self.setup;
        let turn = upright(0.0, 0.0, 0.0, s.bias_yaw_rad + s.sigma_yaw_rad * n[3]).rotation;
        let mut pose = Isometry3::from_parts(truth.translation, turn * truth.rotation);
        pose.translation.x += s.bias_m[0] + s.sigma_m * n[0];
        pose.translation.y += s.bias_m[1] + s.sigma_m * n[1];
        pose.translation.z += 0.5 * s.sigma_m * n[2];
        Pose::from(&pose)
    }

    /// Correlation of the noise from one exposure to the next.
    pub const fn correlation(&self) -> f64 {
        self.setup.correlation
    }

    /// Number of the newest exposure; 0 before the first.
    pub const fn newest(&self) -> u32 {
        self.sequence
    }

    /// Number of the newest delivered frame, seen or lost.
    pub fn delivered(&self) -> Option<u32> {
        self.delivered.as_ref().map(|frame| frame.sequence)
    }

    /// Number of the newest delivered frame and its age, ticks; absent before the first and while the last was lost.
    pub fn in_view(&self, tick: u64) -> Option<(u32, u32)> {
        let frame = self.delivered.as_ref().filter(|frame| frame.seen.is_some())?;
        Some((frame.sequence, u32::try_from(tick - frame.taken).unwrap_or(u32::MAX)))
    }

    /// Object and target as last seen; absent before the first picture and while the last was lost.
    pub fn estimates(&self, tick: u64) -> (Option<Estimate>, Option<Estimate>) {
        let Some(CameraFrame { taken, sequence, seen: Some([object, target]), .. }) = &self.delivered else {
            return (None, None);
        };
        let age_ticks = u32::try_from(tick - taken).unwrap_or(u32::MAX);
        let estimate = |pose: &Pose| Some(Estimate { pose: *pose, age_ticks, sequence: *sequence });
        (estimate(object), estimate(target))
    }

    /// Age of the newest camera frame that was not lost, ticks.
    pub fn age_ticks(&self, tick: u64) -> Option<u32> {
        self.last_seen.map(|taken| u32::try_from(tick - taken).unwrap_or(u32::MAX))
    }
}

/// The next noise of an object after the last (AR(1)).
pub fn correlate(row: &mut [f64; 4], correlation: f64, stream: &mut Stream) {
    let fresh = libm::sqrt(1.0 - correlation * correlation);
    for value in row {
        *value = correlation * *value + fresh * stream.normal();
    }
}

/// Errors of every sensor in one tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorErrors {
    /// Joint positions, rad.
    pub q: JointVec,
    /// Joint speeds, rad/s.
    pub dq: JointVec,
    /// Joint torques, N m.
    pub tau: JointVec,
    /// Grip, wrist and contact force, N.
    pub force_n: [f64; 3],
    /// Gripper width, m.
    pub width_m: f64,
    /// Slip, m.
    pub slip_m: f64,
}

/// Draws the errors of one tick; the same count for every robot.
pub fn sensor_errors(setup: &mut SensorSetup) -> SensorErrors {
    let s = setup;
    let mut errors = SensorErrors::default();
    for _ in 0..ARM_JOINTS_MAX {
        errors.q.push(s.joint_rad * s.noise.normal_bounded());
        errors.dq.push(s.joint_speed_rad_s * s.noise.normal_bounded());
        errors.tau.push(s.torque_n_m * s.noise.normal_bounded());
    }
    for value in &mut errors.force_n {
        *value = s.force_n * s.noise.normal_bounded();
    }
    errors.width_m = s.width_m * s.noise.normal_bounded();
    errors.slip_m = s.slip_m * s.noise.normal_bounded();
    errors
}

/// Yaw difference of two upright poses modulo the cube's quarter turn, rad.
pub fn yaw_error(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    holdpoint_cell::episode::wrap_quarter_turn(yaw_of(a) - yaw_of(b)).abs()
}
