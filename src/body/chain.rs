//! Kinematics of a serial arm: forward, Jacobian. Generic over the number of joints, no allocation.
//!
//! Link frames are canonical: the joint of link `i` turns about the frame's own z. Angles in rad,
//! lengths in m, poses in the frame of the base.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::messages::{JointVec, MAX_JOINTS};

/// A rigid transform with its rotation as a matrix: cheaper to chain than a quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Rotation matrix: its columns are this frame's axes in the parent frame.
    pub rotation: Matrix3<f64>,
    /// Position of the origin, m.
    pub origin: Vector3<f64>,
}

impl Transform {
    /// The parent frame itself: no rotation, no offset.
    pub const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        origin: Vector3::new(0.0, 0.0, 0.0),
    };

    /// The same transform as an isometry, with its quaternion as a matrix.
    #[must_use]
    pub fn new(isometry: &Isometry3<f64>) -> Self {
        Self {
            rotation: isometry.rotation.to_rotation_matrix().into_inner(),
            origin: isometry.translation.vector,
        }
    }

    /// `self` followed by `next`, which is given in this frame.
    #[inline]
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self { rotation: self.rotation * next.rotation, origin: self.point(&next.origin) }
    }

    /// A point given in this frame, expressed in its parent.
    #[inline]
    #[must_use]
    pub fn point(&self, local: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * local + self.origin
    }

    /// This frame's z axis in the parent frame: the axis a joint turns about.
    #[inline]
    #[must_use]
    pub fn z(&self) -> Vector3<f64> {
        self.rotation.column(2).into_owned()
    }

    /// The same transform as an isometry, with its matrix as a quaternion.
    #[must_use]
    pub fn isometry(&self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.origin),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }
}

/// One revolute joint of the arm, with its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointSpec {
    /// Name in the URDF.
    pub name: String,
    /// Parent link frame to this joint's frame at angle 0; the joint turns about z.
    pub origin: Transform,
    /// Lower position limit, rad.
    pub lower_rad: f64,
    /// Upper position limit, rad.
    pub upper_rad: f64,
    /// Largest angular speed, rad/s.
    pub speed_max_rad_s: f64,
    /// Acceleration limit of the servo, rad/s^2.
    pub acceleration_max_rad_s2: f64,
    /// Torque limit, N m.
    pub effort_max_n_m: f64,
}

/// The joints from base to tool, and the tool frame on the last link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chain {
    /// Joints, base first; at most [`MAX_JOINTS`].
    pub joints: Vec<JointSpec>,
    /// Last link frame to tool frame.
    pub tool_from_last: Transform,
}

/// Where every link and the tool are.
#[derive(Clone, Debug)]
pub struct Frames {
    /// Frame of link `i + 1`: the link that joint `i` moves.
    pub links: ArrayVec<Transform, MAX_JOINTS>,
    /// Frame of the tool, in the frame of the base.
    pub tool: Transform,
}

/// Geometric Jacobian of the tool: one column (linear m/rad, angular) per joint.
#[derive(Clone, Debug)]
pub struct Jacobian {
    /// Columns, base first.
    pub columns: ArrayVec<Vector6<f64>, MAX_JOINTS>,
}

impl Jacobian {
    /// Tool velocity (linear, angular) of the given joint velocities.
    #[must_use]
    pub fn twist(&self, dq: &[f64]) -> Vector6<f64> {
        self.columns.iter().zip(dq).map(|(column, v)| column * *v).sum()
    }
}

impl Chain {
    /// Number of joints, at most [`MAX_JOINTS`].
    #[must_use]
    pub fn len(&self) -> usize {
        self.joints.len()
    }

    /// Whether there is no joint at all (never, for a loaded robot).
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.joints.is_empty()
    }

    /// Forward kinematics. Missing values count as 0, surplus ones are ignored.
    #[must_use]
    pub fn frames(&self, q: &[f64]) -> Frames {
        let mut links = ArrayVec::new();
        let mut at = Transform::IDENTITY;
        for (i, joint) in self.joints.iter().enumerate() {
            at = at.then(&joint.origin);
            let (sin, cos) = libm::sincos(q.get(i).copied().unwrap_or(0.0));
            let x = at.rotation.column(0) * cos + at.rotation.column(1) * sin;
            let y = at.rotation.column(1) * cos - at.rotation.column(0) * sin;
            at.rotation.set_column(0, &x);
            at.rotation.set_column(1, &y);
            links.push(at);
        }
        Frames { links, tool: at.then(&self.tool_from_last) }
    }

    /// Pose of the tool in the frame of the base, for joint angles in rad.
    #[must_use]
    pub fn tool(&self, q: &[f64]) -> Isometry3<f64> {
        self.frames(q).tool.isometry()
    }

    /// Geometric Jacobian of the tool for frames already computed.
    #[must_use]
    pub fn jacobian(&self, frames: &Frames) -> Jacobian {
        let column = |link: &Transform| {
            let z = link.z();
            let linear = z.cross(&(frames.tool.origin - link.origin));
            Vector6::new(linear.x, linear.y, linear.z, z.x, z.y, z.z)
        };
        Jacobian { columns: frames.links.iter().map(column).collect() }
    }

    /// The configuration with every angle inside its limits, `margin_rad` away from them.
    #[must_use]
    pub fn clamped(&self, q: &[f64], margin_rad: f64) -> JointVec {
        self.joints
            .iter()
            .zip(q)
            .map(|(joint, angle)| {
                let (low, high) = (joint.lower_rad + margin_rad, joint.upper_rad - margin_rad);
                if low <= high { angle.clamp(low, high) } else { 0.5 * (low + high) }
            })
            .collect()
    }
}
