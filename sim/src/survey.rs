//! How far the robot and the object may move before anything can come within contact range.
//!
//! A survey at one configuration finds lower bounds of every distance that counts. While no point
//! has moved further than that, nothing can have come near, so most ticks only add up how far the
//! joints have turned. Bounds are conservative: a survey that errs hands a tick to the physics
//! engine, never the other way round.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use rapier3d::geometry::{Collider, ColliderHandle, InteractionGroups, SharedShape};
use rapier3d::math::{Pose as RapierPose, Vector};
use rapier3d::parry::query;
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::dynamics::{ArmDynamics, DOFS_MAX, Dofs, Placement};
use crate::free_body::FreeBody;
use crate::handles::{ColliderKind, Handles, from_rapier, to_rapier};
use holdpoint_body::FURTHER_OBJECTS_MAX;
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
pub struct Bounds {
    centre: Vector3<f64>,
    half: Vector3<f64>,
}

impl Bounds {
    /// Around a box that is turned.
    pub fn of(rotation: &Matrix3<f64>, centre: Vector3<f64>, half: &Vector3<f64>) -> Self {
        Self { centre, half: rotation.abs() * half }
    }

    fn distance(&self, other: &Self) -> f64 {
        let gap = (self.centre - other.centre).abs() - self.half - other.half;
        gap.map(|side| side.max(0.0)).norm()
    }

    /// Distance to a ball, at most 0 where they overlap, m.
    pub fn distance_to_ball(&self, centre: &Vector3<f64>, radius: f64) -> f64 {
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
    /// The robot's own base.
    robot: bool,
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
    /// The further objects: they stand while the engine rests, each time where it left them.
    further: Vec<ColliderHandle>,
    self_contacts: bool,
}

/// What a survey found: how far things may move before they come within contact range, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Survey {
    /// Configuration at which it was made.
    q: Dofs,
    /// Most that a point of the robot moves per unit of each degree of freedom within that, m/rad or 1.
    reach: Dofs,
    /// Center of the object then.
    object_at: [f64; 3],
    /// Its pose in the frame of the hand: position, then the rotation's columns.
    in_hand: [f64; 12],
    /// The robot to what stands and to further objects, and to itself.
    pub robot_m: f64,
    /// The object to the arm before the hand, and to further objects.
    pub arm_object_m: f64,
    /// The object to the hand and the fingers without their pads.
    pub hand_object_m: f64,
    /// The object to the pads.
    pub pads_object_m: f64,
}

/// Bounds of how far things have moved since a survey, and will in the next tick, m.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "the unit")]
pub struct Moved {
    /// Any point of the robot.
    pub robot_m: f64,
    /// The object's center.
    pub object_m: f64,
    /// The object as seen from hand and fingers.
    pub in_hand_m: f64,
}

impl Survey {
    /// Bound of how far any point of the robot has moved since, and will in one tick at the given speeds, m.
    pub fn robot_moved(&self, q: &Dofs, dq: &Dofs, secs: f64) -> f64 {
        let mut sum = 0.0;
        for i in 0..DOFS_MAX {
            sum += self.reach[i] * ((q[i] - self.q[i]).abs() + dq[i].abs() * secs);
        }
        sum
    }

    /// The same with a moving object, whose orientation is `turn`.
    pub fn moved(
        &self,
        surveyor: &Surveyor,
        (q, dq): (&Dofs, &Dofs),
        place: &Placement,
        object: &FreeBody,
        turn: &Matrix3<f64>,
        secs: f64,
    ) -> Moved {
        let robot_m = self.robot_moved(q, dq, secs);
        let object_m = (object.position - Vector3::from(self.object_at)).norm() + object.linear.norm() * secs;
        let now = surveyor.in_hand(place, object, turn);
        let apart = |from: usize, to: usize| {
            (from..to).map(|i| (now[i] - self.in_hand[i]) * (now[i] - self.in_hand[i])).sum::<f64>()
        };
        // A turn by an angle a is sqrt(8) sin(a / 2) in the norm of the matrices' difference, and moves a point at
        // the radius r by 2 r sin(a / 2).
        let turned = surveyor.object_radius() * libm::sqrt(0.5 * apart(3, 12));
        let n = surveyor.joints;
        let finger = |i: usize| (q[i] - self.q[i]).abs() + dq[i].abs() * secs;
        let fingers = finger(n).max(finger(n + 1));
        // The object's speeds as seen from the hand.
        let (mut turning, mut speed) = (-object.angular, -object.linear);
        for (axis, rate) in place.axes.iter().zip(dq).take(n) {
            turning += axis.angular * *rate;
            speed += (axis.linear + axis.angular.cross(&object.position)) * *rate;
        }
        let next = (speed.norm() + surveyor.object_radius() * turning.norm()) * secs;
        Moved { robot_m, object_m, in_hand_m: libm::sqrt(apart(0, 3)) + turned + fingers + next }
    }
}

/// Half the sides of the box around a shape, m.
pub fn half_extents(shape: &SharedShape) -> Vector3<f64> {
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
        let mut further = Vec::new();
        for (handle, collider) in physics.colliders.iter() {
            let Some(kind) = handles.kinds.get(handle.into_raw_parts().0 as usize) else { continue };
            match kind {
                ColliderKind::Link(0) => fixtures.push(FixedObstacle::new(collider, true)),
                ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_) => {
                    fixtures.push(FixedObstacle::new(collider, false));
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
                ColliderKind::Further => further.push(handle),
            }
        }
        let covers = core::array::from_fn(|link| BoundingBall::new(&parts, link));
        Self { joints, parts, covers, fixtures, object, further, self_contacts }
    }

    /// Lower bounds of every distance that counts, for an object with the orientation `turn`.
    pub fn survey(
        &self,
        physics: &PhysicsWorld,
        q: &Dofs,
        place: &Placement,
        object: &FreeBody,
        turn: &Matrix3<f64>,
    ) -> Survey {
        let further: ArrayVec<FixedObstacle, FURTHER_OBJECTS_MAX> = self
            .further
            .iter()
            .filter_map(|handle| physics.colliders.get(*handle))
            .map(|collider| FixedObstacle::new(collider, false))
            .collect();
        let balls: [(Vector3<f64>, f64); DOFS_MAX] = core::array::from_fn(|link| {
            (place.frames[link].point(&self.covers[link].centre), self.covers[link].radius)
        });
        let mut robot = FAR_M;
        for fixture in self.fixtures.iter().chain(&further) {
            for (link, (centre, radius)) in balls.iter().enumerate() {
                if self.covers[link].any && fixture.bounds.distance_to_ball(centre, *radius) < robot {
                    robot = robot.min(self.link_to_fixture(place, link, fixture, robot));
                }
            }
        }
        if self.self_contacts {
            robot = robot.min(self.to_itself(place, &balls, robot));
        }
        let [arm, hand, pads] = self.to_object(place, &balls, object, turn, &further);
        let room = |least: f64| (least - RANGE_M).max(0.0);
        let most = room(robot.max(arm).max(hand).max(pads));
        Survey {
            q: *q,
            reach: self.reach(place, &balls, most),
            object_at: object.position.into(),
            in_hand: self.in_hand(place, object, turn),
            robot_m: room(robot),
            arm_object_m: room(arm),
            hand_object_m: room(hand),
            pads_object_m: room(pads),
        }
    }

    /// Distance of the object to the arm before the hand and to further objects, to hand and fingers, and to the
    /// pads, m.
    fn to_object(
        &self,
        place: &Placement,
        balls: &[(Vector3<f64>, f64); DOFS_MAX],
        object: &FreeBody,
        turn: &Matrix3<f64>,
        further: &[FixedObstacle],
    ) -> [f64; 3] {
        let mut least = [FAR_M; 3];
        let Some((shape, half, groups)) = &self.object else { return least };
        let bounds = Bounds::of(turn, object.position, half);
        let pose = to_rapier(&object.pose());
        let radius = half.norm();
        for fixture in self.fixtures.iter().filter(|fixture| fixture.robot).chain(further) {
            least[0] = least[0].min(fixture.bounds.distance_to_ball(&object.position, radius));
        }
        for (link, (centre, around)) in balls.iter().enumerate() {
            if !self.covers[link].any {
                continue;
            }
            if link + 1 < self.joints {
                // The arm before the hand is far: the ball around the object will do, and does not turn.
                let apart = (centre - object.position).norm() - around - radius;
                if apart < least[0] {
                    for part in
                        self.parts.iter().filter(|part| part.link == link && meet(groups, &part.groups))
                    {
                        let at = place.frames[link].then(&part.local);
                        let part = Bounds::of(&at.rotation, at.origin, &part.half);
                        least[0] = least[0].min(part.distance_to_ball(&object.position, radius));
                    }
                }
                continue;
            }
            let coarse = bounds.distance_to_ball(centre, *around);
            if coarse >= least[1].max(least[2]) {
                continue;
            }
            for part in self.parts.iter().filter(|part| part.link == link && meet(groups, &part.groups)) {
                let least = &mut least[if part.pad { 2 } else { 1 }];
                let at = place.frames[link].then(&part.local);
                let coarse = Bounds::of(&at.rotation, at.origin, &part.half).distance(&bounds);
                if coarse < *least {
                    let exact = || distance(&pose_of(&at), &part.shape, &pose, shape);
                    *least = least.min(if coarse < NEAR_M { exact() } else { coarse });
                }
            }
        }
        least
    }

    /// Pose of the object in the frame of the hand.
    fn in_hand(&self, place: &Placement, object: &FreeBody, turn: &Matrix3<f64>) -> [f64; 12] {
        let hand = &place.frames[self.joints.saturating_sub(1)];
        let back = hand.rotation.transpose();
        let (position, rotation) = (back * (object.position - hand.origin), back * turn);
        let mut numbers = [0.0; 12];
        numbers[..3].copy_from_slice(position.as_slice());
        numbers[3..].copy_from_slice(rotation.as_slice());
        numbers
    }

    /// Radius of the ball around the object, m.
    fn object_radius(&self) -> f64 {
        self.object.as_ref().map_or(0.0, |(_, half, _)| half.norm())
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
    fn reach(&self, place: &Placement, balls: &[(Vector3<f64>, f64); DOFS_MAX], slack: f64) -> Dofs {
        let mut reach = [0.0; DOFS_MAX];
        for (joint, most) in reach.iter_mut().enumerate().take(self.joints) {
            let (origin, axis) = (place.frames[joint].origin, place.axes[joint].angular);
            let from_axis = |point: &Vector3<f64>| axis.cross(&(point - origin)).norm();
            let links = balls.iter().enumerate().take(self.joints + 2).skip(joint);
            *most = links.fold(0.0_f64, |most, (_, (centre, radius))| most.max(from_axis(centre) + radius));
            *most += slack;
        }
        // A finger moves itself.
        (reach[self.joints], reach[self.joints + 1]) = (1.0, 1.0);
        reach
    }
}

impl FixedObstacle {
    fn new(collider: &Collider, robot: bool) -> Self {
        let at = from_rapier(collider.position());
        let turn = at.rotation.to_rotation_matrix().into_inner();
        let bounds = Bounds::of(&turn, at.translation.vector, &half_extents(collider.shared_shape()));
        Self {
            robot,
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
