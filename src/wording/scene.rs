//! The names of views and of chart lines in a recording.

pub const CELL_AND_TWIN: &str = "Cell and twin";

pub const FORCE_AT_PADS: &str = "force at the pads, N";
pub const FINGER_LIMIT: &str = "limit of the fingers";
pub const FORCE_ON_SURROUNDINGS: &str = "force on the surroundings, N";
pub const SURROUNDINGS_LIMIT: &str = "limit on the surroundings";
pub const OUTPUT_LIMIT: &str = "limit of output";
pub const GOVERNANCE_LIMIT: &str = "limit of governance";
pub const ENVELOPE_LIMIT: &str = "limit of envelope";
pub const INTERFACE_LIMIT: &str = "limit of interface";
pub const POLICY_LIMIT: &str = "limit of policy";
pub const BEHAVIOR_LIMIT: &str = "limit of behavior";
pub const RECOVERY_LIMIT: &str = "limit of recovery";
