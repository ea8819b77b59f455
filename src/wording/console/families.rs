//! The texts of the families in control.

use crate::counted;
use holdpoint_governance::ids::CapabilityId;

pub const NO_ACTIVE_VERSION: &str = "no active version";
pub const WAITS_FOR_CONFIRMATION: &str = "waits for its confirmation";
pub const NO_SEQUENCE: &str = "no sequence yet";
pub const WINDOW_OVER: &str = "window over";

#[must_use]
pub fn re_evaluated(done: u64, budget: u64) -> String {
    format!("  re-evaluated, {done} of {budget}")
}

#[must_use]
pub fn in_confirmation(done: u64, budget: u64) -> String {
    format!("in confirmation, {done} of {budget}")
}

#[must_use]
pub fn waits_behind(version: &CapabilityId) -> String {
    format!("waits for its confirmation, behind {version}")
}

#[must_use]
pub fn sequences_since(count: u64, since: &str) -> String {
    format!(", {} since {since}", counted(count, "sequence"))
}

#[must_use]
pub fn success(percent: f64, recent: u64) -> String {
    format!("  {percent:.0} % of the last {recent}")
}
