//! What a cell is and what it can do: geometry, zones, workpieces, tasks, sensors and abilities, as plain data.

use std::sync::Arc;

use holdpoint_body::chain::Transform;
use holdpoint_body::{Geometry, JointVec, Shape, TaskKind, Zone};
use nalgebra::Isometry3;
use sha2::{Digest as _, Sha256};

use crate::scene::Scene;

/// The shape of a part of the robot, in the part's frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PartShape {
    /// A primitive shape.
    Primitive(Shape),
    /// The convex hull of points, m.
    Hull(Vec<[f64; 3]>),
}

/// A collision shape on the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedShape {
    /// The piece it is on: 0 is the base, `i` the link of joint `i - 1`, and the fingers come last.
    pub piece: usize,
    /// Pose in the frame of the piece.
    pub pose: Isometry3<f64>,
    /// The shape.
    pub shape: PartShape,
}

/// The robot of a cell.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSpec {
    /// Name in its description.
    pub name: String,
    /// Digest of its description.
    pub digest: u64,
    /// Kinematics and covers of the arm.
    pub geometry: Arc<Geometry>,
    /// Collision shapes.
    pub parts: Vec<PlacedShape>,
    /// Home configuration, rad.
    pub home: JointVec,
    /// Last link frame to the frame of each closed finger, which slides along its own z axis.
    pub fingers: [Transform; 2],
    /// Largest distance between the pads, m.
    pub width_max_m: f64,
}

/// Something that is handled in the cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Workpiece {
    /// Name.
    pub name: String,
    /// Half extents, m.
    pub half_m: [f64; 3],
}

/// What a cell can do beyond the calls of its body. Evidence that needs a missing ability is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Abilities {
    /// It gives its state, so that a trial cell continues from it.
    pub export_state: bool,
    /// Its live cell says what its sensors tell of its state, and its trial cells can be set to that.
    pub set_observed: bool,
    /// It keeps the frames of an episode.
    pub film: bool,
    /// It gives true state, so that a referee can judge it.
    pub referee: bool,
}

/// A cell.
#[derive(Clone, Debug, PartialEq)]
pub struct CellSpec {
    /// The robot.
    pub robot: RobotSpec,
    /// Table, tray, clutter and what counts as done.
    pub scene: Arc<Scene>,
    /// The zones of the scene, first match wins.
    pub zones: Arc<[Zone]>,
    /// What is handled.
    pub workpieces: Vec<Workpiece>,
    /// The tasks that the cell presents, in their order.
    pub tasks: Vec<TaskKind>,
    /// Ticks per second.
    pub rate_hz: u32,
    /// Camera frames per second.
    pub camera_hz: u32,
    /// What it can do.
    pub abilities: Abilities,
}

impl CellSpec {
    /// Digest of the whole description.
    #[must_use]
    pub fn digest(&self) -> [u8; 32] {
        // The debug text contains type names; a build with other names has another digest in any case.
        Sha256::digest(format!("{self:?}").as_bytes()).into()
    }
}
