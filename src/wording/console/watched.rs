//! The texts of a version that is watched.

use holdpoint_governance::ids::CapabilityId;

pub const THEN_CONFIRMED: &str = ", then it is confirmed";
pub const EACH_AT_ZERO: &str = "each at 0 %";
pub const DEACTIVATES_IT: &str = "deactivates it";

#[must_use]
pub fn rolls_it_back_to(version: &CapabilityId) -> String {
    format!("rolls it back to {version}")
}

#[must_use]
pub fn first_warning(back: &str) -> String {
    format!("the first warning {back}, without a question")
}

#[must_use]
pub fn of_their_limits(near: &str, then: &str) -> String {
    format!("of their limits: {near}; {then}")
}

#[must_use]
pub fn admitted_below(glyph: &str, below: &str) -> String {
    format!("{glyph} admitted below its limit: {below}")
}

#[must_use]
pub fn tasks_watched(worked: u32, needed: u32, then: &str) -> String {
    format!(" {worked} of {needed} tasks{then}")
}
