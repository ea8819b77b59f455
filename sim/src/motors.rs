//! From references to the physics engine's joints, once per tick.
//!
//! Owns what of a joint changes while the robot moves: motor targets, motor force, whether a
//! position limit takes part in the solver. It decides nothing; the servo does.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use arrayvec::ArrayVec;
use rapier3d::dynamics::{JointAxesMask, JointAxis, Multibody, MultibodyJoint, MultibodyLink};
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::dynamics::ARM_JOINTS_MAX;
use crate::handles::Handles;
use holdpoint_body::TICK_SECS;

/// The free axis of an arm joint.
const TURN: usize = JointAxis::AngX as usize;

/// A limit takes part when the joint is this close to it, rad: nothing that has not diverged gets
/// further in one tick (48 rad/s), so leaving it out until then changes no bit of the outcome.
const LIMIT_NEAR_RAD: f32 = 0.2;
/// The same for a finger, m (1.2 m/s).
pub const LIMIT_NEAR_M: f32 = 0.005;

/// Where one motor is to go.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorReference {
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s.
    pub speed: f64,
}

/// Commands for the motors in one tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Drives {
    /// The arm's joints.
    pub arm: ArrayVec<MotorReference, ARM_JOINTS_MAX>,
    /// Either finger.
    pub finger: MotorReference,
    /// Largest force of a finger, N.
    pub finger_force_n: f64,
}

impl Drives {
    /// Tells the engine's motors.
    pub fn apply(&self, physics: &mut PhysicsWorld, handles: &Handles) {
        let Some((multibody, _)) = physics.multibody_joints.get_mut(handles.first_joint) else { return };
        for (i, id) in handles.link_ids.iter().enumerate() {
            let Some(link) = multibody.link_mut(*id) else { continue };
            engage_limit(&mut link.joint, i < self.arm.len());
            if let Some(reference) = self.arm.get(i) {
                drive_joint(multibody, *id, *reference);
            } else {
                drive_finger(&mut link.joint, self.finger, self.finger_force_n);
            }
        }
    }
}

/// The motor law of one arm joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorLaw {
    /// Position gain, N m/rad.
    pub stiffness: f64,
    /// Damping, N m s/rad.
    pub damping: f64,
    /// Largest torque, N m.
    pub torque_max: f64,
}

impl MotorLaw {
    /// Rest position of the spring that stands for the motor in this tick, rad.
    ///
    /// Shifts the rest position back by the torque that the motor law would demand above the limit if the
    /// joint kept its speed. `commanded_speed` is the reference's speed of the previous tick: the joint mostly
    /// follows a change of speed within the tick.
    pub fn rest(&self, reference: MotorReference, commanded_speed: f64, at: f64, speed: f64) -> f64 {
        let ahead = at + speed * TICK_SECS;
        let torque = self.stiffness * (reference.position - ahead) + self.damping * (commanded_speed - speed);
        let excess = torque - torque.clamp(-self.torque_max, self.torque_max);
        reference.position + (self.damping * reference.speed - excess) / self.stiffness
    }
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

/// Hands a reference to an arm joint, within its torque limit (see [`MotorLaw::rest`]).
pub fn drive_joint(multibody: &mut Multibody, link_id: usize, reference: MotorReference) {
    let Some(link) = multibody.link(link_id) else { return };
    let motor = link.joint.data.motors[TURN];
    let speed = f64::from(multibody.joint_velocity(link)[0]);
    let law = MotorLaw {
        stiffness: f64::from(motor.stiffness),
        damping: f64::from(motor.damping),
        torque_max: f64::from(motor.max_force),
    };
    let at = f64::from(link.joint().coords()[TURN]);
    let rest = law.rest(reference, f64::from(motor.target_vel), at, speed);
    let Some(link) = multibody.link_mut(link_id) else { return };
    let motor = &mut link.joint.data.motors[TURN];
    (motor.target_pos, motor.target_vel) = (reference.position as f32, reference.speed as f32);
    link.joint.set_spring(TURN, law.stiffness as f32, rest as f32);
}

/// Last commanded position of an arm joint's motor, rad.
pub fn commanded_position(physics: &PhysicsWorld, handles: &Handles, joint: usize) -> f64 {
    let multibody = physics.multibody_joints.get(handles.first_joint).map(|(multibody, _)| multibody);
    let link = handles.link_ids.get(joint).and_then(|id| multibody?.link(*id));
    link.map_or(0.0, |link| f64::from(link.joint().data.motors[TURN].target_pos))
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
pub fn drive_finger(joint: &mut MultibodyJoint, reference: MotorReference, force_max_n: f64) {
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

#[cfg(test)]
mod tests {
    use rapier3d::dynamics::{GenericJointBuilder, MassProperties, MultibodyJointHandle, RigidBodyBuilder};
    use rapier3d::math::Vector;
    use rapier3d::pipeline::PhysicsWorld;

    use super::*;
    use crate::build::empty_world;

    const STIFFNESS: f32 = 4500.0;
    const TORQUE_MAX_N_M: f32 = 87.0;

    /// A wheel on a motor, free to turn without weight.
    fn wheel(inertia: f32) -> (PhysicsWorld, MultibodyJointHandle) {
        let mut world = empty_world();
        let properties = MassProperties::new(Vector::ZERO, 1.0, Vector::splat(inertia));
        let base = world.insert_body(RigidBodyBuilder::fixed());
        let wheel = RigidBodyBuilder::dynamic()
            .can_sleep(false)
            .gravity_scale(0.0)
            .additional_mass_properties(properties);
        let wheel = world.insert_body(wheel);
        let joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
            .limits(JointAxis::AngX, [-1.0, 1.0])
            .set_motor(JointAxis::AngX, 0.0, 0.0, STIFFNESS, 0.1 * STIFFNESS)
            .motor_max_force(JointAxis::AngX, TORQUE_MAX_N_M)
            .build();
        let handle = world.multibody_joints.insert(base, wheel, joint, true).expect("no loop");
        let (multibody, id) = world.multibody_joints.get_mut(handle).expect("just inserted");
        multibody.forward_kinematics(&world.bodies, true);
        multibody.damping_mut().fill(0.0);
        make_spring(multibody, id, 0.0);
        (world, handle)
    }

    /// Turns the reference at `rate` for `ticks`; returns the final position and speed of the wheel.
    fn turn(inertia: f32, rate: f64, ticks: u32) -> (f64, f64) {
        let (mut world, handle) = wheel(inertia);
        for tick in 1..=ticks {
            let (multibody, id) = world.multibody_joints.get_mut(handle).expect("still there");
            let reference = MotorReference { position: rate * TICK_SECS * f64::from(tick), speed: rate };
            drive_joint(multibody, id, reference);
            world.step();
        }
        let (multibody, id) = world.multibody_joints.get(handle).expect("still there");
        let link = multibody.link(id).expect("still there");
        (f64::from(link.joint().coords()[TURN]), f64::from(multibody.joint_velocity(link)[0]))
    }

    #[test]
    fn a_light_joint_follows_its_reference() {
        for rate in [0.1, -0.5, 0.8] {
            let (at, speed) = turn(0.1, rate, 240);
            assert!((at - rate).abs() < 0.002, "{rate}: at {at}");
            // Within a tick the reference stands at the tick's end, so the speed saws a little.
            assert!((speed - rate).abs() < 0.02 * rate.abs(), "{rate}: {speed} rad/s");
        }
    }

    #[test]
    fn heavy_joint_accelerates_at_the_torque_limit() {
        for inertia in [500.0_f32, 2000.0] {
            let (_, speed) = turn(inertia, 1.0, 240);
            let most = f64::from(TORQUE_MAX_N_M / inertia);
            assert!((0.95..1.05).contains(&(speed / most)), "{speed} rad/s after 1 s, at most {most}");
        }
    }

    #[test]
    fn joint_limit_is_engaged_only_near_the_ends() {
        let (mut world, handle) = wheel(1.0);
        for (at, expected) in [(0.0, false), (0.7, false), (0.9, true), (1.2, true), (-0.85, true)] {
            let (multibody, id) = world.multibody_joints.get_mut(handle).expect("still there");
            let link = multibody.link_mut(id).expect("still there");
            let now = link.joint.coords()[TURN];
            link.joint.apply_displacement(&[at - now]);
            engage_limit(&mut link.joint, true);
            assert_eq!(link.joint.data.limit_axes.contains(JointAxesMask::ANG_X), expected, "at {at}");
        }
    }
}
