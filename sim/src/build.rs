//! From descriptions to a rapier world: bodies, joints, motors, materials, collision groups.
//!
//! This file, `readout.rs` and `world.rs` are the only ones that name rapier types; everything else
//! is f64 and nalgebra. The settings below were found by experiment (240 Hz, a gripped cube must
//! neither slip nor creep): change one and run the outcome tests.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use nalgebra::Isometry3;
use rapier3d::dynamics::{
    CoefficientCombineRule, GenericJoint, GenericJointBuilder, JointAxesMask, JointAxis, MassProperties,
    MotorModel, MultibodyDofCoupling, MultibodyJointHandle, RigidBodyBuilder, RigidBodyHandle,
    SpringCoefficients,
};
use rapier3d::geometry::{ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode};
use rapier3d::math::{Matrix, Pose as RapierPose, Rotation, Vector};
use rapier3d::pipeline::PhysicsWorld;

use crate::effort::SolverEffort;
use crate::handles::{ColliderKind, Handles, to_rapier, to_vector};
use crate::motors;
use crate::robot::{Inertial, LinkShape, LinkSpec, RobotModel};
use holdpoint_body::{FurtherObject, Shape, TICK_SECS};
use holdpoint_cell::CellError;
use holdpoint_cell::episode::{EpisodeSetup, ObjectSetup};
use holdpoint_cell::scene::{Clutter, Scene, Table, Tray};

const PROXIMAL: Group = Group::GROUP_1;
const MIDDLE: Group = Group::GROUP_2;
const DISTAL: Group = Group::GROUP_3;
const OBJECT: Group = Group::GROUP_4;
const FIXTURE: Group = Group::GROUP_5;
const CLUTTER: Group = Group::GROUP_6;

/// An empty world with the settings that hold a gripped cube.
pub fn empty_world() -> PhysicsWorld {
    let mut world = PhysicsWorld { gravity: Vector::new(0.0, 0.0, -9.81), ..PhysicsWorld::default() };
    let p = &mut world.integration_parameters;
    p.dt = TICK_SECS as f32;
    p.contact_softness = SpringCoefficients::new(120.0, 5.0);
    p.static_contact_softness = SpringCoefficients::new(240.0, 5.0);
    // With recycled contacts a gripped cube walks out of the hand (12 of 20 placed, against 20).
    p.contact_recycling = false;
    p.normalized_allowed_linear_error = 0.0005;
    p.normalized_prediction_distance = 0.004;
    p.max_ccd_substeps = 0;
    SolverEffort::FULL.apply(&mut world);
    world
}

/// What stands in the cell beside the robot.
pub struct CellFixtures<'a> {
    pub table: &'a Table,
    /// The tray, its pose, and half the edge of the object it is for.
    pub tray: Option<(&'a Tray, Isometry3<f64>, f64)>,
    /// Clutter with its index in the scene.
    pub clutter: Vec<(u8, &'a Clutter)>,
    pub object_half_m: f64,
    pub object: &'a ObjectSetup,
    /// The further objects, and where they start.
    pub further: Vec<(FurtherObject, Isometry3<f64>)>,
    /// Whether the arm's far end meets its near end.
    pub self_contacts: bool,
}

impl<'a> CellFixtures<'a> {
    /// The cell of an episode.
    pub fn new(
        scene: &'a Scene,
        setup: &'a EpisodeSetup,
        further: Vec<(FurtherObject, Isometry3<f64>)>,
    ) -> Self {
        let present = |index: &u8| scene.clutter.get(usize::from(*index)).map(|piece| (*index, piece));
        Self {
            table: &scene.table,
            tray: Some((&scene.tray, setup.target.isometry(), scene.object.half_m)),
            clutter: setup.clutter.iter().filter_map(present).collect(),
            object_half_m: scene.object.half_m,
            object: &setup.object,
            further,
            self_contacts: true,
        }
    }
}

struct Builder<'a> {
    world: PhysicsWorld,
    kinds: Vec<ColliderKind>,
    robot: &'a RobotModel,
    cell: &'a CellFixtures<'a>,
}

/// Builds a whole cell: the arm at `q`, the fingers `width_m` apart.
///
/// # Errors
/// [`CellError::File`] when rapier refuses a joint of the robot.
pub fn assemble(
    robot: &RobotModel,
    cell: &CellFixtures<'_>,
    q: &[f64],
    width_m: f64,
) -> Result<(PhysicsWorld, Handles), CellError> {
    let mut builder = Builder { world: empty_world(), kinds: Vec::with_capacity(48), robot, cell };
    builder.fixtures();
    let object = builder.object();
    let (links, fingers, joints) = builder.arm()?;
    // Last, so that everything else is numbered as without them.
    let further = builder.further();
    let Builder { mut world, kinds, .. } = builder;
    let first_joint = joints[0];
    let link_ids =
        joints.iter().map(|handle| world.multibody_joints.get(*handle).map_or(0, |(_, id)| id)).collect();
    let handles = Handles { links, fingers, first_joint, link_ids, object, further, kinds };
    set_configuration(&mut world, &handles, robot, q, width_m);
    Ok((world, handles))
}

impl Builder<'_> {
    fn add(
        &mut self,
        kind: ColliderKind,
        groups: (Group, Group),
        collider: ColliderBuilder,
        body: Option<RigidBodyHandle>,
    ) -> ColliderHandle {
        let groups = InteractionGroups::new(groups.0, groups.1, InteractionTestMode::And);
        let handle = self.world.insert_collider(collider.collision_groups(groups), body);
        let index = handle.into_raw_parts().0 as usize;
        if self.kinds.len() <= index {
            self.kinds.resize(index + 1, kind);
        }
        self.kinds[index] = kind;
        handle
    }

    fn fixtures(&mut self) {
        let cell = self.cell;
        let all = (FIXTURE, MIDDLE | DISTAL | OBJECT);
        let table = cell.table;
        let slab =
            cuboid(&table.half_m).translation(to_vector(&table.centre_m)).friction(table.friction as f32);
        self.add(ColliderKind::Table, all, slab, None);
        if let Some((tray, pose, object_half_m)) = &cell.tray {
            for (half, centre) in tray_parts(tray, *object_half_m) {
                let at = pose * Isometry3::translation(centre[0], centre[1], centre[2]);
                let part = cuboid(&half).position(to_rapier(&at)).friction(tray.friction as f32);
                self.add(ColliderKind::Tray, all, part, None);
            }
        }
        for (index, piece) in &cell.clutter {
            let [x, y] = piece.centre_xy_m;
            let piece = cuboid(&piece.half_m).translation(to_vector(&[x, y, piece.half_m[2]])).friction(0.5);
            self.add(ColliderKind::Clutter(*index), (CLUTTER, MIDDLE | DISTAL | OBJECT), piece, None);
        }
    }

    fn object(&mut self) -> RigidBodyHandle {
        let object = self.cell.object;
        let body = RigidBodyBuilder::dynamic().pose(to_rapier(&object.pose.isometry())).can_sleep(false);
        let body = self.world.insert_body(body);
        let cube = cuboid(&[self.cell.object_half_m; 3])
            .mass(object.mass_kg as f32)
            .friction(object.friction as f32)
            .friction_combine_rule(CoefficientCombineRule::Min);
        self.add(ColliderKind::Object, (OBJECT, Group::ALL), cube, Some(body));
        body
    }

    fn further(&mut self) -> Vec<RigidBodyHandle> {
        let (cell, edge) = (self.cell, self.cell.object_half_m as f32);
        let place = |(object, pose): &(FurtherObject, Isometry3<f64>)| {
            let body = RigidBodyBuilder::dynamic().pose(to_rapier(pose)).can_sleep(false);
            let body = self.world.insert_body(body);
            let shape = match object.shape.primitive() {
                // `warm_start.rs` knows the object by its size.
                Shape::Cuboid { half_m: [x, y, z] } if [x, y, z].map(|half| half as f32) == [edge; 3] => {
                    Shape::Cuboid { half_m: [f64::from((x as f32).next_up()), y, z] }
                }
                shape => shape,
            };
            let shape = LinkShape { pose: Isometry3::identity(), shape, pad: false };
            let solid = collider(&shape)
                .mass(object.mass_kg as f32)
                .friction(object.friction as f32)
                .friction_combine_rule(CoefficientCombineRule::Min);
            self.add(ColliderKind::Further, (OBJECT, Group::ALL), solid, Some(body));
            body
        };
        cell.further.iter().map(place).collect()
    }

    #[expect(clippy::type_complexity, reason = "read once, right above")]
    fn arm(
        &mut self,
    ) -> Result<(Vec<RigidBodyHandle>, [RigidBodyHandle; 2], Vec<MultibodyJointHandle>), CellError> {
        let robot = self.robot;
        let base = self.world.insert_body(RigidBodyBuilder::fixed());
        self.shapes(base, &robot.links[0], 0);
        let mut joints = Vec::new();
        let mut links = Vec::new();
        let mut parent = base;
        for (i, (joint, link)) in
            robot.geometry.chain.joints.iter().zip(robot.links.iter().skip(1)).enumerate()
        {
            let body = self.link_body(link);
            self.shapes(body, link, i + 1);
            let data = revolute(&joint.origin.isometry(), joint.lower_rad, joint.upper_rad);
            joints.push(self.join(parent, body, data, &joint.name)?);
            links.push(body);
            parent = body;
        }
        let mut fingers = [parent; 2];
        for (side, finger) in robot.gripper.fingers.iter().enumerate() {
            let body = self.link_body(&finger.link);
            for shape in &finger.link.shapes {
                let kind =
                    if shape.pad { ColliderKind::Pad(side as u8) } else { ColliderKind::Finger(side as u8) };
                let mut collider = collider(shape);
                if shape.pad {
                    collider = collider
                        .friction(robot.gripper.pad_friction as f32)
                        .friction_combine_rule(CoefficientCombineRule::Min);
                }
                let groups = link_groups(usize::MAX, 0, self.cell.self_contacts);
                self.add(kind, groups, collider, Some(body));
            }
            let data = prismatic(&finger.origin.isometry(), finger.stroke_m);
            joints.push(self.join(parent, body, data, &finger.joint)?);
            fingers[side] = body;
        }
        Ok((links, fingers, joints))
    }

    fn link_body(&mut self, link: &LinkSpec) -> RigidBodyHandle {
        let scale = if self.robot.motors.gravity_compensation { 0.0 } else { 1.0 };
        let mut body = RigidBodyBuilder::dynamic().can_sleep(false).gravity_scale(scale);
        if let Some(inertial) = &link.inertial {
            body = body.additional_mass_properties(mass_properties(inertial));
        }
        self.world.insert_body(body)
    }

    fn shapes(&mut self, body: RigidBodyHandle, link: &LinkSpec, index: usize) {
        let groups = link_groups(index, self.robot.geometry.joint_count(), self.cell.self_contacts);
        for shape in &link.shapes {
            self.add(ColliderKind::Link(index as u8), groups, collider(shape), Some(body));
        }
    }

    #[allow(clippy::large_types_passed_by_value, reason = "the engine takes it by value")]
    fn join(
        &mut self,
        parent: RigidBodyHandle,
        child: RigidBodyHandle,
        data: GenericJoint,
        name: &str,
    ) -> Result<MultibodyJointHandle, CellError> {
        self.world.multibody_joints.insert(parent, child, data, true).ok_or_else(|| {
            CellError::file(
                &self.robot.name,
                format!("joint \"{name}\""),
                "the physics engine refuses it (a loop?)",
            )
        })
    }
}

/// What a link may touch. Of the robot itself only the far end against the near end is resolved by
/// physics (the pairs between are caught by geometry, see [`holdpoint_body::clearance`]).
fn link_groups(index: usize, joints: usize, self_contacts: bool) -> (Group, Group) {
    let (near, far) = if self_contacts { (PROXIMAL, DISTAL) } else { (Group::NONE, Group::NONE) };
    if index <= 2 {
        (PROXIMAL, far | OBJECT)
    } else if index >= 4 && index >= joints.saturating_sub(2) {
        (DISTAL, near | OBJECT | FIXTURE | CLUTTER)
    } else {
        (MIDDLE, OBJECT | FIXTURE | CLUTTER)
    }
}

/// Floor and walls of the tray in the frame of the floor's upper face: half extents, center.
pub(crate) fn tray_parts(tray: &Tray, object_half_m: f64) -> [([f64; 3], [f64; 3]); 5] {
    let inner = object_half_m + tray.clearance_m;
    let (outer, wall) = (inner + tray.wall_m, 0.5 * tray.wall_m);
    let rise = 0.5 * (tray.wall_top_m - tray.floor_m);
    let at = inner + wall;
    [
        ([outer, outer, 0.5 * tray.floor_m], [0.0, 0.0, -0.5 * tray.floor_m]),
        ([wall, outer, rise], [-at, 0.0, rise]),
        ([wall, outer, rise], [at, 0.0, rise]),
        ([inner, wall, rise], [0.0, -at, rise]),
        ([inner, wall, rise], [0.0, at, rise]),
    ]
}

fn cuboid(half: &[f64; 3]) -> ColliderBuilder {
    ColliderBuilder::cuboid(half[0] as f32, half[1] as f32, half[2] as f32)
}

fn collider(shape: &LinkShape) -> ColliderBuilder {
    let quarter = Rotation::from_rotation_x(core::f32::consts::FRAC_PI_2);
    let pose = to_rapier(&shape.pose);
    let builder = match shape.shape {
        Shape::Capsule { half_length_m, radius_m } => {
            ColliderBuilder::capsule_z(half_length_m as f32, radius_m as f32).position(pose)
        }
        // rapier's cylinder stands along y.
        Shape::Cylinder { half_length_m, radius_m } => {
            ColliderBuilder::cylinder(half_length_m as f32, radius_m as f32)
                .position(pose * RapierPose::from_rotation(quarter))
        }
        Shape::Cuboid { half_m } => cuboid(&half_m).position(pose),
        Shape::Ball { radius_m } => ColliderBuilder::ball(radius_m as f32).position(pose),
    };
    builder.density(0.0).friction(0.5)
}

fn mass_properties(i: &Inertial) -> MassProperties {
    let inertia: Matrix = i.inertia_kg_m2.cast::<f32>().into();
    MassProperties::with_inertia_matrix(to_vector(&i.centre_m.into()), i.mass_kg as f32, inertia)
}

/// rapier's free axis is the joint frame's x; ours is z.
fn x_to_z() -> RapierPose {
    RapierPose::from_rotation(Rotation::from_rotation_y(-core::f32::consts::FRAC_PI_2))
}

fn revolute(origin: &Isometry3<f64>, lower: f64, upper: f64) -> GenericJoint {
    GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
        .local_frame1(to_rapier(origin) * x_to_z())
        .local_frame2(x_to_z())
        .limits(JointAxis::AngX, [lower as f32, upper as f32])
        .contacts_enabled(false)
        .build()
}

fn prismatic(origin: &Isometry3<f64>, stroke: f64) -> GenericJoint {
    GenericJointBuilder::new(JointAxesMask::LOCKED_PRISMATIC_AXES)
        .local_frame1(to_rapier(origin) * x_to_z())
        .local_frame2(x_to_z())
        .limits(JointAxis::LinX, [0.0, stroke as f32])
        .contacts_enabled(false)
        .build()
}

/// Puts the arm at `q` at rest, and sets motors, armature, damping and the coupling of the fingers.
fn set_configuration(
    world: &mut PhysicsWorld,
    handles: &Handles,
    robot: &RobotModel,
    q: &[f64],
    width_m: f64,
) {
    let n = robot.geometry.joint_count();
    let Some((multibody, _)) = world.multibody_joints.get_mut(handles.first_joint) else { return };
    // The root's type (fixed) decides the number of degrees of freedom: resolve it first.
    multibody.forward_kinematics(&world.bodies, true);
    let mut displacement = vec![0.0_f32; multibody.ndofs()];
    for (i, id) in handles.link_ids.iter().enumerate() {
        let Some(at) = multibody.link(*id).map(rapier3d::dynamics::MultibodyLink::assembly_id) else {
            continue;
        };
        displacement[at] = q.get(i).map_or(0.5 * width_m, |angle| *angle) as f32;
        multibody.damping_mut()[at] = robot.motors.joint_damping_n_m_s_rad as f32;
        let armature = if i < n { robot.motors.armature_kg_m2 } else { robot.gripper.armature_kg };
        multibody.armature_mut()[at] = armature as f32;
    }
    multibody.apply_displacements(&displacement);
    multibody.forward_kinematics(&world.bodies, true);
    multibody.update_rigid_bodies(&mut world.bodies, true);
    // Without the coupling the fingers drift together under the object's weight.
    multibody.add_dof_coupling(MultibodyDofCoupling {
        link1: handles.link_ids[n],
        dof1: 0,
        axis1: 0,
        link2: handles.link_ids[n + 1],
        dof2: 0,
        axis2: 0,
        coeff: 1.0,
        offset: 0.0,
    });
    for (i, id) in handles.link_ids.iter().enumerate() {
        let Some(link) = multibody.link_mut(*id) else { continue };
        let data = &mut link.joint.data;
        if let Some(joint) = robot.geometry.chain.joints.get(i) {
            let (kp, kd) = (robot.motors.stiffness_n_m_rad[i], robot.motors.damping_n_m_s_rad[i]);
            data.set_motor_model(JointAxis::AngX, MotorModel::ForceBased);
            data.set_motor(JointAxis::AngX, q[i] as f32, 0.0, kp as f32, kd as f32);
            data.set_motor_max_force(JointAxis::AngX, joint.effort_max_n_m as f32);
            motors::make_spring(multibody, *id, robot.motors.joint_damping_n_m_s_rad as f32);
        } else {
            let g = &robot.gripper;
            data.set_motor_model(JointAxis::LinX, MotorModel::ForceBased);
            let target = 0.5 * width_m;
            data.set_motor(
                JointAxis::LinX,
                target as f32,
                0.0,
                g.stiffness_n_m as f32,
                g.damping_n_s_m as f32,
            );
            data.set_motor_max_force(JointAxis::LinX, g.force_max_n as f32);
        }
    }
}
