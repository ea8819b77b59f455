//! What the live cell looks like at one moment: what a screen draws, and nothing a decision reads.
//!
//! World frame, metres: x forward from the base, y to the left, z up. A picture is taken some thirty times a
//! second of simulated time and the newest one alone is kept; who looks late has missed the others.

use serde::{Deserialize, Serialize};

use crate::governance::ids::CapabilityId;

/// A point, m.
pub type Point = [f32; 3];

/// An upright box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// What it is: `table`, `tray`, `workspace`, or the name of a keep-out.
    pub name: String,
    /// Its smallest corner.
    pub min: Point,
    /// Its largest corner.
    pub max: Point,
}

/// What does not move: drawn behind the arm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scenery {
    /// Where the tool may be.
    pub workspace: Option<Region>,
    /// Where nothing may be.
    pub keep_outs: Vec<Region>,
    /// The table's and the tray's extent.
    pub fixtures: Vec<Region>,
}

/// An arm with its gripper and the object it works on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Joint origins from the base to the tool, in order; at least two.
    pub links: Vec<Point>,
    /// The two finger pads.
    pub pads: [Point; 2],
    /// The object's centre.
    pub object: Point,
    /// Half the object's edge, m.
    pub object_half_m: f32,
    /// Whether both pads touch the object.
    pub held: bool,
}

/// One moment of the live cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// The sequence, counting from 0.
    pub sequence: u64,
    /// Simulated seconds since it began.
    pub at_secs: f64,
    /// What is being done: `grasp`, `align`, `place`; absent at rest.
    pub task: Option<String>,
    /// Who does it.
    pub version: Option<CapabilityId>,
    /// The arm.
    pub body: Body,
    /// Speed of the tool, m/s.
    pub speed_m_s: f32,
    /// Contact force at the pads, N.
    pub force_n: f32,
    /// Whether something touches that should not.
    pub unexpected_contact: bool,
    /// Whether the arm was stopped.
    pub stopped: bool,
    /// The candidate's twin, where one runs beside it.
    pub twin: Option<Twin>,
}

/// The twin in its forked world. It drives nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Twin {
    /// The candidate.
    pub version: CapabilityId,
    /// Its arm.
    pub body: Body,
}
