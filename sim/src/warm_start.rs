//! What the physics engine starts its contacts from in a tick, where that is not what it remembers.
//!
//! The engine starts every contact from the impulse of its last substep. After ticks in which it
//! rested, a grip's impulses are others; after a tick with more or fewer substeps, the same force is
//! another impulse. Either would shake what is held. The impulses are put right while the contacts of
//! the tick are found, the one place at which the engine lets them be written.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use arrayvec::ArrayVec;
use rapier3d::geometry::{ContactData, ContactManifold, ContactManifoldData, Shape};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::query::details::{NormalConstraints, ShapeCastOptions};
use rapier3d::parry::query::{
    ClosestPoints, Contact, ContactManifoldsWorkspace, DefaultQueryDispatcher, NonlinearRigidMotion,
    PersistentQueryDispatcher, QueryDispatcher, ShapeCastHit, ShapeDistance, ShapeIntersection, Unsupported,
};

use crate::object_contacts::CONTACTS_MAX;

/// The impulse that a point of the object's surface starts from.
#[derive(Clone, Copy, Debug)]
pub struct WarmPoint {
    /// Where, object frame.
    pub on_object: Vector,
    /// Normal of the surface there, out of the object, object frame.
    pub out_of_object: Vector,
    /// Normal impulse, N s.
    pub impulse: f32,
    /// Friction on the pad, base frame, N s.
    pub tangent: Vector,
    /// Moment of the friction about the normal, N m s, where the engine has one for a whole face.
    pub twist: f32,
}

/// The impulses of one tick's contacts.
#[derive(Clone, Debug, Default)]
pub struct WarmStart {
    /// What the engine remembers counts this many times.
    pub scale: f32,
    /// Of the object it remembers nothing that still holds.
    pub object_moved: bool,
    /// Points of the object, which go before what it remembers.
    pub points: ArrayVec<WarmPoint, CONTACTS_MAX>,
    /// Half extents of the object, by which its shape is known.
    pub object_half: Vector,
}

/// Points further apart than this are not the same, m.
pub const SAME_POINT_M: f32 = 0.003;

/// Cosine between the normals of two points of one face, at least.
pub const SAME_FACE: f32 = 0.7;

impl WarmStart {
    fn is_object(&self, shape: &dyn Shape) -> bool {
        shape.as_cuboid().is_some_and(|cuboid| cuboid.half_extents == self.object_half)
    }

    fn put_right(&self, (first, second): (&dyn Shape, &dyn Shape), manifold: &mut ContactManifold) {
        let object_first = self.is_object(first);
        let of_object = object_first || self.is_object(second);
        let normal = if object_first { manifold.local_n1 } else { manifold.local_n2 };
        for contact in &mut manifold.points {
            let at = if object_first { contact.local_p1 } else { contact.local_p2 };
            // Near an edge, points of two faces are close to one another.
            let same_face = self.points.iter().filter(|point| point.out_of_object.dot(normal) > SAME_FACE);
            let near = same_face.map(|point| (point, (point.on_object - at).length()));
            let nearest = near.min_by(|a, b| a.1.total_cmp(&b.1));
            let data = &mut contact.data;
            match nearest {
                Some((point, distance)) if of_object && distance < SAME_POINT_M => {
                    // What the engine sums up of a tick is what it solves in it.
                    (data.impulse, data.warmstart_impulse) = (0.0, point.impulse);
                    data.warmstart_tangent_world = if object_first { -point.tangent } else { point.tangent };
                    data.warmstart_twist_impulse = point.twist;
                }
                _ if of_object && self.object_moved => *data = ContactData::default(),
                _ => {
                    data.warmstart_impulse *= self.scale;
                    data.warmstart_tangent_world *= self.scale;
                    data.warmstart_tangent_impulse *= self.scale;
                    data.warmstart_twist_impulse *= self.scale;
                }
            }
        }
    }
}

impl PersistentQueryDispatcher<ContactManifoldData, ContactData> for WarmStart {
    fn contact_manifolds(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        prediction: f32,
        manifolds: &mut Vec<ContactManifold>,
        workspace: &mut Option<ContactManifoldsWorkspace>,
    ) -> Result<(), Unsupported> {
        DefaultQueryDispatcher.contact_manifolds(pos12, g1, g2, prediction, manifolds, workspace)?;
        for manifold in manifolds {
            self.put_right((g1, g2), manifold);
        }
        Ok(())
    }

    fn contact_manifold_convex_convex(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        normal_constraints1: Option<&dyn NormalConstraints>,
        normal_constraints2: Option<&dyn NormalConstraints>,
        prediction: f32,
        manifold: &mut ContactManifold,
    ) -> Result<(), Unsupported> {
        DefaultQueryDispatcher.contact_manifold_convex_convex(
            pos12,
            g1,
            g2,
            normal_constraints1,
            normal_constraints2,
            prediction,
            manifold,
        )
    }
}

impl QueryDispatcher for WarmStart {
    fn intersection_test(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
    ) -> Result<ShapeIntersection, Unsupported> {
        DefaultQueryDispatcher.intersection_test(pos12, g1, g2)
    }

    fn distance(&self, pos12: &Pose, g1: &dyn Shape, g2: &dyn Shape) -> Result<ShapeDistance, Unsupported> {
        DefaultQueryDispatcher.distance(pos12, g1, g2)
    }

    fn contact(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        prediction: f32,
    ) -> Result<Option<Contact>, Unsupported> {
        DefaultQueryDispatcher.contact(pos12, g1, g2, prediction)
    }

    fn closest_points(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        max_dist: f32,
    ) -> Result<ClosestPoints, Unsupported> {
        DefaultQueryDispatcher.closest_points(pos12, g1, g2, max_dist)
    }

    fn cast_shapes(
        &self,
        pos12: &Pose,
        local_vel12: Vector,
        g1: &dyn Shape,
        g2: &dyn Shape,
        options: ShapeCastOptions,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        DefaultQueryDispatcher.cast_shapes(pos12, local_vel12, g1, g2, options)
    }

    fn cast_shapes_nonlinear(
        &self,
        motion1: &NonlinearRigidMotion,
        g1: &dyn Shape,
        motion2: &NonlinearRigidMotion,
        g2: &dyn Shape,
        start_time: f32,
        end_time: f32,
        stop_at_penetration: bool,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        DefaultQueryDispatcher.cast_shapes_nonlinear(
            motion1,
            g1,
            motion2,
            g2,
            start_time,
            end_time,
            stop_at_penetration,
        )
    }
}
