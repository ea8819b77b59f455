//! How far the robot, and what it holds, may move before anything can come within contact range.
//!
//! A survey at one configuration finds a lower bound of every distance that counts. While no point
//! has moved further than that, nothing can have come near, so most ticks only add up how far the
//! joints have turned. Bounds are conservative: a survey that errs hands a tick to the physics
//! engine, never the other way round.

use nalgebra::{Matrix3, Vector3};
use rapier3d::geometry::{Collider, InteractionGroups, SharedShape};
use rapier3d::math::{Pose as RapierPose, Vector};
use rapier3d::parry::query;
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::dynamics::{ArmDynamics, DOFS_MAX, Dofs, Placement};
use crate::grip::FreeBody;
use crate::handles::{ColliderKind, Handles, from_rapier, to_rapier};
use holdpoint_body::chain::Transform;

/// Closer than this counts as within contact range, m: the engine's prediction distance and a
/// quarter of it.
pub const RANGE_M: f64 = 0.005;
/// The most a survey vouches for, m.
const FAR_M: f64 = 0.12;
/// Boxes closer than this are measured shape by shape, m.
const NEAR_M: f64 = 0.06;

/// A box along the axes of the base.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    centre: Vector3<f64>,
    half: Vector3<f64>,
}

impl Bounds {
    fn of(rotation: &Matrix3<f64>, centre: Vector3<f64>, half: &Vector3<f64>) -> Self {
        Self { centre, half: rotation.abs() * half }
    }

    fn distance(&self, other: &Self) -> f64 {
        let gap = (self.centre - other.centre).abs() - self.half - other.half;
        gap.map(|side| side.max(0.0)).norm()
    }

    fn distance_to_ball(&self, centre: &Vector3<f64>, radius: f64) -> f64 {
        let gap = (self.centre - centre).abs() - self.half;
        gap.map(|side| side.max(0.0)).norm() - radius
    }
}

/// A collision shape of the robot.
struct RobotPart {
    /// The degree of freedom that moves its link.
    link: usize,
    local: Transform,
    half: Vector3<f64>,
    shape: SharedShape,
    groups: InteractionGroups,
    pad: bool,
}

/// A ball around all shapes of a link.
#[derive(Clone, Copy)]
struct BoundingBall {
    centre: Vector3<f64>,
    radius: f64,
    any: bool,
}

/// Something that stands.
struct FixedObstacle {
    bounds: Bounds,
    pose: RapierPose,
    shape: SharedShape,
    groups: InteractionGroups,
}

/// The shapes of a cell.
pub struct Surveyor {
    joints: usize,
    parts: Vec<RobotPart>,
    covers: [BoundingBall; DOFS_MAX],
    fixtures: Vec<FixedObstacle>,
    object: Option<(SharedShape, Vector3<f64>, InteractionGroups)>,
    self_contacts: bool,
}

/// What a survey found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// Configuration at which it was made.
    q: Dofs,
    /// Distance that any point may move from there, m.
    pub slack_m: f64,
    /// Most that a point moves per unit of each degree of freedom within that, m/rad or 1.
    reach: Dofs,
}

impl Survey {
    /// Bound of how far any point has moved since, and of how far it moves in one tick at the given
    /// speeds, m.
    pub fn moved(&self, q: &Dofs, dq: &Dofs, secs: f64) -> f64 {
        let mut sum = 0.0;
        for i in 0..DOFS_MAX {
            sum += self.reach[i] * ((q[i] - self.q[i]).abs() + dq[i].abs() * secs);
        }
        sum
    }
}

fn half_extents(shape: &SharedShape) -> Vector3<f64> {
    let bounds = shape.compute_local_aabb();
    let (low, high) = (bounds.mins, bounds.maxs);
    // All shapes of a cell are symmetric about their own origin.
    Vector3::new(f64::from(high.x.max(-low.x)), f64::from(high.y.max(-low.y)), f64::from(high.z.max(-low.z)))
}

fn meet(a: &InteractionGroups, b: &InteractionGroups) -> bool {
    a.test(*b)
}

impl Surveyor {
    /// Of a cell as built.
    pub fn new(
        dynamics: &ArmDynamics,
        physics: &PhysicsWorld,
        handles: &Handles,
        self_contacts: bool,
    ) -> Self {
        let joints = dynamics.joints();
        let mut parts = Vec::new();
        let mut fixtures = Vec::new();
        let mut object = None;
        for (handle, collider) in physics.colliders.iter() {
            let Some(kind) = handles.kinds.get(handle.into_raw_parts().0 as usize) else { continue };
            match kind {
                ColliderKind::Link(0)
                | ColliderKind::Table
                | ColliderKind::Tray
                | ColliderKind::Clutter(_) => {
                    fixtures.push(FixedObstacle::new(collider));
                }
                ColliderKind::Link(index) => {
                    parts.push(RobotPart::new(usize::from(*index) - 1, collider, false));
                }
                ColliderKind::Finger(side) => {
                    parts.push(RobotPart::new(joints + usize::from(*side), collider, false));
                }
                ColliderKind::Pad(side) => {
                    parts.push(RobotPart::new(joints + usize::from(*side), collider, true));
                }
                ColliderKind::Object => {
                    let shape = collider.shared_shape().clone();
                    object = Some((shape.clone(), half_extents(&shape), collider.collision_groups()));
                }
            }
        }
        let covers = core::array::from_fn(|link| BoundingBall::new(&parts, link));
        Self { joints, parts, covers, fixtures, object, self_contacts }
    }

    /// Lower bound of every relevant distance: the robot to fixed bodies and to itself; the object to fixed bodies
    /// while gripped, and to the whole robot while not.
    pub fn survey(&self, q: &Dofs, place: &Placement, object: &FreeBody, held: bool) -> Survey {
        let balls: [(Vector3<f64>, f64); DOFS_MAX] = core::array::from_fn(|link| {
            (place.frames[link].point(&self.covers[link].centre), self.covers[link].radius)
        });
        let turn = object.rotation.to_rotation_matrix().into_inner();
        let body = self.object.as_ref().map(|(shape, half, groups)| {
            (Bounds::of(&turn, object.position, half), shape, half.norm(), groups)
        });
        let object_pose =
            || to_rapier(&nalgebra::Isometry3::from_parts(object.position.into(), object.rotation));
        let mut least = FAR_M;
        for fixture in &self.fixtures {
            for (link, (centre, radius)) in balls.iter().enumerate() {
                if !self.covers[link].any {
                    continue;
                }
                if fixture.bounds.distance_to_ball(centre, *radius) < least {
                    least = least.min(self.link_to_fixture(place, link, fixture, least));
                }
            }
            if let (true, Some((bounds, shape, _, groups))) = (held, &body)
                && meet(groups, &fixture.groups)
            {
                let coarse = bounds.distance(&fixture.bounds);
                if coarse < least {
                    let pose = object_pose();
                    let exact = || distance(&pose, shape, &fixture.pose, &fixture.shape);
                    least = least.min(if coarse < NEAR_M { exact() } else { coarse });
                }
            }
        }
        if let (false, Some((bounds, shape, _, groups))) = (held, &body) {
            for (link, (centre, radius)) in balls.iter().enumerate() {
                if bounds.distance_to_ball(centre, *radius) >= least {
                    continue;
                }
                for part in self.parts.iter().filter(|part| part.link == link && meet(groups, &part.groups)) {
                    let at = place.frames[link].then(&part.local);
                    let coarse = Bounds::of(&at.rotation, at.origin, &part.half).distance(bounds);
                    if coarse < least {
                        let exact = || distance(&pose_of(&at), &part.shape, &object_pose(), shape);
                        least = least.min(if coarse < NEAR_M { exact() } else { coarse });
                    }
                }
            }
        }
        if self.self_contacts {
            least = least.min(self.to_itself(place, &balls, least));
        }
        let slack_m = (least - RANGE_M).max(0.0);
        Survey { q: *q, slack_m, reach: self.reach(place, &balls, held.then_some(object), slack_m) }
    }

    /// Distance of the held object to everything of the robot but the pads, m.
    pub fn object_in_hand(&self, place: &Placement, object: &FreeBody) -> f64 {
        let Some((shape, half, groups)) = &self.object else { return 0.0 };
        let turn = object.rotation.to_rotation_matrix().into_inner();
        let bounds = Bounds::of(&turn, object.position, half);
        let pose = to_rapier(&nalgebra::Isometry3::from_parts(object.position.into(), object.rotation));
        let mut least = FAR_M;
        for part in self.parts.iter().filter(|part| !part.pad && meet(groups, &part.groups)) {
            let at = place.frames[part.link].then(&part.local);
            if Bounds::of(&at.rotation, at.origin, &part.half).distance(&bounds) < least {
                least = least.min(distance(&pose_of(&at), &part.shape, &pose, shape));
            }
        }
        least
    }

    /// Half extents of the object as the engine has them.
    pub fn object_half(&self) -> Vector {
        let cuboid = self.object.as_ref().and_then(|(shape, _, _)| shape.as_cuboid().map(|c| c.half_extents));
        cuboid.unwrap_or(Vector::ZERO)
    }

    fn link_to_fixture(
        &self,
        place: &Placement,
        link: usize,
        fixture: &FixedObstacle,
        mut least: f64,
    ) -> f64 {
        for part in self.parts.iter().filter(|part| part.link == link && meet(&part.groups, &fixture.groups))
        {
            let at = place.frames[link].then(&part.local);
            let coarse = Bounds::of(&at.rotation, at.origin, &part.half).distance(&fixture.bounds);
            if coarse < least {
                let exact = || distance(&pose_of(&at), &part.shape, &fixture.pose, &fixture.shape);
                least = least.min(if coarse < NEAR_M { exact() } else { coarse });
            }
        }
        least
    }

    fn to_itself(&self, place: &Placement, balls: &[(Vector3<f64>, f64); DOFS_MAX], mut least: f64) -> f64 {
        for (i, a) in self.parts.iter().enumerate() {
            for b in &self.parts[i + 1..] {
                let apart = |other: &RobotPart| balls[other.link];
                let ((at, r), (to, s)) = (apart(a), apart(b));
                if !meet(&a.groups, &b.groups) || (at - to).norm() - r - s >= least {
                    continue;
                }
                let (at, to) = (place.frames[a.link].then(&a.local), place.frames[b.link].then(&b.local));
                let bounds = |pose: &Transform, half| Bounds::of(&pose.rotation, pose.origin, half);
                let coarse = bounds(&at, &a.half).distance(&bounds(&to, &b.half));
                if coarse < least {
                    let exact = || distance(&pose_of(&at), &a.shape, &pose_of(&to), &b.shape);
                    least = least.min(if coarse < NEAR_M { exact() } else { coarse });
                }
            }
        }
        least
    }

    /// Most that any point beyond each joint moves per radian of it, within `slack` of here.
    fn reach(
        &self,
        place: &Placement,
        balls: &[(Vector3<f64>, f64); DOFS_MAX],
        held: Option<&FreeBody>,
        slack: f64,
    ) -> Dofs {
        let mut reach = [0.0; DOFS_MAX];
        for (joint, most) in reach.iter_mut().enumerate().take(self.joints) {
            let (origin, axis) = (place.frames[joint].origin, place.axes[joint].angular);
            let from_axis = |point: &Vector3<f64>| axis.cross(&(point - origin)).norm();
            let links = balls.iter().enumerate().take(self.joints + 2).skip(joint);
            *most = links.fold(0.0_f64, |most, (_, (centre, radius))| most.max(from_axis(centre) + radius));
            if let (Some(object), Some((_, half, _))) = (held, &self.object) {
                *most = most.max(from_axis(&object.position) + half.norm());
            }
            *most += slack;
        }
        // A finger moves itself; what it presses on goes with the hand.
        (reach[self.joints], reach[self.joints + 1]) = (1.0, 1.0);
        reach
    }
}

impl FixedObstacle {
    fn new(collider: &Collider) -> Self {
        let at = from_rapier(collider.position());
        let turn = at.rotation.to_rotation_matrix().into_inner();
        let bounds = Bounds::of(&turn, at.translation.vector, &half_extents(collider.shared_shape()));
        Self {
            bounds,
            pose: *collider.position(),
            shape: collider.shared_shape().clone(),
            groups: collider.collision_groups(),
        }
    }
}

impl RobotPart {
    fn new(link: usize, collider: &Collider, pad: bool) -> Self {
        let local = collider.position_wrt_parent().map(from_rapier).unwrap_or_default();
        Self {
            link,
            local: Transform::new(&local),
            half: half_extents(collider.shared_shape()),
            shape: collider.shared_shape().clone(),
            groups: collider.collision_groups(),
            pad,
        }
    }
}

impl BoundingBall {
    fn new(parts: &[RobotPart], link: usize) -> Self {
        let own = || parts.iter().filter(|part| part.link == link);
        let count = own().count();
        if count == 0 {
            return Self { centre: Vector3::zeros(), radius: 0.0, any: false };
        }
        let centre = own().map(|part| part.local.origin).sum::<Vector3<f64>>() / count as f64;
        let radius = own()
            .fold(0.0_f64, |most, part| most.max((part.local.origin - centre).norm() + part.half.norm()));
        Self { centre, radius, any: true }
    }
}

fn pose_of(at: &Transform) -> RapierPose {
    to_rapier(&at.isometry())
}

/// Distance of two shapes, 0 where they meet or the distance is unknown, m.
fn distance(at: &RapierPose, a: &SharedShape, to: &RapierPose, b: &SharedShape) -> f64 {
    query::distance(at, &**a, to, &**b).map_or(0.0, |found| f64::from(found.distance))
}
