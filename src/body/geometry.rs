//! What a guard has to know of a robot: its kinematics and how near it comes to the table and to itself.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::chain::{Chain, Frames};
use crate::clearance::{Clearance, ClearanceModel};

/// A serial arm as geometry: no masses, no motors. Angles in rad, lengths in m, poses in the frame of the base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Geometry {
    /// Kinematics of the arm, base to tool.
    pub chain: Chain,
    /// The capsules that cover the robot, for distances.
    pub covers: ClearanceModel,
}

impl Geometry {
    /// Number of arm joints, without the fingers.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.chain.len()
    }

    /// Pose of the tool for the given joint angles (rad).
    #[must_use]
    pub fn tool_pose(&self, q: &[f64]) -> Isometry3<f64> {
        self.chain.tool(q)
    }

    /// Distance of the arm (fingers open) from the table plane and from itself, m; negative inside.
    #[must_use]
    pub fn clearance(&self, q: &[f64]) -> Clearance {
        self.covers.measure(&self.chain, q)
    }

    /// [`Geometry::clearance`] for frames already computed.
    #[must_use]
    pub fn clearance_at(&self, frames: &Frames) -> Clearance {
        self.covers.measure_frames(frames)
    }

    /// Points on the moving robot (ends of the capsules that cover it), m.
    pub fn cover_points<'a>(&'a self, frames: &'a Frames) -> impl Iterator<Item = [f64; 3]> + 'a {
        self.covers.points(frames)
    }

    /// Whether every angle is finite and inside its limits.
    #[must_use]
    pub fn within_limits(&self, q: &[f64]) -> bool {
        q.len() == self.chain.len()
            && self.chain.joints.iter().zip(q).all(|(j, v)| (j.lower_rad..=j.upper_rad).contains(v))
    }
}
