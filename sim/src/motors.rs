//! From references to the physics engine's joints, once per tick.
//!
//! Owns what of a joint changes while the robot moves: motor targets, motor force, whether a
//! position limit takes part in the solver. It decides nothing; the servo does.

use rapier3d::dynamics::{JointAxesMask, JointAxis, MultibodyJoint};

/// A limit takes part when the joint is this close to it, rad: nothing that has not diverged gets
/// further in one tick (48 rad/s), so leaving it out until then changes no bit of the outcome.
const LIMIT_NEAR_RAD: f32 = 0.2;
/// The same for a finger, m (1.2 m/s).
const LIMIT_NEAR_M: f32 = 0.005;

/// Where one motor is to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s.
    pub speed: f64,
}

/// Hands a reference to an arm joint.
pub fn drive_joint(joint: &mut MultibodyJoint, reference: Reference) {
    let motor = &mut joint.data.motors[JointAxis::AngX as usize];
    (motor.target_pos, motor.target_vel) = (reference.position as f32, reference.speed as f32);
}

/// Hands a reference and the largest force (N) to a finger.
pub fn drive_finger(joint: &mut MultibodyJoint, reference: Reference, force_max_n: f64) {
    let motor = &mut joint.data.motors[JointAxis::LinX as usize];
    (motor.target_pos, motor.target_vel) = (reference.position as f32, reference.speed as f32);
    motor.max_force = force_max_n as f32;
}

/// Lets a joint's position limit take part in the solver only where it can matter: a row of the
/// system that never acts costs as much as one that does.
pub fn engage_limit(joint: &mut MultibodyJoint, turns: bool) {
    let (axis, mask, near) = if turns {
        (JointAxis::AngX, JointAxesMask::ANG_X, LIMIT_NEAR_RAD)
    } else {
        (JointAxis::LinX, JointAxesMask::LIN_X, LIMIT_NEAR_M)
    };
    let limits = joint.data.limits[axis as usize];
    let at = joint.coords()[axis as usize];
    // A position that is not a number is not far from the limits.
    let far = at > limits.min + near && at < limits.max - near;
    joint.data.limit_axes.set(mask, !far);
}
