//! Handles into the physics world, what each collider stands for, and the change between f64 and f32.
#![allow(clippy::cast_possible_truncation, reason = "physics is f32: values are narrowed here")]

use nalgebra::{Isometry3, Vector3};
use rapier3d::dynamics::{MultibodyJointHandle, RigidBodyHandle};
use rapier3d::math::{Pose as RapierPose, Vector};
use serde::{Deserialize, Serialize};

/// What a collider stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ColliderKind {
    /// Arm link by index (0 = base).
    Link(u8),
    /// A finger other than its pad.
    Finger(u8),
    /// A gripping surface.
    Pad(u8),
    /// The cube.
    Object,
    /// The bench.
    Table,
    /// The tray.
    Tray,
    /// Clutter by index.
    Clutter(u8),
    /// A further object.
    Further,
}

/// Handles into the physics world; they stay valid across a snapshot.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Handles {
    /// Arm links, joint 1 first.
    pub links: Vec<RigidBodyHandle>,
    pub fingers: [RigidBodyHandle; 2],
    /// Any joint of the multibody.
    pub first_joint: MultibodyJointHandle,
    /// Multibody link ids: arm joints, then fingers.
    pub link_ids: Vec<usize>,
    pub object: RigidBodyHandle,
    /// The further objects, in the order of their names. A snapshot has them at its end, if there are any.
    #[serde(skip)]
    pub further: Vec<RigidBodyHandle>,
    /// Kind of the collider with raw index `i`.
    pub kinds: Vec<ColliderKind>,
}

/// f64 isometry to rapier's f32 pose.
pub fn to_rapier(isometry: &Isometry3<f64>) -> RapierPose {
    isometry.cast::<f32>().into()
}

/// rapier's f32 pose to an f64 isometry.
pub fn from_rapier(pose: &RapierPose) -> Isometry3<f64> {
    let isometry: Isometry3<f32> = (*pose).into();
    isometry.cast::<f64>()
}

/// An f64 vector as rapier's f32 one.
pub fn to_vector(v: &[f64; 3]) -> Vector {
    Vector::new(v[0] as f32, v[1] as f32, v[2] as f32)
}

/// rapier's f32 vector as an f64 one.
pub fn to_wide(v: Vector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

/// An f64 vector as rapier's f32 one.
pub fn to_narrow(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}
