//! A video frame of the live cell: screens draw it, and no decision reads it.
//!
//! World frame, meters: x forward from the base, y to the left, z up. There are about thirty video frames per
//! simulated second, and only the newest is kept: a late reader misses the others.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use holdpoint_body::TaskKind;
use holdpoint_governance::ids::CapabilityId;

/// A point in the world frame, m: x, y, z.
pub type WorldPoint = [f32; 3];

/// A box with its edges along the axes of the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Region {
    /// Its name: `table`, `tray`, `workspace`, or that of a keep-out.
    pub name: String,
    /// Its corner with the smallest coordinates.
    pub min: WorldPoint,
    /// Its corner with the largest coordinates.
    pub max: WorldPoint,
}

/// The fixed objects, drawn behind the arm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scenery {
    /// The box the tool has to stay in.
    pub workspace: Option<Region>,
    /// Boxes the robot has to keep out of.
    pub keep_outs: Vec<Region>,
    /// The table's and the tray's extent.
    pub fixtures: Vec<Region>,
}

impl Region {
    /// Name of the fixture that is the table: it is solid, the others are outlines on it.
    pub const TABLE: &str = "table";
}

/// A rotation as a unit quaternion: x, y, z, w.
pub type Orientation = [f32; 4];

/// The rotation that turns nothing.
pub const NO_TURN: Orientation = [0.0, 0.0, 0.0, 1.0];

/// An arm with its gripper and the object it works on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArmView {
    /// Joint origins from the base to the tool, in order; at least two.
    pub links: Vec<WorldPoint>,
    /// Center points of the two finger pads.
    pub pads: [WorldPoint; 2],
    /// Rotation of the hand, and so of each pad.
    pub hand: Orientation,
    /// Center of the object it works on.
    pub object: WorldPoint,
    /// Rotation of the object in the world frame.
    pub object_turn: Orientation,
    /// Half the edge of the object, drawn as a cube, m.
    pub object_half_m: f32,
    /// Whether both finger pads touch the object.
    pub held: bool,
}

/// What a block in the cell is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BlockRole {
    /// A part of the tray, which is the target.
    Tray,
    /// A piece of clutter, and every block in a recording of an earlier version.
    #[default]
    Clutter,
}

/// A block in the cell for one sequence: a part of the tray, or a piece of clutter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneBlock {
    /// What it is, by the scene of the cell.
    #[serde(default)]
    pub role: BlockRole,
    /// Center of the block.
    pub at: WorldPoint,
    /// Half the edges along the block's own axes, m.
    pub half_m: [f32; 3],
    /// Rotation of the block in the world frame.
    pub turn: Orientation,
}

/// A contact of the robot or the object, with its force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Contact {
    /// Where the two surfaces meet.
    pub at: WorldPoint,
    /// The force on the robot, or on the object if the robot has no part in it, world frame, N.
    pub force_n: [f32; 3],
}

/// The most contacts in one video frame, the strongest.
pub const CONTACTS_MAX: usize = 16;

/// The envelope that the guard enforces for the acting version.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EnvelopeView {
    /// Largest speed of the tool center point, m/s.
    pub speed_m_s: f32,
    /// Largest grip force of one finger, N.
    pub force_n: f32,
    /// Largest force on the surroundings, N.
    pub contact_n: f32,
}

/// One frame of the live cell, for a screen or a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VideoFrame {
    /// The sequence of the live world, counting from 0.
    pub sequence: u64,
    /// The engine's virtual time, ms.
    pub at_ms: u64,
    /// Simulated seconds since the sequence began.
    pub at_secs: f64,
    /// The current task; absent at rest.
    pub task: Option<TaskKind>,
    /// The acting version; absent at rest.
    pub version: Option<CapabilityId>,
    /// The arm of the live cell.
    pub body: ArmView,
    /// Speed of the tool, m/s.
    pub speed_m_s: f32,
    /// Contact force at the pads, N.
    pub force_n: f32,
    /// Largest force of the robot or its object on the surroundings, N.
    pub contact_n: f32,
    /// The limits of its guard; absent at rest.
    pub envelope: Option<EnvelopeView>,
    /// The contacts, the strongest first.
    pub contacts: Vec<Contact>,
    /// The blocks in the cell in this sequence: the parts of the tray, which is the target, and the clutter.
    pub blocks: Vec<SceneBlock>,
    /// Whether there is a contact that the current task does not make.
    pub unexpected_contact: bool,
    /// Whether the arm was stopped from outside the skill.
    pub stopped: bool,
    /// The candidate's twin; absent unless shadow runs beside the sequence.
    pub twin: Option<Twin>,
}

/// The twin in its forked world. It drives nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Twin {
    /// The candidate that drives the twin.
    pub version: CapabilityId,
    /// The twin's arm, in its own copy of the world.
    pub body: ArmView,
}
