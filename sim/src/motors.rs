//! From references to the physics engine's joints, once per tick.
//!
//! Owns what of a joint changes while the robot moves: motor targets, motor force, whether a
//! position limit takes part in the solver. It decides nothing; the servo does.

use rapier3d::dynamics::{JointAxesMask, JointAxis, Multibody, MultibodyJoint, MultibodyLink};

/// The free axis of an arm joint.
const TURN: usize = JointAxis::AngX as usize;

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

/// Makes an arm joint's motor a spring and a damper of its dynamics, solved implicitly with them
/// `tau = kp (q* - q) + kd (dq* - dq)`, both at the end of the substep.
///
/// As rows of the contact solver the same motors cost a factorised solve each and converge against
/// one another sweep by sweep; as part of the dynamics they are exact at any step.
pub fn make_spring(multibody: &mut Multibody, link_id: usize, joint_damping: f32) {
    let Some(link) = multibody.link_mut(link_id) else { return };
    link.joint.data.motor_axes.remove(JointAxesMask::ANG_X);
    let damping = link.joint.data.motors[TURN].damping;
    let at = link.assembly_id();
    multibody.damping_mut()[at] = joint_damping + damping;
}

/// Hands a reference to an arm joint.
///
/// The torque limit is kept by holding back the spring by what the torque asked for had in excess
/// one tick before.
pub fn drive_joint(multibody: &mut Multibody, link_id: usize, reference: Reference) {
    let Some(link) = multibody.link(link_id) else { return };
    let torque = joint_torque(multibody, link);
    let most = f64::from(link.joint.data.motors[TURN].max_force);
    let excess = torque - torque.clamp(-most, most);
    let Some(link) = multibody.link_mut(link_id) else { return };
    let motor = &mut link.joint.data.motors[TURN];
    (motor.target_pos, motor.target_vel) = (reference.position as f32, reference.speed as f32);
    let (kp, kd) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let rest = reference.position + (kd * reference.speed - excess) / kp;
    link.joint.set_spring(TURN, kp as f32, rest as f32);
}

/// Torque that the motor law asks for in the present state, N m; the motor gives at most its limit.
pub fn joint_torque(multibody: &Multibody, link: &MultibodyLink) -> f64 {
    let motor = &link.joint.data.motors[TURN];
    let at = f64::from(link.joint.coords()[TURN]);
    let speed = f64::from(multibody.joint_velocity(link)[0]);
    let (kp, kd) = (f64::from(motor.stiffness), f64::from(motor.damping));
    kp * (f64::from(motor.target_pos) - at) + kd * (f64::from(motor.target_vel) - speed)
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
