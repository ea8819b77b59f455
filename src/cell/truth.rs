//! True state of a trial cell: joints, forces and contacts as they are, not as sensors tell.

use holdpoint_body::{Contacts, JointVec};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// A contact of the robot, or of the object, with something it should not be confused with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactForces {
    /// Normal force of the object on each pad, N.
    pub pad_n: [f64; 2],
    /// Largest normal force of one robot part on table or tray, N.
    pub fixture_n: f64,
    /// ... on clutter, N.
    pub clutter_n: f64,
    /// ... on another robot part, N.
    pub self_n: f64,
    /// ... of a part other than a pad on the object, N.
    pub body_object_n: f64,
    /// Largest normal force of the object on table, tray or clutter, N.
    pub object_surroundings_n: f64,
    /// Largest normal force of the object on clutter, N.
    pub object_clutter_n: f64,
    /// Sum of the forces from outside on hand, fingers and object, world frame, N.
    pub wrist_n: [f64; 3],
    /// Who touches whom.
    pub contacts: Contacts,
}

impl ContactForces {
    /// Whether both pads press on the object.
    #[must_use]
    pub fn gripped(&self) -> bool {
        self.pad_n.iter().all(|force| *force > 0.0)
    }

    /// Mean normal force on the pads, N.
    #[must_use]
    pub fn grip_n(&self) -> f64 {
        0.5 * (self.pad_n[0] + self.pad_n[1])
    }

    /// Largest force of the robot, or of the object it holds, on its surroundings, N.
    #[must_use]
    pub fn surroundings_n(&self) -> f64 {
        let robot = self.fixture_n.max(self.clutter_n).max(self.self_n).max(self.body_object_n);
        if self.gripped() { robot.max(self.object_surroundings_n) } else { robot }
    }
}

/// True joint state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Positions, rad.
    pub q: JointVec,
    /// Speeds, rad/s.
    pub dq: JointVec,
    /// Motor torques, N m.
    pub tau: JointVec,
    /// Finger openings, m, and their speeds, m/s.
    pub fingers: [[f64; 2]; 2],
}

impl JointState {
    /// Distance between the pads, m.
    #[must_use]
    pub fn width_m(&self) -> f64 {
        self.fingers[0][0] + self.fingers[1][0]
    }
}

/// Where two things touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactPoint {
    /// Middle of the points that carry the force, world frame, m.
    pub at_m: [f64; 3],
    /// Normal force on the robot, or on the object where the robot has no part in it, world frame, N.
    pub force_n: [f64; 3],
}

/// True state of a cell at one tick.
#[derive(Clone, Copy, Debug)]
pub struct TrueState<'a> {
    /// Joint positions and speeds.
    pub joints: &'a JointState,
    /// Forces between robot, object and surroundings.
    pub forces: &'a ContactForces,
    /// Where the object is, world frame, m.
    pub object: Isometry3<f64>,
    /// Its speed, m/s.
    pub object_speed_m_s: f64,
}
