//! Parts of sentences that several views use.

pub const ENGINE_HALTED: &str = "the engine is halted";
pub const CELL_STOPPED: &str = "the cell is stopped";
pub const TAKES_OVER_AT_START: &str = "takes over as soon as the cell starts";
pub const TAKES_OVER_AFTER_SEQUENCE: &str = "takes over when the sequence that runs is over";
pub const OFFICER_MISSING: &str = ", safety officer missing";
pub const STAYS_RESTRICTED: &str = "it stays restricted";
pub const DEMOTED: &str = "it is demoted";
pub const VOID: &str = "it is void";
