//! The trusted motion generator between commands and motors.
//!
//! Setpoints in, joint targets out, one step per tick: the tool moves in a straight line at the
//! commanded speed within acceleration limits, by resolved-rate control on the Jacobian of its own
//! reference (never of the measured state), so a new setpoint at any time gives no jump. Joint
//! position, speed and acceleration limits always win over the path.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::robot::RobotModel;
use holdpoint_body::chain::Transform;
use holdpoint_body::ik::{pose_error, rate_step};
use holdpoint_body::{Command, JointVec, MAX_JOINTS, Pose, TICK_SECS};

/// Acceleration of the tool along its path, m/s^2: 0.25 m/s is reached in 31 mm.
const TOOL_ACCELERATION_M_S2: f64 = 2.0;
/// Angular acceleration of the tool, rad/s^2.
const TOOL_ANGULAR_ACCELERATION_RAD_S2: f64 = 8.0;
/// Angular speed that goes with a path speed: a turn counts as a path of this radius, m.
const TURN_RADIUS_M: f64 = 0.2;
/// Share of the acceleration limit used to plan braking, so that the limit is never the reason to
/// overshoot.
const BRAKING_SHARE: f64 = 0.8;
/// The last stretch is covered exponentially with this time constant, ticks.
const SETTLE_TICKS: f64 = 4.0;
/// Pull toward the home posture in the null space, 1/s.
const POSTURE_RATE: f64 = 0.5;
/// Joint targets stay this far inside the limits, rad.
const LIMIT_MARGIN_RAD: f64 = 1e-3;

/// What the arm is asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ArmGoal {
    /// Brake to a standstill and stay.
    Brake,
    /// Tool to a pose.
    Tool { pose: Pose, max_speed_m_s: f64 },
    /// Joints to a configuration.
    Joints { q: JointVec, max_speed_rad_s: f64 },
}

/// What the gripper is asked for, and its ramp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GripperReference {
    /// Where the width is to go, m.
    pub goal_m: f64,
    /// Ramp speed, m/s.
    pub speed_m_s: f64,
    /// Largest force per finger, N.
    pub force_n: f64,
    /// The ramp, m.
    pub width_m: f64,
    /// Its speed, m/s.
    pub rate_m_s: f64,
}

/// Reference state of both channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Servo {
    /// Joint targets, rad.
    pub q: JointVec,
    /// Target speeds, rad/s.
    pub dq: JointVec,
    /// What the arm is asked for.
    pub goal: ArmGoal,
    /// The gripper.
    pub gripper: GripperReference,
    /// Setpoints are ignored while stopped from outside.
    pub stopped: bool,
}

impl Servo {
    /// Standing at `q` with the pads `width_m` apart.
    pub fn new(q: JointVec, width_m: f64, robot: &RobotModel) -> Self {
        let dq = q.iter().map(|_| 0.0).collect();
        let gripper = GripperReference {
            goal_m: width_m,
            speed_m_s: robot.gripper.speed_max_m_s,
            force_n: robot.gripper.force_max_n,
            width_m,
            rate_m_s: 0.0,
        };
        Self { q, dq, goal: ArmGoal::Brake, gripper, stopped: false }
    }

    /// Takes a (validated) command. `width_m` is the measured width, for a bumpless release.
    pub fn accept(&mut self, command: &Command, robot: &RobotModel, width_m: f64, tool_available: bool) {
        if self.stopped {
            return;
        }
        match command {
            Command::Hold | Command::Done | Command::Fail { .. } => {}
            Command::ToolPose { pose, max_speed_m_s } => {
                self.goal = ArmGoal::Tool { pose: *pose, max_speed_m_s: *max_speed_m_s };
            }
            Command::Joints { q, max_speed_rad_s } => {
                let q = robot.geometry.chain.clamped(q, LIMIT_MARGIN_RAD);
                self.goal = ArmGoal::Joints { q, max_speed_rad_s: *max_speed_rad_s };
            }
            Command::Gripper { width_m: goal, speed_m_s, force_n } => {
                if tool_available {
                    self.accept_gripper(*goal, *speed_m_s, *force_n, robot, width_m);
                }
            }
            Command::Stop => self.goal = ArmGoal::Brake,
        }
    }

    fn accept_gripper(&mut self, goal: f64, speed: f64, force: f64, robot: &RobotModel, measured: f64) {
        let g = &mut self.gripper;
        g.goal_m = goal.clamp(0.0, robot.gripper.width_max_m());
        g.speed_m_s = speed.min(robot.gripper.speed_max_m_s);
        g.force_n = force.min(robot.gripper.force_max_n);
        // The ramp was wound down below the object's width to build up force: start an opening
        // from where the pads are.
        if g.goal_m > g.width_m && measured > g.width_m {
            g.width_m = measured.min(g.goal_m);
        }
    }

    /// Brakes and ignores setpoints until released.
    pub fn stop(&mut self) {
        self.stopped = true;
        self.goal = ArmGoal::Brake;
        let g = &mut self.gripper;
        g.goal_m = g.width_m;
    }

    /// Takes setpoints again.
    pub fn release(&mut self) {
        self.stopped = false;
    }

    /// Advances both references by one tick.
    pub fn advance(&mut self, robot: &RobotModel, tool_available: bool) {
        let wanted = match &self.goal {
            ArmGoal::Brake => [0.0; MAX_JOINTS],
            ArmGoal::Tool { pose, max_speed_m_s } => self.tool_rate(robot, pose, *max_speed_m_s),
            ArmGoal::Joints { q, max_speed_rad_s } => self.joint_rate(robot, q, *max_speed_rad_s),
        };
        self.integrate(robot, wanted);
        let g = &mut self.gripper;
        let step = if tool_available {
            (g.goal_m - g.width_m).clamp(-g.speed_m_s * TICK_SECS, g.speed_m_s * TICK_SECS)
        } else {
            0.0
        };
        g.width_m += step;
        g.rate_m_s = step / TICK_SECS;
    }

    /// Joint speeds that move the tool's reference along the straight line to `pose`.
    fn tool_rate(&self, robot: &RobotModel, pose: &Pose, max_speed: f64) -> [f64; MAX_JOINTS] {
        let frames = robot.geometry.chain.frames(&self.q);
        let jacobian = robot.geometry.chain.jacobian(&frames);
        let now = jacobian.twist(&self.dq);
        let error = pose_error(&frames.tool, &Transform::new(&pose.isometry()));
        let linear = approach(
            &error.fixed_rows::<3>(0).into_owned(),
            &now.fixed_rows::<3>(0).into_owned(),
            max_speed,
            TOOL_ACCELERATION_M_S2,
        );
        let angular = approach(
            &error.fixed_rows::<3>(3).into_owned(),
            &now.fixed_rows::<3>(3).into_owned(),
            max_speed / TURN_RADIUS_M,
            TOOL_ANGULAR_ACCELERATION_RAD_S2,
        );
        let twist = nalgebra::Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let mut pull = [0.0; MAX_JOINTS];
        for ((value, angle), home) in pull.iter_mut().zip(&self.q).zip(&robot.home) {
            *value = POSTURE_RATE * (home - angle);
        }
        rate_step(&jacobian, &twist, &pull).unwrap_or([0.0; MAX_JOINTS])
    }

    /// Joint speeds straight to a configuration; the fastest joint sets the pace.
    fn joint_rate(&self, robot: &RobotModel, goal: &[f64], max_speed: f64) -> [f64; MAX_JOINTS] {
        let distance = self.q.iter().zip(goal).fold(0.0_f64, |most, (at, to)| most.max((to - at).abs()));
        let limit = robot
            .geometry
            .chain
            .joints
            .iter()
            .fold(f64::INFINITY, |least, j| least.min(j.acceleration_max_rad_s2));
        let speed = approach_speed(distance, max_speed, limit);
        let mut rate = [0.0; MAX_JOINTS];
        if distance > 0.0 {
            for ((value, at), to) in rate.iter_mut().zip(&self.q).zip(goal) {
                *value = (to - at) / distance * speed;
            }
        }
        rate
    }

    /// Moves the reference at the wanted speeds as far as the joint limits allow.
    fn integrate(&mut self, robot: &RobotModel, mut wanted: [f64; MAX_JOINTS]) {
        let joints = &robot.geometry.chain.joints;
        // Speed: all joints slow down together, so the tool stays on its line.
        let over =
            joints.iter().zip(&wanted).fold(1.0_f64, |most, (j, v)| most.max(v.abs() / j.speed_max_rad_s));
        for value in &mut wanted {
            *value /= over;
        }
        // Acceleration: the change is scaled as a whole, for the same reason.
        let mut share = 1.0_f64;
        for ((joint, now), then) in joints.iter().zip(&self.dq).zip(&wanted) {
            let change = (then - now).abs();
            if change > 0.0 {
                share = share.min(joint.acceleration_max_rad_s2 * TICK_SECS / change);
            }
        }
        for (i, joint) in joints.iter().enumerate() {
            let rate = self.dq[i] + share * (wanted[i] - self.dq[i]);
            let (low, high) = (joint.lower_rad + LIMIT_MARGIN_RAD, joint.upper_rad - LIMIT_MARGIN_RAD);
            let next = (self.q[i] + rate * TICK_SECS).clamp(low, high);
            self.dq[i] = (next - self.q[i]) / TICK_SECS;
            self.q[i] = next;
        }
    }
}

/// Speed at a distance from the goal: cruise, brake, settle.
fn approach_speed(distance: f64, max_speed: f64, acceleration: f64) -> f64 {
    let braking = libm::sqrt(2.0 * BRAKING_SHARE * acceleration * distance);
    max_speed.min(braking).min(distance / (SETTLE_TICKS * TICK_SECS))
}

/// The next velocity on the way along `error`, at most one tick's acceleration from `now`.
fn approach(error: &Vector3<f64>, now: &Vector3<f64>, max_speed: f64, acceleration: f64) -> Vector3<f64> {
    let distance = error.norm();
    let wanted = if distance > 0.0 {
        error * (approach_speed(distance, max_speed, acceleration) / distance)
    } else {
        Vector3::zeros()
    };
    let change = wanted - now;
    let (size, most) = (change.norm(), acceleration * TICK_SECS);
    if size > most { now + change * (most / size) } else { wanted }
}
