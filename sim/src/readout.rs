//! What a stepped world says: joint state, contact forces, who touches whom.
//!
//! Normal forces are the solver's impulses over the tick. Nothing here adds noise; see
//! `perception.rs`.

use nalgebra::{Isometry3, Vector3};
use rapier3d::dynamics::RigidBody;
use rapier3d::geometry::ContactPair;
use rapier3d::pipeline::PhysicsWorld;

use crate::handles::{ColliderKind, Handles, from_rapier};
use crate::motors;
use crate::robot::RobotModel;
use holdpoint_body::TICK_SECS;
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState};

/// Reads positions, speeds and motor torques.
///
/// Torque is the motor law with the end-of-tick state,
/// `tau = kp (q* - q) + kd (dq* - dq)`, clamped to the motor's limit.
pub fn joint_state(physics: &PhysicsWorld, handles: &Handles, robot: &RobotModel) -> JointState {
    let mut state = JointState::default();
    let Some((multibody, _)) = physics.multibody_joints.get(handles.first_joint) else { return state };
    let n = robot.geometry.joint_count();
    for (i, id) in handles.link_ids.iter().enumerate() {
        let Some(link) = multibody.link(*id) else { continue };
        let axis = if i < n { 3 } else { 0 };
        let at = f64::from(link.joint().coords()[axis]);
        let speed = f64::from(multibody.joint_velocity(link)[0]);
        if i < n {
            let tau = motors::joint_torque(multibody, link);
            let most = f64::from(link.joint().data.motors[axis].max_force);
            state.q.push(at);
            state.dq.push(speed);
            state.tau.push(tau.clamp(-most, most));
        } else {
            state.fingers[i - n] = [at, speed];
        }
    }
    state
}

/// Pose and speed (m/s) of the object.
pub fn object_state(physics: &PhysicsWorld, handles: &Handles) -> (Isometry3<f64>, f64, f64) {
    let body = &physics.bodies[handles.object];
    (from_rapier(body.position()), f64::from(body.linvel().length()), f64::from(body.angvel().length()))
}

/// The bodies of the further objects.
pub fn further_objects<'a>(
    physics: &'a PhysicsWorld,
    handles: &'a Handles,
) -> impl Iterator<Item = &'a RigidBody> {
    handles.further.iter().filter_map(|handle| physics.bodies.get(*handle))
}

/// Classifies every touching pair and sums its forces.
pub fn contact_forces(physics: &PhysicsWorld, handles: &Handles, joints: usize) -> ContactForces {
    let mut out = ContactForces::default();
    let mut wrist = Vector3::zeros();
    let mut on_object = Vector3::zeros();
    for pair in physics.narrow_phase.contact_pairs() {
        let magnitude = f64::from(pair.total_impulse_magnitude()) / TICK_SECS;
        if magnitude <= 0.0 {
            continue;
        }
        let (Some(first), Some(second)) = (kind(handles, pair, true), kind(handles, pair, false)) else {
            continue;
        };
        // Order the pair so that the robot, then the object, comes first.
        let (a, b, sign) =
            if rank(first) <= rank(second) { (first, second, -1.0) } else { (second, first, 1.0) };
        let force = || {
            let impulse = pair.total_impulse();
            Vector3::new(f64::from(impulse.x), f64::from(impulse.y), f64::from(impulse.z))
                * (sign / TICK_SECS)
        };
        let distal = is_distal(a, joints);
        match (rank(a), rank(b)) {
            // A further object on what it stands on.
            (2, _) => {}
            (0, 0) => {
                out.contacts.robot_robot = true;
                out.self_n = out.self_n.max(magnitude);
                if distal != is_distal(b, joints) {
                    wrist += force();
                }
            }
            (0, 1) => {
                if let ColliderKind::Pad(side) = a {
                    out.contacts.pad_object = true;
                    out.pad_n[usize::from(side.min(1))] += magnitude;
                } else {
                    out.contacts.body_object = true;
                    out.body_object_n = out.body_object_n.max(magnitude);
                }
            }
            (0, _) => {
                if is_in_the_way(b) {
                    out.contacts.robot_clutter = true;
                    out.clutter_n = out.clutter_n.max(magnitude);
                } else {
                    out.contacts.robot_fixture = true;
                    out.fixture_n = out.fixture_n.max(magnitude);
                }
                if distal {
                    wrist += force();
                }
            }
            _ => {
                if is_in_the_way(b) {
                    out.contacts.object_clutter = true;
                    out.object_clutter_n = out.object_clutter_n.max(magnitude);
                } else {
                    out.contacts.object_fixture = true;
                }
                out.object_surroundings_n = out.object_surroundings_n.max(magnitude);
                on_object += force();
            }
        }
    }
    if out.gripped() {
        wrist += on_object;
    }
    out.wrist_n = wrist.into();
    out
}

/// Every touching pair that has the robot or the object in it, the strongest first.
pub fn contact_points(physics: &PhysicsWorld, handles: &Handles) -> Vec<ContactPoint> {
    let mut points: Vec<ContactPoint> = Vec::new();
    for pair in physics.narrow_phase.contact_pairs() {
        if pair.total_impulse_magnitude() <= 0.0 {
            continue;
        }
        let (Some(first), Some(second)) = (kind(handles, pair, true), kind(handles, pair, false)) else {
            continue;
        };
        if rank(first).min(rank(second)) == 2 {
            continue;
        }
        let (mut sum, mut count) = (Vector3::zeros(), 0.0_f64);
        for manifold in pair.solver_manifolds() {
            for contact in &manifold.data.solver_contacts {
                let (a, b) = manifold.data.solver_contact_world_points(contact, &physics.bodies);
                let middle = (a + b) * 0.5;
                sum += Vector3::new(f64::from(middle.x), f64::from(middle.y), f64::from(middle.z));
                count += 1.0;
            }
        }
        if count == 0.0 {
            continue;
        }
        let sign = if rank(first) <= rank(second) { -1.0 } else { 1.0 };
        let impulse = pair.total_impulse();
        let force = [impulse.x, impulse.y, impulse.z].map(|part| sign * f64::from(part) / TICK_SECS);
        points.push(ContactPoint { at_m: (sum / count).into(), force_n: force });
    }
    let strength = |point: &ContactPoint| point.force_n.iter().map(|part| part * part).sum::<f64>();
    points.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    points
}

/// What one side of a pair stands for.
pub(crate) fn kind(handles: &Handles, pair: &ContactPair, first: bool) -> Option<ColliderKind> {
    let collider = if first { pair.collider1 } else { pair.collider2 };
    handles.kinds.get(collider.into_raw_parts().0 as usize).copied()
}

/// Robot 0, object 1, surroundings 2.
fn rank(kind: ColliderKind) -> u8 {
    match kind {
        ColliderKind::Link(_) | ColliderKind::Finger(_) | ColliderKind::Pad(_) => 0,
        ColliderKind::Object => 1,
        ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_) | ColliderKind::Further => 2,
    }
}

/// Clutter, and further objects: no task has to do with them.
fn is_in_the_way(kind: ColliderKind) -> bool {
    matches!(kind, ColliderKind::Clutter(_) | ColliderKind::Further)
}

/// Beyond the wrist's force sensor.
fn is_distal(kind: ColliderKind, joints: usize) -> bool {
    match kind {
        ColliderKind::Link(index) => usize::from(index) == joints,
        ColliderKind::Finger(_) | ColliderKind::Pad(_) => true,
        ColliderKind::Object
        | ColliderKind::Table
        | ColliderKind::Tray
        | ColliderKind::Clutter(_)
        | ColliderKind::Further => false,
    }
}
