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
