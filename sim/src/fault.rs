//! The injected faults that are in force in a world.

use serde::{Deserialize, Serialize};

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
