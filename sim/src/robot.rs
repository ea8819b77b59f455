//! The robot's description: kinematics, masses, shapes, gripper, motors. Plain data, f64.
//!
//! Read from a URDF plus a TOML file of the same stem beside it, which says what the URDF does not:
//! which joints form the arm, the tool frame, the home pose, motor gains, gripper. Frames are
//! canonical: every joint turns about (or, for a finger, slides along) its own z axis.

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Vector3};
use serde::Deserialize;

use holdpoint_body::chain::Transform;
use holdpoint_body::clearance::ClearanceModel;
use holdpoint_body::ik::{IkOptions, IkOutcome};
use holdpoint_body::number::{finite_list, finite3, positive};
use holdpoint_body::{Geometry, JointVec, Shape};

use crate::urdf;
use holdpoint_cell::CellError;
use holdpoint_cell::number::{parse_toml, read_text};

/// A shape on a link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkShape {
    /// Pose in the canonical link frame.
    pub pose: Isometry3<f64>,
    /// The primitive.
    pub shape: Shape,
    /// Whether this is a finger's gripping surface.
    pub pad: bool,
}

/// Mass, center of mass and inertia about it, in the canonical link frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Center of mass, m.
    pub centre_m: Vector3<f64>,
    /// Inertia about the center of mass, kg m^2.
    pub inertia_kg_m2: Matrix3<f64>,
}

/// One rigid piece of the robot: everything that fixed joints hold together.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkSpec {
    /// Name of the first URDF link in it.
    pub name: String,
    /// Mass properties; the base may have none.
    pub inertial: Option<Inertial>,
    /// Collision shapes.
    pub shapes: Vec<LinkShape>,
}

/// One finger: a link that slides along its own z axis on the last arm link.
#[derive(Clone, Debug, PartialEq)]
pub struct FingerSpec {
    /// Joint name in the URDF.
    pub joint: String,
    /// Last link frame to finger frame when closed.
    pub origin: Transform,
    /// Travel, m, from closed (0).
    pub stroke_m: f64,
    /// The link itself.
    pub link: LinkSpec,
}

/// A parallel gripper of two mirrored fingers.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperSpec {
    /// The fingers.
    pub fingers: [FingerSpec; 2],
    /// Friction coefficient of the pads.
    pub pad_friction: f64,
    /// Position gain per finger, N/m.
    pub stiffness_n_m: f64,
    /// Damping per finger, N s/m.
    pub damping_n_s_m: f64,
    /// Largest force per finger, N.
    pub force_max_n: f64,
    /// Largest speed of the width, m/s.
    pub speed_max_m_s: f64,
    /// Reflected rotor inertia per finger, kg.
    pub armature_kg: f64,
}

impl GripperSpec {
    /// Largest distance between the pads, m.
    #[must_use]
    pub fn width_max_m(&self) -> f64 {
        self.fingers[0].stroke_m + self.fingers[1].stroke_m
    }
}

/// Motor parameters of the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorSpec {
    /// Position gain per joint, N m/rad.
    pub stiffness_n_m_rad: Vec<f64>,
    /// Damping per joint, N m s/rad.
    pub damping_n_m_s_rad: Vec<f64>,
    /// Reflected rotor inertia, kg m^2.
    pub armature_kg_m2: f64,
    /// Viscous joint damping, N m s/rad.
    pub joint_damping_n_m_s_rad: f64,
    /// Whether the drive carries the arm's own weight.
    pub gravity_compensation: bool,
}

/// A robot ready to be built into a world.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotModel {
    /// Name in the URDF.
    pub name: String,
    /// Kinematics and covers of the arm.
    pub geometry: Geometry,
    /// Base, then one link per joint.
    pub links: Vec<LinkSpec>,
    /// The gripper.
    pub gripper: GripperSpec,
    /// Motor parameters.
    pub motors: MotorSpec,
    /// Home configuration, rad.
    pub home: JointVec,
    /// FNV-1a of the two source texts: a snapshot only fits the robot it was made with.
    pub digest: u64,
}

/// The TOML beside the URDF.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RobotFile {
    pub format: u32,
    pub joints: Vec<String>,
    #[serde(deserialize_with = "finite_list")]
    pub home_rad: Vec<f64>,
    #[serde(deserialize_with = "finite_list")]
    pub acceleration_max_rad_s2: Vec<f64>,
    pub tool: ToolFile,
    pub gripper: GripperFile,
    pub motors: MotorFile,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ToolFile {
    pub link: String,
    #[serde(deserialize_with = "finite3")]
    pub xyz_m: [f64; 3],
    #[serde(deserialize_with = "finite3")]
    pub rpy_rad: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct GripperFile {
    pub joints: [String; 2],
    /// Name of the collision shape that grips; all shapes of the finger when absent.
    pub pad: Option<String>,
    #[serde(deserialize_with = "positive")]
    pub pad_friction: f64,
    #[serde(deserialize_with = "positive")]
    pub stiffness_n_m: f64,
    #[serde(deserialize_with = "positive")]
    pub damping_n_s_m: f64,
    #[serde(deserialize_with = "positive")]
    pub force_max_n: f64,
    #[serde(deserialize_with = "positive")]
    pub speed_max_m_s: f64,
    #[serde(deserialize_with = "positive")]
    pub armature_kg: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MotorFile {
    #[serde(deserialize_with = "finite_list")]
    pub stiffness_n_m_rad: Vec<f64>,
    #[serde(deserialize_with = "finite_list")]
    pub damping_n_m_s_rad: Vec<f64>,
    #[serde(deserialize_with = "positive")]
    pub armature_kg_m2: f64,
    #[serde(deserialize_with = "positive")]
    pub joint_damping_n_m_s_rad: f64,
    pub gravity_compensation: bool,
}

/// Robots that come with the crate: name, URDF, TOML.
const BUILTIN: [(&str, &str, &str); 2] = [
    ("arm7", include_str!("../assets/arm7.urdf"), include_str!("../assets/arm7.toml")),
    ("arm6", include_str!("../assets/arm6.urdf"), include_str!("../assets/arm6.toml")),
];

impl RobotModel {
    /// A robot that comes with the crate: `arm7` (seven axes) or `arm6` (six).
    ///
    /// # Errors
    /// [`CellError::File`] for another name.
    pub fn builtin(name: &str) -> Result<Self, CellError> {
        let found = BUILTIN.iter().find(|(known, _, _)| *known == name);
        let Some((known, urdf, toml)) = found else {
            let allowed: Vec<_> = BUILTIN.iter().map(|(known, _, _)| *known).collect();
            let problem = format!("no built-in robot \"{name}\"; there are: {}", allowed.join(", "));
            return Err(CellError::file("builtin", "robot", problem));
        };
        Self::from_texts(&format!("builtin:{known}.urdf"), urdf, &format!("builtin:{known}.toml"), toml)
    }

    /// A robot from a `.urdf` file and the `.toml` of the same stem beside it (either may be named).
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the element.
    pub fn load(path: &Path) -> Result<Self, CellError> {
        let (urdf_path, toml_path) = (path.with_extension("urdf"), path.with_extension("toml"));
        let (urdf_name, toml_name) = (urdf_path.display().to_string(), toml_path.display().to_string());
        let (urdf, toml) = (read_text(&urdf_path)?, read_text(&toml_path)?);
        Self::from_texts(&urdf_name, &urdf, &toml_name, &toml)
    }

    /// A robot from the two texts; the names are used in errors.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the element.
    pub fn from_texts(urdf_name: &str, urdf: &str, toml_name: &str, toml: &str) -> Result<Self, CellError> {
        let file: RobotFile = parse_toml(toml_name, toml)?;
        let tree = urdf::read(urdf_name, urdf, toml_name, &file)?;
        let covers = ClearanceModel::new(&tree.chain, shapes(&tree.links, &tree.gripper), &tree.home);
        Ok(Self {
            name: tree.name,
            geometry: Geometry { chain: tree.chain, covers },
            links: tree.links,
            gripper: tree.gripper,
            motors: MotorSpec {
                stiffness_n_m_rad: file.motors.stiffness_n_m_rad,
                damping_n_m_s_rad: file.motors.damping_n_m_s_rad,
                armature_kg_m2: file.motors.armature_kg_m2,
                joint_damping_n_m_s_rad: file.motors.joint_damping_n_m_s_rad,
                gravity_compensation: file.motors.gravity_compensation,
            },
            home: tree.home,
            digest: fnv1a(urdf.bytes().chain([0]).chain(toml.bytes())),
        })
    }

    /// Joint angles for a tool pose, warm-started and resting near home.
    #[must_use]
    pub fn solve_ik(&self, target: &Isometry3<f64>, warm: &[f64], options: &IkOptions) -> IkOutcome {
        self.geometry.chain.solve(target, warm, &self.home, options)
    }
}

/// Every collision shape with the piece it is on and its pose there; the fingers open, on the last piece.
pub(crate) fn shapes(links: &[LinkSpec], gripper: &GripperSpec) -> Vec<(usize, Transform, Shape)> {
    let mut all = Vec::new();
    for (link, spec) in links.iter().enumerate() {
        all.extend(spec.shapes.iter().map(|shape| (link, Transform::new(&shape.pose), shape.shape)));
    }
    for finger in &gripper.fingers {
        let open = Transform { rotation: Matrix3::identity(), origin: Vector3::z() * finger.stroke_m };
        let at = finger.origin.then(&open);
        let on_finger = finger.link.shapes.iter();
        all.extend(
            on_finger.map(|shape| (links.len() - 1, at.then(&Transform::new(&shape.pose)), shape.shape)),
        );
    }
    all
}

/// FNV-1a, 64 bit.
pub(crate) fn fnv1a(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
