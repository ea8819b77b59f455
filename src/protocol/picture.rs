//! What the live cell looks like at one moment: what a screen draws, and nothing a decision reads.
//!
//! World frame, metres: x forward from the base, y to the left, z up. A picture is taken some thirty times a
//! second of simulated time and the newest one alone is kept; who looks late has missed the others.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use holdpoint_body::TaskKind;
use holdpoint_governance::ids::CapabilityId;

/// A point in the world frame, m: x, y, z.
pub type Point = [f32; 3];

/// A box with its edges along the axes of the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Region {
    /// What it is: `table`, `tray`, `workspace`, or the name of a keep-out.
    pub name: String,
    /// Its corner with the smallest coordinates.
    pub min: Point,
    /// Its corner with the largest coordinates.
    pub max: Point,
}

/// What does not move: drawn behind the arm.
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
pub type Turn = [f32; 4];

/// The rotation that turns nothing.
pub const NO_TURN: Turn = [0.0, 0.0, 0.0, 1.0];

/// An arm with its gripper and the object it works on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ArmPicture {
    /// Joint origins from the base to the tool, in order; at least two.
    pub links: Vec<Point>,
    /// Centres of the two finger pads.
    pub pads: [Point; 2],
    /// How the hand, and so each pad, is turned.
    pub hand: Turn,
    /// Centre of the object it works on.
    pub object: Point,
    /// Rotation of the object in the world frame.
    pub object_turn: Turn,
    /// Half the edge of the object, drawn as a cube, m.
    pub object_half_m: f32,
    /// Whether both finger pads touch the object.
    pub held: bool,
}

/// A block that stands in the cell for one sequence: a part of the tray, or a piece of clutter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Block {
    /// Centre of the block.
    pub at: Point,
    /// Half the edges along the block's own axes, m.
    pub half_m: [f32; 3],
    /// Rotation of the block in the world frame.
    pub turn: Turn,
}

/// Where the robot or the object touches something, and how hard.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Contact {
    /// Where the two surfaces meet.
    pub at: Point,
    /// The force on the robot, or on the object if the robot has no part in it, world frame, N.
    pub force_n: [f32; 3],
}

/// The most contacts in one picture, the strongest.
pub const CONTACTS_MAX: usize = 16;

/// The envelope that the guard holds the version at work to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EnvelopePicture {
    /// Largest speed of the tool's centre point, m/s.
    pub speed_m_s: f32,
    /// Largest grip force of one finger, N.
    pub force_n: f32,
    /// Largest force on the surroundings, N.
    pub contact_n: f32,
}

/// One moment of the live cell, as a screen or a recording draws it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Picture {
    /// The sequence of the live world, counting from 0.
    pub sequence: u64,
    /// The engine's virtual time, ms.
    pub at_ms: u64,
    /// Simulated seconds since the sequence began.
    pub at_secs: f64,
    /// What is being done; absent at rest.
    pub task: Option<TaskKind>,
    /// The version that does it; absent at rest.
    pub version: Option<CapabilityId>,
    /// The arm of the live cell.
    pub body: ArmPicture,
    /// Speed of the tool, m/s.
    pub speed_m_s: f32,
    /// Contact force at the pads, N.
    pub force_n: f32,
    /// Largest force of the robot, or of what it holds, on its surroundings, N.
    pub contact_n: f32,
    /// What the guard allows of it; absent at rest.
    pub envelope: Option<EnvelopePicture>,
    /// What touches what, the strongest first.
    pub contacts: Vec<Contact>,
    /// What stands in the cell in this sequence: the parts of the tray, which is the target, then the clutter.
    pub blocks: Vec<Block>,
    /// Whether something touches that the task at hand does not touch.
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
    pub body: ArmPicture,
}
