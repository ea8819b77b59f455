//! Answers to keys of what lies over a view.

use holdpoint_governance::ids::CapabilityId;

pub const CLOSE_THIS_FIRST: &str = "no command is typed here: Esc closes this, then type it again";
pub const TAKEN_BACK: &str = "taken back: nothing was signed or sent";
pub const TOO_LATE: &str = "it is too late to take it back: it is signed and sent; wait for the answer";
pub const ENGINE_SILENT: &str = "the engine does not answer";
pub const UNDECIDED: &str = "undecided: it waits, and is on hold from its deadline";

#[must_use]
pub fn ends_the_tour(key: &str) -> String {
    format!(" ({key} ends the tour)")
}

#[must_use]
pub fn approved_and(version: &CapabilityId, takeover: &str) -> String {
    format!("{version} is approved and {takeover}")
}

#[must_use]
pub fn nothing_was_done(what: &str) -> String {
    format!("nothing was done: {what}")
}

#[must_use]
pub fn making_identity(name: &str) -> String {
    format!("making the identity {name}")
}
