//! The texts of the overview.

use holdpoint_governance::ids::CapabilityId;

pub const HELP: &str = "Overview: robot, active versions, pipeline";
pub const TOUR: &str = "Candidates walk seven stages beside the live arm; X stops it";
pub const LEAVE_IT_ON: &str = "leave it on";
pub const NOTHING_CHECKED: &str = "Nothing of it has been checked yet";
pub const END_ENGINE: &str = "end engine";
pub const NEWEST_FIRST: &str = "newest first";

#[must_use]
pub fn opens_all(key: &str) -> String {
    format!("{key} opens all of it")
}

#[must_use]
pub fn lines_filtered(shown: usize, all: usize, filter: &str) -> String {
    format!("{shown} of {all} lines with {filter:?}, newest first")
}

#[must_use]
pub fn rolled_back_in(left: &str) -> String {
    format!("  rolled back in {left}")
}

#[must_use]
pub fn checks_of(version: &CapabilityId) -> String {
    format!("Checks of {version}")
}
