//! Where a moving object touches the pads and what stands in the cell.
//!
//! The collision detection is the physics engine's ([`rapier3d::parry`]), with the engine's settings: one contact
//! manifold per pair, at most four points of it, impulses carried from tick to tick by the points' features. Poses
//! and directions in the base frame unless a name says otherwise.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use rapier3d::geometry::{Collider, ColliderHandle, NEW_CONTACT_BIT, SharedShape};
use rapier3d::math::{Matrix, Pose as RapierPose, Rotation};
use rapier3d::parry::query::{
    ContactManifold, DefaultQueryDispatcher, PersistentQueryDispatcher, TrackedContact,
};
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::constraints::Softness;
use crate::dynamics::Placement;
use crate::free_body::FreeBody;
use crate::handles::{ColliderKind, Handles, from_rapier, to_narrow, to_wide};
use crate::readout;
use crate::survey::Bounds;
use crate::warm_start::{SAME_FACE, SAME_POINT_M, WarmPoint};
use holdpoint_body::TICK_SECS;
use holdpoint_body::chain::Transform;
use holdpoint_cell::truth::ContactPoint;

/// The most faces on which the object touches anything at one time, and the most contact points.
pub const FACES_MAX: usize = 6;
pub const CONTACTS_MAX: usize = FACES_MAX * POINTS_PER_FACE;
/// The most points of one face that carry: more do not make the contact firmer.
pub const POINTS_PER_FACE: usize = 4;
/// The most points that two faces of boxes meet in.
const POINTS_FOUND_MAX: usize = 16;

/// Friction of one face in the last tick, at the middle of its points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FaceFriction {
    /// On the first body, N s.
    tangent: [f64; 3],
    /// On the first body about the direction of the force on it, N m s.
    twist: f64,
}

/// The contact of one pair, as it goes on from tick to tick. Each point has its normal impulse, N s.
pub type Manifold = ContactManifold<FaceFriction, f64>;

/// What the object may touch.
pub struct ObjectPair {
    collider: ColliderHandle,
    /// A pad, or what of the cell it is.
    pub kind: ColliderKind,
    /// The finger of a pad.
    pub side: Option<usize>,
    /// Pose in the finger's frame for a pad, in the base frame else.
    pose: Transform,
    shape: SharedShape,
    half: Vector3<f64>,
    bounds: Bounds,
    friction: f64,
    softness: Softness,
}

/// One point at which the object touches a pad or something that stands.
#[derive(Clone, Copy, Debug)]
pub struct ObjectContact {
    /// Index of the point in the pair's manifold.
    point: usize,
    /// Where the force acts.
    pub at: Vector3<f64>,
    /// Distance of the two surfaces, below 0 where they overlap, m.
    pub gap_m: f64,
    /// Normal impulse of the last tick, then of this, N s.
    pub impulse: f64,
    /// Mean normal force of the tick, N.
    pub force_n: f64,
}

/// Where the object touches one pad or one thing that stands.
#[derive(Clone, Debug)]
pub struct ContactFace {
    /// Index of the pair.
    pub pair: usize,
    /// The finger of a pad.
    pub side: Option<usize>,
    /// Direction of the force on the first body, a unit vector.
    pub direction: Vector3<f64>,
    /// Coulomb coefficient.
    pub friction: f64,
    /// How soft the contact is.
    pub softness: Softness,
    /// One to four points.
    pub points: ArrayVec<ObjectContact, POINTS_PER_FACE>,
    /// Middle of the points.
    pub center: Vector3<f64>,
    /// Friction impulse on the first body, N s.
    pub tangent: Vector3<f64>,
    /// Moment of the friction on the first body about the direction, N m s.
    pub twist: f64,
}

/// The contacts of one tick.
pub type ObjectContacts = ArrayVec<ContactFace, FACES_MAX>;

/// Everything that an object may touch in a cell while the engine rests.
pub struct ObjectPairs {
    joints: usize,
    pairs: Vec<ObjectPair>,
    object: Option<SharedShape>,
    radius: f64,
    range_m: f64,
}

/// The part of the search for fixtures that goes on from tick to tick: around `at`, nothing that stands is within
/// `room_m` of the object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FixtureRoom {
    at: [f64; 3],
    room_m: f64,
}

impl ObjectPair {
    fn new(
        (handle, kind): (ColliderHandle, ColliderKind),
        collider: &Collider,
        object: &Collider,
        softness: Softness,
    ) -> Self {
        let side = if let ColliderKind::Pad(side) = kind { Some(usize::from(side)) } else { None };
        let local = if side.is_some() {
            collider.position_wrt_parent().map(from_rapier).unwrap_or_default()
        } else {
            from_rapier(collider.position())
        };
        let pose = Transform::new(&local);
        let half = crate::survey::half_extents(collider.shared_shape());
        Self {
            collider: handle,
            kind,
            side,
            bounds: Bounds::of(&pose.rotation, pose.origin, &half),
            pose,
            shape: collider.shared_shape().clone(),
            half,
            // The object's rule (see `build.rs`) goes before those of all that it touches.
            friction: f64::from(collider.friction().min(object.friction())),
            softness,
        }
    }
}

impl ObjectPairs {
    /// Of a cell as built.
    pub fn new(joints: usize, physics: &PhysicsWorld, handles: &Handles) -> Self {
        let parameters = &physics.integration_parameters;
        let range_m = f64::from(parameters.prediction_distance());
        let of_kind = |handle: ColliderHandle| handles.kinds.get(handle.into_raw_parts().0 as usize);
        let object =
            physics.colliders.iter().find(|(handle, _)| of_kind(*handle) == Some(&ColliderKind::Object));
        let Some((_, object)) = object else {
            return Self { joints, pairs: Vec::new(), object: None, radius: 0.0, range_m };
        };
        let mut pairs = Vec::new();
        for (handle, collider) in physics.colliders.iter() {
            let Some(kind) = of_kind(handle) else { continue };
            let softness = match kind {
                ColliderKind::Pad(_) => parameters.contact_softness,
                ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_) => {
                    parameters.static_contact_softness
                }
                // The engine takes over before the object meets one of these.
                ColliderKind::Link(_)
                | ColliderKind::Finger(_)
                | ColliderKind::Object
                | ColliderKind::Further => continue,
            };
            let softness = Softness {
                frequency_hz: f64::from(softness.natural_frequency),
                ratio: f64::from(softness.damping_ratio),
            };
            pairs.push(ObjectPair::new((handle, *kind), collider, object, softness));
        }
        // What stands, then one pad after the other: the engine's order.
        pairs.sort_by_key(|pair| pair.side.map_or(0, |side| side + 1));
        let shape = object.shared_shape().clone();
        let radius = crate::survey::half_extents(&shape).norm();
        Self { joints, pairs, object: Some(shape), radius, range_m }
    }

    /// The pairs, in the order of the manifolds.
    pub fn pairs(&self) -> &[ObjectPair] {
        &self.pairs
    }

    /// Manifolds of a cell in which nothing touches.
    pub fn empty_manifolds(&self) -> Vec<Manifold> {
        let manifold = || {
            let mut manifold = Manifold::new();
            manifold.points.reserve(POINTS_FOUND_MAX);
            manifold
        };
        self.pairs.iter().map(|_| manifold()).collect()
    }

    /// Finds the points at which the object touches anything, or is about to; None where there are more than fit.
    pub fn find(
        &self,
        manifolds: &mut [Manifold],
        room: &mut FixtureRoom,
        place: &Placement,
        object: &FreeBody,
        turn: &Matrix3<f64>,
        contacts: &mut ObjectContacts,
    ) -> Option<()> {
        contacts.clear();
        let shape = self.object.as_ref()?;
        let apart = self.radius + self.range_m;
        let fixtures_far = (object.position - Vector3::from(room.at)).norm() < room.room_m;
        let mut least = f64::INFINITY;
        for (index, (pair, manifold)) in self.pairs.iter().zip(manifolds).enumerate() {
            let pose = match pair.side {
                Some(side) => {
                    let pose = place.frames[self.joints + side].then(&pair.pose);
                    if (pose.origin - object.position).norm() > pair.half.norm() + apart {
                        leave(manifold);
                        continue;
                    }
                    pose
                }
                None if fixtures_far => {
                    leave(manifold);
                    continue;
                }
                None => {
                    let room = pair.bounds.distance_to_ball(&object.position, apart);
                    least = least.min(room);
                    if room > 0.0 {
                        leave(manifold);
                        continue;
                    }
                    pair.pose
                }
            };
            let relative = relative_pose(&pose, turn, &object.position);
            detect(&relative, &pair.shape, shape, self.range_m as f32, manifold)?;
            let chosen = strongest_four(manifold, self.range_m as f32);
            let mut points = ArrayVec::new();
            let direction = -(pose.rotation * to_wide(manifold.local_n1));
            for (point, tracked) in manifold.points.iter_mut().enumerate() {
                if !chosen.contains(&point) {
                    tracked.data = 0.0;
                    continue;
                }
                let (on_first, on_object) = (
                    pose.point(&to_wide(tracked.local_p1)),
                    object.position + turn * to_wide(tracked.local_p2),
                );
                points.push(ObjectContact {
                    point,
                    at: (on_first + on_object) * 0.5,
                    gap_m: (on_first - on_object).dot(&direction),
                    impulse: tracked.data,
                    force_n: 0.0,
                });
            }
            if points.is_empty() {
                manifold.data = FaceFriction::default();
                continue;
            }
            let middle = points.iter().map(|point| point.at).sum::<Vector3<f64>>() / points.len() as f64;
            let face = ContactFace {
                pair: index,
                side: pair.side,
                direction,
                friction: pair.friction,
                softness: pair.softness,
                points,
                center: middle,
                tangent: Vector3::from(manifold.data.tangent),
                // A single point has no lever.
                twist: if chosen.len() > 1 { manifold.data.twist } else { 0.0 },
            };
            contacts.try_push(face).ok()?;
        }
        if !fixtures_far {
            *room = FixtureRoom { at: object.position.into(), room_m: least.max(0.0) };
        }
        Some(())
    }

    /// Keeps the impulses of a tick for the next.
    pub fn store(manifolds: &mut [Manifold], contacts: &ObjectContacts) {
        for face in contacts {
            let Some(manifold) = manifolds.get_mut(face.pair) else { continue };
            manifold.data = FaceFriction { tangent: face.tangent.into(), twist: face.twist };
            for contact in &face.points {
                if let Some(point) = manifold.points.get_mut(contact.point) {
                    point.data = contact.impulse;
                }
            }
        }
    }

    /// Takes over the impulses of the engine, which are those of the last of its `substeps`; `turn` is the object's.
    pub fn take_over(
        &self,
        manifolds: &mut [Manifold],
        physics: &PhysicsWorld,
        handles: &Handles,
        turn: &Matrix3<f64>,
        substeps: usize,
    ) {
        let whole = substeps as f64;
        for pair in physics.narrow_phase.contact_pairs().filter(|pair| pair.has_any_active_contact()) {
            let kinds = [readout::kind(handles, pair, true), readout::kind(handles, pair, false)];
            let object_first = match kinds {
                [Some(ColliderKind::Object), Some(_)] => true,
                [Some(_), Some(ColliderKind::Object)] => false,
                _ => continue,
            };
            let other = if object_first { pair.collider2 } else { pair.collider1 };
            let own = self.pairs.iter().zip(manifolds.iter_mut()).find(|(own, _)| own.collider == other);
            let Some((own, manifold)) = own else { continue };
            for engine in pair.solver_manifolds() {
                let out_of_object = if object_first { engine.local_n1 } else { engine.local_n2 };
                if manifold.local_n2.dot(out_of_object) < SAME_FACE {
                    continue;
                }
                let mut points = ArrayVec::<(Vector3<f64>, Vector3<f64>), POINTS_PER_FACE>::new();
                let mut twist = 0.0;
                for contact in &engine.data.solver_contacts {
                    let index = (contact.contact_id[0] & !NEW_CONTACT_BIT) as usize;
                    let Some(point) = engine.points.get(index) else { continue };
                    let on_object = to_wide(if object_first { point.local_p1 } else { point.local_p2 });
                    give(manifold, on_object, f64::from(point.data.warmstart_impulse) * whole);
                    let rub = to_wide(point.data.warmstart_tangent_world) * whole;
                    twist = f64::from(point.data.warmstart_twist_impulse) * whole;
                    if points.try_push((turn * on_object, if object_first { -rub } else { rub })).is_err() {
                        break;
                    }
                }
                let count = points.len().max(1) as f64;
                let all: Vector3<f64> = points.iter().map(|(_, rub)| rub).sum();
                manifold.data = if own.side.is_none() {
                    // With what stands, the engine has one friction for all points, which each of them remembers.
                    FaceFriction { tangent: (all / count).into(), twist }
                } else {
                    let middle = points.iter().map(|(at, _)| at).sum::<Vector3<f64>>() / count;
                    let moment: Vector3<f64> = points.iter().map(|(at, rub)| (at - middle).cross(rub)).sum();
                    let direction = turn * to_wide(out_of_object);
                    FaceFriction { tangent: all.into(), twist: moment.dot(&direction) }
                };
            }
        }
    }

    /// Middle and normal force of every pair that pressed in the last tick.
    pub fn contact_points(
        &self,
        manifolds: &[Manifold],
        place: &Placement,
        object: &FreeBody,
    ) -> Vec<ContactPoint> {
        let mut points = Vec::new();
        for (pair, manifold) in self.pairs.iter().zip(manifolds) {
            let pose = pair.side.map_or(pair.pose, |side| place.frames[self.joints + side].then(&pair.pose));
            let (mut at, mut impulse, mut count) = (Vector3::zeros(), 0.0, 0.0_f64);
            for point in manifold.points.iter().filter(|point| point.data > 0.0) {
                let on_object = object.position + object.rotation * to_wide(point.local_p2);
                at += (pose.point(&to_wide(point.local_p1)) + on_object) * 0.5;
                (impulse, count) = (impulse + point.data, count + 1.0);
            }
            if count > 0.0 {
                // On the robot, or on the object where the robot has no part in it.
                let sign = if pair.side.is_some() { -1.0 } else { 1.0 };
                let force = pose.rotation * to_wide(manifold.local_n1) * (sign * impulse / TICK_SECS);
                points.push(ContactPoint { at_m: (at / count).into(), force_n: force.into() });
            }
        }
        points
    }

    /// What the engine's contacts of the next tick, with `substeps`, start from; `turn` is the object's.
    pub fn warm_points(
        &self,
        manifolds: &[Manifold],
        turn: &Matrix3<f64>,
        substeps: usize,
    ) -> ArrayVec<WarmPoint, CONTACTS_MAX> {
        let share = 1.0 / substeps as f64;
        let mut warm = ArrayVec::new();
        for (pair, manifold) in self.pairs.iter().zip(manifolds) {
            let points = || manifold.points.iter().filter(|point| point.data > 0.0);
            let pressed: f64 = points().map(|point| point.data).sum();
            let middle: Vector3<f64> =
                points().map(|point| to_wide(point.local_p2) * (point.data / pressed)).sum();
            let lever = |point: &TrackedContact<f64>| turn * (to_wide(point.local_p2) - middle);
            let spread: f64 =
                points().map(|point| lever(point).norm_squared() * (point.data / pressed)).sum();
            let (all, twist) = (Vector3::from(manifold.data.tangent) * share, manifold.data.twist * share);
            let direction = turn * to_wide(manifold.local_n2);
            for point in points() {
                // See `take_over`.
                let (tangent, twist) = if pair.side.is_none() {
                    (all, twist)
                } else {
                    let turning = direction.cross(&lever(point)) * (twist / spread.max(f64::MIN_POSITIVE));
                    ((all + turning) * (point.data / pressed), 0.0)
                };
                let point = WarmPoint {
                    on_object: point.local_p2,
                    out_of_object: manifold.local_n2,
                    impulse: (point.data * share) as f32,
                    tangent: to_narrow(&tangent),
                    twist: twist as f32,
                };
                if warm.try_push(point).is_err() {
                    return warm;
                }
            }
        }
        warm
    }
}

/// Every impulse of a contact.
pub fn impulses(manifold: &Manifold) -> impl Iterator<Item = f64> + '_ {
    let friction = manifold.data.tangent.into_iter().chain([manifold.data.twist]);
    manifold.points.iter().map(|point| point.data).chain(friction)
}

/// Nothing touches any more.
fn leave(manifold: &mut Manifold) {
    manifold.points.clear();
    manifold.data = FaceFriction::default();
}

/// Gives an impulse to the nearest point of the object.
fn give(manifold: &mut Manifold, on_object: Vector3<f64>, impulse: f64) {
    let points = manifold.points.iter_mut();
    let near = points.map(|point| ((to_wide(point.local_p2) - on_object).norm(), point));
    if let Some((distance, point)) = near.min_by(|a, b| a.0.total_cmp(&b.0))
        && distance < f64::from(SAME_POINT_M)
    {
        point.data = impulse;
    }
}

/// The object's pose in the frame of what it may touch.
fn relative_pose(first: &Transform, turn: &Matrix3<f64>, position: &Vector3<f64>) -> RapierPose {
    let back = first.rotation.transpose();
    let rotation: Matrix = (back * turn).cast::<f32>().into();
    RapierPose::from_parts(to_narrow(&(back * (position - first.origin))), Rotation::from_mat3(&rotation))
}

/// The engine's detection, without what it takes from the allocator to carry the impulses on.
fn detect(
    relative: &RapierPose,
    first: &SharedShape,
    object: &SharedShape,
    range_m: f32,
    manifold: &mut Manifold,
) -> Option<()> {
    if manifold.try_update_contacts(relative) {
        return Some(());
    }
    let old: ArrayVec<TrackedContact<f64>, POINTS_FOUND_MAX> =
        manifold.points.iter().copied().take(POINTS_FOUND_MAX).collect();
    manifold.points.clear();
    DefaultQueryDispatcher
        .contact_manifold_convex_convex(relative, &**first, &**object, None, None, range_m, manifold)
        .ok()?;
    manifold.match_contacts(&old);
    Some(())
}

/// The deepest point within range, the one furthest from it, and the furthest on either side of the line between.
fn strongest_four(manifold: &Manifold, range_m: f32) -> ArrayVec<usize, POINTS_PER_FACE> {
    let points = &manifold.points;
    let near = || points.iter().enumerate().filter(|(_, point)| point.dist < range_m);
    if points.len() <= POINTS_PER_FACE {
        return near().map(|(index, _)| index).collect();
    }
    let mut chosen = ArrayVec::new();
    let Some((deepest, a)) = near().min_by(|a, b| a.1.dist.total_cmp(&b.1.dist)) else { return chosen };
    chosen.push(deepest);
    let from = |point: &TrackedContact<f64>| point.local_p1 - a.local_p1;
    let furthest =
        near().max_by(|(_, p), (_, q)| from(p).length_squared().total_cmp(&from(q).length_squared()));
    let Some((furthest, b)) = furthest.filter(|(index, _)| *index != deepest) else { return chosen };
    chosen.push(furthest);
    let across = (b.local_p1 - a.local_p1).cross(manifold.local_n1);
    let side = |point: &TrackedContact<f64>| from(point).dot(across);
    let rest = || near().filter(|(index, _)| *index != deepest && *index != furthest);
    let left = rest().min_by(|(_, p), (_, q)| side(p).total_cmp(&side(q)));
    let right = rest().max_by(|(_, p), (_, q)| side(p).total_cmp(&side(q)));
    for (index, _) in left.into_iter().chain(right) {
        if !chosen.contains(&index) {
            chosen.push(index);
        }
    }
    chosen
}
