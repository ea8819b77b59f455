//! The texts of the form that starts a stopped cell.

use holdpoint_governance::ids::CapabilityId;

use crate::counted;

pub const NOT_STOPPED: &str = "the cell is not stopped";
pub const ARM_MOVES_AGAIN: &str = "The arm moves again at once; make sure that the cell is empty";
pub const ALREADY_STARTED: &str = "the cell has already been started";

#[must_use]
pub fn engine_is_halted(why: &str) -> String {
    format!("the engine is halted, and lets nothing work before it is started again: {why}")
}

#[must_use]
pub fn takes_control_at_once(version: &CapabilityId) -> String {
    format!("{version} is approved and takes control at once")
}

#[must_use]
pub fn stopped_by(author: &str, since: &str, why: &str) -> String {
    format!("Stopped by {author}, since {since}{why}")
}

#[must_use]
pub fn stopped_again_unnamed(times: u64) -> String {
    format!("and {}, by whom the record says", counted(times, "more time"))
}

#[must_use]
pub fn and_by(author: &str, at: &str, why: &str) -> String {
    format!("and by {author}, at {at}{why}")
}

#[must_use]
pub fn not_included(message: &str) -> String {
    format!("{message}; your request does not include it and will be refused")
}

#[must_use]
pub fn stopped_it_again(author: &str, at: &str) -> String {
    format!("{author} has stopped it again at {at}: read why first")
}
