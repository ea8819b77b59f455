//! Faults that drills inject.
//!
//! A fault is the cell's: something breaks, and the sensors show what follows from it. It has no
//! name that a watcher could read.

use serde::{Deserialize, Serialize};

/// Something that breaks, from the next tick on and for the rest of the episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InjectedFault {
    /// Every camera frame is lost.
    CameraLost,
    /// The gripper takes no command any more; it keeps its last one.
    ToolDead,
    /// The gripper's drive has no force any more.
    GripLost,
    /// One joint stays at its last commanded position.
    JointStuck {
        /// Index of the joint, base first.
        joint: usize,
    },
    /// The drive of one joint turns slowly to its stop and ignores commands.
    JointRunaway {
        /// Index of the joint, base first.
        joint: usize,
    },
}

/// Speed of a joint that runs away, rad/s: well above what counts as standing, far below its limit.
pub(crate) const RUNAWAY_RAD_S: f64 = 0.3;

/// The faults in force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct ActiveFaults {
    pub(crate) tool_dead: bool,
    pub(crate) grip_lost: bool,
    pub(crate) stuck_joint: Option<usize>,
    pub(crate) runaway_joint: Option<usize>,
}
