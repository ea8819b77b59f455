//! The texts of the explanation of a check, and answers to its keys.

use holdpoint_governance::ids::CapabilityId;

pub const NO_RERUN: &str = "there is no re-run for this check";
pub const RERUN_IN_PROGRESS: &str = "a re-run is already in progress";
pub const WORKING_AGAIN: &str = "working it again";
pub const RERUN_READY: &str = "the re-run is ready; ask for it again to see it";
pub const NOTHING_GOES_WRONG: &str = "nothing goes wrong in it";
pub const NO_SUCH_CHECK: &str = "There is no such check any more; esc goes back";
pub const TO_PASS: &str = "To pass, this would have to change";
pub const TO_PASS_UNRESTRICTED: &str = "To pass without a restriction, this would have to change";
pub const MEASURED: &str = "Measured, the most serious first; more is worse";
pub const DIFFERENCES: &str = "Differences of the two versions";
pub const FAR_BEYOND: &str = "far beyond";
pub const NO_WORSE: &str = "no worse";

#[must_use]
pub fn first_or_last(which: &str, what: &str) -> String {
    format!("this is the {which} {what}")
}

#[must_use]
pub fn see_it_work(version: &CapabilityId) -> String {
    format!("see {version} work")
}
