//! A free rigid body in f64: the object while the arm's own dynamics move it.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d::dynamics::RigidBody;
use serde::{Deserialize, Serialize};

use crate::handles::{from_rapier, to_wide};

/// A free rigid body with the same inertia about every axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FreeBody {
    /// Center.
    #[serde(with = "plain")]
    pub position: Vector3<f64>,
    /// Orientation.
    #[serde(with = "plain_turn")]
    pub rotation: UnitQuaternion<f64>,
    /// Velocity of the center, m/s.
    #[serde(with = "plain")]
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    #[serde(with = "plain")]
    pub angular: Vector3<f64>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Inertia about any axis, kg m^2.
    pub inertia_kg_m2: f64,
}

impl FreeBody {
    /// The engine's body as a body of its own; None for one that does not turn as a cube does.
    pub fn of(body: &RigidBody) -> Option<Self> {
        let local = body.mass_properties().local_mprops;
        let inertia = local.principal_inertia();
        let (least, most) = (inertia.min_element(), inertia.max_element());
        if !(least > 0.0 && most - least <= 1e-5 * most && local.local_com.length() <= 1e-6) {
            return None;
        }
        let at = from_rapier(body.position());
        Some(Self {
            position: at.translation.vector,
            rotation: at.rotation,
            linear: to_wide(body.linvel()),
            angular: to_wide(body.angvel()),
            mass_kg: f64::from(body.mass()),
            inertia_kg_m2: f64::from(most),
        })
    }

    /// Pose in the base frame.
    pub fn pose(&self) -> Isometry3<f64> {
        Isometry3::from_parts(self.position.into(), self.rotation)
    }

    /// Moves for a while at the present speeds.
    pub fn advance(&mut self, secs: f64) {
        self.position += self.linear * secs;
        let turn = nalgebra::Quaternion::from_parts(0.0, self.angular * (0.5 * secs));
        let next = self.rotation.into_inner() + turn * self.rotation.into_inner();
        self.rotation = UnitQuaternion::new_normalize(next);
    }
}

/// Vectors in a snapshot: three numbers.
mod plain {
    use nalgebra::Vector3;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(v: &Vector3<f64>, out: S) -> Result<S::Ok, S::Error> {
        [v.x, v.y, v.z].serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vector3<f64>, D::Error> {
        Ok(Vector3::from(<[f64; 3]>::deserialize(from)?))
    }
}

/// Orientations in a snapshot: x, y, z, w, to the bit.
mod plain_turn {
    use nalgebra::{Quaternion, UnitQuaternion};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(r: &UnitQuaternion<f64>, out: S) -> Result<S::Ok, S::Error> {
        [r.i, r.j, r.k, r.w].serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<UnitQuaternion<f64>, D::Error> {
        let [i, j, k, w] = <[f64; 4]>::deserialize(from)?;
        Ok(UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k)))
    }
}
