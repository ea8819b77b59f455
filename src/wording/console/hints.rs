//! The words for keys at the foot of the screen.

pub const MOMENT_IT_FAILS: &str = "moment it fails";
pub const OFF_READ_ONLY: &str = "(off: read-only)";
pub const PRESSES_THE_BUTTON: &str = "presses the button";
pub const LEAVE_THE_FIELD: &str = "leave the field";
pub const START_THE_CELL: &str = "start the cell";
pub const RUNS_IT: &str = "runs it";
pub const DECIDE_LATER: &str = "decide later";
pub const LET_RUN: &str = "let run";
