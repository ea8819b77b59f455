//! From URDF to canonical links: fixed joints are merged away, every joint axis becomes z.
//!
//! The XML is parsed by `urdf-rs` (through `rapier3d-urdf`). What this crate cannot simulate (meshes,
//! joints that the TOML does not name, massless moving links) is refused by name, never ignored.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rapier3d_urdf::urdf_rs::{self, Geometry, JointType};

use crate::dynamics::ARM_JOINTS_MAX;
use crate::robot::{FingerSpec, GripperSpec, Inertial, LinkShape, LinkSpec, RobotFile};
use holdpoint_body::JointVec;
use holdpoint_body::Shape;
use holdpoint_body::chain::{Chain, JointSpec, Transform};
use holdpoint_cell::CellError;

// Beyond these limits a file does not describe an arm: they are several times the values of industrial arms.

/// Farthest that a joint turns from its zero, rad: two turns.
const ANGLE_MAX_RAD: f64 = 4.0 * core::f64::consts::PI;
/// Fastest joint, rad/s.
const SPEED_MAX_RAD_S: f64 = 20.0;
/// Strongest joint, N m.
const EFFORT_MAX_N_M: f64 = 10_000.0;
/// Largest part, and largest step from one to the next, m.
const LENGTH_MAX_M: f64 = 5.0;
/// Heaviest part, kg.
const MASS_MAX_KG: f64 = 500.0;
/// A principal moment below this share of the largest is 0 but for rounding.
const LEAST_SHARE: f64 = 1e-9;
/// Largest moment of inertia, kg m².
const INERTIA_MAX_KG_M2: f64 = 1_000.0;
/// Largest stiffness, damping and acceleration, in their SI units.
const GAIN_MAX: f64 = 1.0e6;

/// The robot that the URDF and the TOML describe together.
pub struct UrdfRobot {
    pub name: String,
    pub chain: Chain,
    pub links: Vec<LinkSpec>,
    pub gripper: GripperSpec,
    pub home: JointVec,
}

/// The rigid piece a URDF link belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RigidPiece {
    /// Base (0) or the link moved by arm joint `i - 1`.
    Arm(usize),
    Finger(usize),
}

/// Where a URDF link sits: its piece, and its frame in the piece's canonical frame.
#[derive(Clone, Copy)]
struct LinkPlacement {
    piece: RigidPiece,
    pose: Isometry3<f64>,
}

struct UrdfReader<'a> {
    file: &'a str,
    robot: &'a urdf_rs::Robot,
    config: &'a RobotFile,
}

/// Reads the URDF text under the TOML's naming.
pub fn read(file: &str, text: &str, toml_file: &str, config: &RobotFile) -> Result<UrdfRobot, CellError> {
    check_config(toml_file, config)?;
    let robot = urdf_rs::read_from_string(text)
        .map_err(|error| CellError::file(file, "robot", format!("not a URDF: {error}")))?;
    let reader = UrdfReader { file, robot: &robot, config };
    reader.check_names(toml_file)?;
    let (placements, joints, origins) = reader.place_links()?;
    let last = config.joints.len();
    let mut links = Vec::with_capacity(last + 1);
    for piece in 0..=last {
        links.push(reader.link_spec(RigidPiece::Arm(piece), &placements)?);
    }
    let fingers =
        [reader.finger_spec(0, &placements, &origins)?, reader.finger_spec(1, &placements, &origins)?];
    let tool_placement = placements
        .get(config.tool.link.as_str())
        .filter(|placement| placement.piece == RigidPiece::Arm(last));
    let Some(tool_placement) = tool_placement else {
        let problem = format!("link \"{}\" is not fixed to the last arm joint's link", config.tool.link);
        return Err(CellError::file(toml_file, "tool.link", problem));
    };
    let tool = tool_placement.pose * pose(&config.tool.xyz_m, &config.tool.rpy_rad);
    let chain = Chain { joints, tool_from_last: Transform::new(&tool) };
    for (i, (joint, angle)) in chain.joints.iter().zip(&config.home_rad).enumerate() {
        if !(joint.lower_rad..=joint.upper_rad).contains(angle) {
            let problem = format!(
                "\"{angle}\" is outside the limits {} to {} of joint \"{}\"",
                joint.lower_rad, joint.upper_rad, joint.name
            );
            return Err(CellError::file(toml_file, format!("home_rad[{i}]"), problem));
        }
    }
    let g = &config.gripper;
    let gripper = GripperSpec {
        fingers,
        pad_friction: g.pad_friction,
        stiffness_n_m: g.stiffness_n_m,
        damping_n_s_m: g.damping_n_s_m,
        force_max_n: g.force_max_n,
        speed_max_m_s: g.speed_max_m_s,
        armature_kg: g.armature_kg,
    };
    Ok(UrdfRobot {
        name: robot.name.clone(),
        chain,
        links,
        gripper,
        home: config.home_rad.iter().copied().collect(),
    })
}

fn check_config(file: &str, config: &RobotFile) -> Result<(), CellError> {
    if config.format != 1 {
        return Err(CellError::file(
            file,
            "format",
            format!("\"{}\" is not known; this build reads 1", config.format),
        ));
    }
    let n = config.joints.len();
    if n == 0 || n > ARM_JOINTS_MAX {
        return Err(CellError::file(
            file,
            "joints",
            format!("\"{n}\" joints; 1 to {ARM_JOINTS_MAX} are allowed"),
        ));
    }
    let lists = [
        ("home_rad", &config.home_rad),
        ("acceleration_max_rad_s2", &config.acceleration_max_rad_s2),
        ("motors.stiffness_n_m_rad", &config.motors.stiffness_n_m_rad),
        ("motors.damping_n_m_s_rad", &config.motors.damping_n_m_s_rad),
    ];
    for (key, list) in lists {
        if list.len() != n {
            return Err(CellError::file(file, key, format!("\"{}\" values for {n} joints", list.len())));
        }
        if let Some(value) = list.iter().find(|value| value.abs() > GAIN_MAX) {
            let problem = format!("\"{value}\"; at most {GAIN_MAX} is allowed");
            return Err(CellError::file(file, key, problem));
        }
        if key != "home_rad" && list.iter().any(|v| *v <= 0.0) {
            return Err(CellError::file(file, key, format!("\"{list:?}\": every value must be above 0")));
        }
    }
    let (g, m) = (&config.gripper, &config.motors);
    let single = [
        ("gripper.pad_friction", g.pad_friction, 10.0),
        ("gripper.stiffness_n_m", g.stiffness_n_m, GAIN_MAX),
        ("gripper.damping_n_s_m", g.damping_n_s_m, GAIN_MAX),
        ("gripper.force_max_n", g.force_max_n, 1_000.0),
        ("gripper.speed_max_m_s", g.speed_max_m_s, 2.0),
        ("gripper.armature_kg", g.armature_kg, MASS_MAX_KG),
        ("motors.armature_kg_m2", m.armature_kg_m2, INERTIA_MAX_KG_M2),
        ("motors.joint_damping_n_m_s_rad", m.joint_damping_n_m_s_rad, GAIN_MAX),
    ];
    let offset = config.tool.xyz_m.map(|value| ("tool.xyz_m", value, LENGTH_MAX_M));
    for (key, value, limit) in single.into_iter().chain(offset) {
        if value.abs() > limit {
            return Err(CellError::file(file, key, format!("\"{value}\"; at most {limit} is allowed")));
        }
    }
    Ok(())
}

type LinkPlacements<'a> = BTreeMap<&'a str, LinkPlacement>;
type PlacedTree<'a> = (LinkPlacements<'a>, Vec<JointSpec>, [Option<(Transform, f64)>; 2]);

impl<'a> UrdfReader<'a> {
    fn error(&self, element: String, problem: impl Into<String>) -> CellError {
        CellError::file(self.file, element, problem)
    }

    fn check_names(&self, toml_file: &str) -> Result<(), CellError> {
        let named = self.config.joints.iter().map(|name| ("joints", name));
        let gripping = self.config.gripper.joints.iter().map(|name| ("gripper.joints", name));
        for (key, name) in named.chain(gripping) {
            if !self.robot.joints.iter().any(|joint| joint.name == *name) {
                return Err(CellError::file(
                    toml_file,
                    key,
                    format!("joint \"{name}\" is not in {}", self.file),
                ));
            }
        }
        Ok(())
    }

    /// Visits the tree from its root and places every link.
    fn place_links(&self) -> Result<PlacedTree<'a>, CellError> {
        let mut roots = self
            .robot
            .links
            .iter()
            .filter(|link| !self.robot.joints.iter().any(|joint| joint.child.link == link.name));
        let (Some(root), None) = (roots.next(), roots.next()) else {
            return Err(self.error("robot".into(), "the links do not form one tree with one root"));
        };
        let mut placements = LinkPlacements::new();
        placements
            .insert(&root.name, LinkPlacement { piece: RigidPiece::Arm(0), pose: Isometry3::identity() });
        let mut joints: Vec<Option<JointSpec>> = vec![None; self.config.joints.len()];
        let mut fingers = [None, None];
        let mut open = vec![root.name.as_str()];
        while let Some(parent) = open.pop() {
            let Some(placement) = placements.get(parent).copied() else { continue };
            for joint in self.robot.joints.iter().filter(|joint| joint.parent.link == parent) {
                let element = format!("joint \"{}\"", joint.name);
                let at = placement.pose * self.origin(&element, &joint.origin)?;
                let arm = self.config.joints.iter().position(|name| *name == joint.name);
                let finger = self.config.gripper.joints.iter().position(|name| *name == joint.name);
                let child = match (arm, finger) {
                    (Some(i), _) => {
                        self.check_joint(
                            &element,
                            &placement,
                            RigidPiece::Arm(i),
                            &joint.joint_type,
                            &JointType::Revolute,
                        )?;
                        let rotation = self.axis_rotation(&element, &joint.axis)?;
                        joints[i] = Some(self.arm_joint(&element, i, joint, &(at * rotation))?);
                        LinkPlacement { piece: RigidPiece::Arm(i + 1), pose: rotation.inverse() }
                    }
                    (None, Some(i)) => {
                        let hand = RigidPiece::Arm(self.config.joints.len());
                        self.check_joint(
                            &element,
                            &placement,
                            hand,
                            &joint.joint_type,
                            &JointType::Prismatic,
                        )?;
                        let rotation = self.axis_rotation(&element, &joint.axis)?;
                        let (lower, upper) = (joint.limit.lower, joint.limit.upper);
                        if !(lower == 0.0 && upper > 0.0 && upper < 0.5) {
                            let problem = format!(
                                "limits \"{lower}\" to \"{upper}\"; a finger closes at 0 and opens by at most 0.5 m"
                            );
                            return Err(self.error(element, problem));
                        }
                        fingers[i] = Some((Transform::new(&(at * rotation)), upper));
                        LinkPlacement { piece: RigidPiece::Finger(i), pose: rotation.inverse() }
                    }
                    (None, None) if joint.joint_type == JointType::Fixed => {
                        LinkPlacement { piece: placement.piece, pose: at }
                    }
                    (None, None) => {
                        let problem = format!(
                            "of type \"{:?}\" is in neither \"joints\" nor \"gripper.joints\"",
                            joint.joint_type
                        );
                        return Err(self.error(element, problem));
                    }
                };
                if placements.insert(&joint.child.link, child).is_some() {
                    return Err(self.error(element, format!("link \"{}\" has two parents", joint.child.link)));
                }
                open.push(&joint.child.link);
            }
        }
        let joints: Option<Vec<JointSpec>> = joints.into_iter().collect();
        let joints =
            joints.ok_or_else(|| self.error("robot".into(), "an arm joint hangs on no link of the tree"))?;
        Ok((placements, joints, fingers))
    }

    /// Refuses a joint of another type, or one that does not hang on the piece before it.
    fn check_joint(
        &self,
        element: &str,
        placement: &LinkPlacement,
        piece: RigidPiece,
        joint_type: &JointType,
        required_type: &JointType,
    ) -> Result<(), CellError> {
        if joint_type != required_type {
            return Err(self.error(
                element.into(),
                format!("is of type \"{joint_type:?}\"; {required_type:?} is needed here"),
            ));
        }
        if placement.piece != piece {
            return Err(
                self.error(element.into(), "does not hang on the joint before it in the TOML's order")
            );
        }
        Ok(())
    }

    fn arm_joint(
        &self,
        element: &str,
        i: usize,
        joint: &urdf_rs::Joint,
        origin: &Isometry3<f64>,
    ) -> Result<JointSpec, CellError> {
        let limit = &joint.limit;
        let numbers = [limit.lower, limit.upper, limit.effort, limit.velocity];
        if numbers.iter().any(|v| !v.is_finite())
            || limit.lower >= limit.upper
            || limit.effort <= 0.0
            || limit.velocity <= 0.0
        {
            let problem = format!(
                "limit \"{numbers:?}\" (lower, upper, effort, velocity): lower < upper and the others above 0 are needed"
            );
            return Err(self.error(element.into(), problem));
        }
        self.check_range(element, "limit's lower end, rad", limit.lower, ANGLE_MAX_RAD)?;
        self.check_range(element, "limit's upper end, rad", limit.upper, ANGLE_MAX_RAD)?;
        self.check_range(element, "limit's velocity, rad/s", limit.velocity, SPEED_MAX_RAD_S)?;
        self.check_range(element, "limit's effort, N m", limit.effort, EFFORT_MAX_N_M)?;
        Ok(JointSpec {
            name: joint.name.clone(),
            origin: Transform::new(origin),
            lower_rad: limit.lower,
            upper_rad: limit.upper,
            speed_max_rad_s: limit.velocity,
            acceleration_max_rad_s2: self.config.acceleration_max_rad_s2.get(i).copied().unwrap_or(1.0),
            effort_max_n_m: limit.effort,
        })
    }

    /// Refuses a value that no arm has: a huge finite number would overflow in the physics.
    fn check_range(&self, element: &str, quantity: &str, value: f64, limit: f64) -> Result<(), CellError> {
        if value.abs() <= limit {
            return Ok(());
        }
        Err(self.error(
            element.into(),
            format!("{quantity}, is \"{value}\"; at most {limit} either way is allowed"),
        ))
    }

    fn origin(&self, element: &str, origin: &urdf_rs::Pose) -> Result<Isometry3<f64>, CellError> {
        if origin.xyz.iter().chain(origin.rpy.iter()).any(|v| !v.is_finite()) {
            return Err(self.error(
                element.into(),
                format!("origin \"{:?} {:?}\" is not finite", origin.xyz.0, origin.rpy.0),
            ));
        }
        for value in origin.xyz.iter() {
            self.check_range(element, "the origin, m", *value, LENGTH_MAX_M)?;
        }
        Ok(pose(&origin.xyz, &origin.rpy))
    }

    /// The rotation that takes z onto the joint's axis.
    fn axis_rotation(&self, element: &str, axis: &urdf_rs::Axis) -> Result<Isometry3<f64>, CellError> {
        let axis = Vector3::from(*axis.xyz);
        if !axis.iter().all(|v| v.is_finite()) || axis.norm() < 1e-6 {
            return Err(
                self.error(element.into(), format!("axis \"{:?}\" has no direction", axis.as_slice()))
            );
        }
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &axis)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI));
        Ok(Isometry3::from_parts(Translation3::identity(), rotation))
    }

    /// The links that belong to one rigid piece, as one.
    fn link_spec(&self, piece: RigidPiece, placements: &LinkPlacements<'_>) -> Result<LinkSpec, CellError> {
        let mut spec = LinkSpec { name: String::new(), inertial: None, shapes: Vec::new() };
        for link in &self.robot.links {
            let Some(placement) =
                placements.get(link.name.as_str()).filter(|placement| placement.piece == piece)
            else {
                continue;
            };
            let element = format!("link \"{}\"", link.name);
            if spec.name.is_empty() {
                spec.name.clone_from(&link.name);
            }
            if let Some(next) = self.inertial(&element, &link.inertial, &placement.pose)? {
                spec.inertial = Some(spec.inertial.map_or(next, |sum| combine(&sum, &next)));
            }
            let pad_name = &self.config.gripper.pad;
            for collision in &link.collision {
                let is_finger = matches!(piece, RigidPiece::Finger(_));
                let named = pad_name.is_none() || (collision.name.is_some() && collision.name == *pad_name);
                spec.shapes.push(LinkShape {
                    pose: placement.pose * self.origin(&element, &collision.origin)?,
                    shape: self.shape(&element, &collision.geometry)?,
                    pad: is_finger && named,
                });
            }
        }
        if spec.inertial.is_none() && piece != RigidPiece::Arm(0) {
            return Err(self.error(format!("link \"{}\"", spec.name), "moves but has no mass"));
        }
        Ok(spec)
    }

    fn finger_spec(
        &self,
        i: usize,
        placements: &LinkPlacements<'_>,
        origins: &[Option<(Transform, f64)>; 2],
    ) -> Result<FingerSpec, CellError> {
        let joint = &self.config.gripper.joints[i];
        let Some((origin, stroke_m)) = origins[i] else {
            return Err(self.error(format!("joint \"{joint}\""), "hangs on no link of the tree"));
        };
        let link = self.link_spec(RigidPiece::Finger(i), placements)?;
        if !link.shapes.iter().any(|shape| shape.pad) {
            let wanted = self.config.gripper.pad.as_deref().unwrap_or("");
            return Err(self.error(
                format!("link \"{}\"", link.name),
                format!("has no collision shape named \"{wanted}\" to grip with"),
            ));
        }
        Ok(FingerSpec { joint: joint.clone(), origin, stroke_m, link })
    }

    fn inertial(
        &self,
        element: &str,
        inertial: &urdf_rs::Inertial,
        link_pose: &Isometry3<f64>,
    ) -> Result<Option<Inertial>, CellError> {
        let i = &inertial.inertia;
        let numbers = [inertial.mass.value, i.ixx, i.iyy, i.izz, i.ixy, i.ixz, i.iyz];
        if numbers.iter().any(|v| !v.is_finite()) || inertial.mass.value < 0.0 {
            return Err(self.error(
                element.into(),
                format!("mass and inertia \"{numbers:?}\" must be finite, the mass not below 0"),
            ));
        }
        if inertial.mass.value == 0.0 {
            return Ok(None);
        }
        if i.ixx <= 0.0 || i.iyy <= 0.0 || i.izz <= 0.0 {
            return Err(self.error(
                element.into(),
                format!("inertia \"{} {} {}\" must be above 0", i.ixx, i.iyy, i.izz),
            ));
        }
        self.check_range(element, "the mass, kg", inertial.mass.value, MASS_MAX_KG)?;
        for value in [i.ixx, i.iyy, i.izz, i.ixy, i.ixz, i.iyz] {
            self.check_range(element, "the inertia, kg m²", value, INERTIA_MAX_KG_M2)?;
        }
        let at = link_pose * self.origin(element, &inertial.origin)?;
        let local = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
        // Real arms break the rule that no moment exceeds the sum of the others, and can still be simulated.
        let [least, middle, most] = principal_moments(&local);
        if !(least > LEAST_SHARE * most) {
            return Err(self.error(
                element.into(),
                format!(
                    "the principal moments of the inertia are {least:.3e}, {middle:.3e} and {most:.3e} kg m²; each must be \
                     above 0"
                ),
            ));
        }
        let turn = at.rotation.to_rotation_matrix().into_inner();
        Ok(Some(Inertial {
            mass_kg: inertial.mass.value,
            centre_m: at.translation.vector,
            inertia_kg_m2: turn * local * turn.transpose(),
        }))
    }

    fn shape(&self, element: &str, geometry: &Geometry) -> Result<Shape, CellError> {
        let (shape, sizes) = match geometry {
            Geometry::Box { size } => (Shape::Cuboid { half_m: size.map(|v| 0.5 * v) }, size.to_vec()),
            Geometry::Cylinder { radius, length } => {
                (Shape::Cylinder { half_length_m: 0.5 * length, radius_m: *radius }, vec![*radius, *length])
            }
            Geometry::Capsule { radius, length } => {
                (Shape::Capsule { half_length_m: 0.5 * length, radius_m: *radius }, vec![*radius, *length])
            }
            Geometry::Sphere { radius } => (Shape::Ball { radius_m: *radius }, vec![*radius]),
            Geometry::Mesh { filename, .. } => {
                return Err(self.error(
                    element.into(),
                    format!("mesh \"{filename}\" is not supported; use box, capsule, cylinder or sphere"),
                ));
            }
        };
        if sizes.iter().any(|v| !v.is_finite() || *v <= 0.0) {
            return Err(
                self.error(element.into(), format!("shape size \"{sizes:?}\" must be finite and above 0"))
            );
        }
        for size in sizes {
            self.check_range(element, "the shape's size, m", size, LENGTH_MAX_M)?;
        }
        Ok(shape)
    }
}

fn pose(xyz: &[f64; 3], rpy: &[f64; 3]) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(xyz[0], xyz[1], xyz[2]),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// Two bodies as one (parallel axis theorem).
fn combine(a: &Inertial, b: &Inertial) -> Inertial {
    let mass_kg = a.mass_kg + b.mass_kg;
    let centre_m = (a.centre_m * a.mass_kg + b.centre_m * b.mass_kg) / mass_kg;
    let about = |part: &Inertial| {
        let d = Point3::from(part.centre_m) - Point3::from(centre_m);
        part.inertia_kg_m2 + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * part.mass_kg
    };
    Inertial { mass_kg, centre_m, inertia_kg_m2: about(a) + about(b) }
}

/// Principal moments of an inertia, in ascending order.
fn principal_moments(inertia: &Matrix3<f64>) -> [f64; 3] {
    let mut moments: [f64; 3] = inertia.symmetric_eigenvalues().into();
    moments.sort_by(f64::total_cmp);
    moments
}
