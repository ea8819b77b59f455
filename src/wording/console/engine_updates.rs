//! What the console says when its engine comes, goes or answers.

use crate::counted;

pub const ENGINE_GONE: &str = "the engine is gone";
pub const ENGINE_ENDED: &str = "the engine ended";
pub const ENGINE_DID_NOT_COME_UP: &str = "the engine did not come up";
pub const ANOTHER_ENGINE_FOLLOWS: &str =
    "(the engine that told this is gone; another one tells what follows)";
pub const ENGINE_WAS_LOST: &str = "no answer: the engine was lost, and whether it was carried out is unknown";
pub const CONNECTION_LOST: &str = "the connection to the engine was lost";
pub const ATTACHED_AGAIN: &str = "the engine kept running, and this console is attached to it again";
pub const ASKED_ENGINE_GONE: &str = "the engine that was asked is gone";
pub const ATTACHED_TO_ANOTHER: &str =
    "an engine runs on this store again, and this console is attached to it";
pub const ENGINE_BEGAN_HERE: &str = "(the engine began here)";

#[must_use]
pub fn request_in_doubt(lost: &str) -> String {
    format!("{lost}; whether your request was carried out is unknown")
}

#[must_use]
pub fn log_begins_here(earlier: u64) -> String {
    format!("(the log begins here; only the record has {} of this engine)", counted(earlier, "earlier event"))
}

#[must_use]
pub fn cell_runs_again(by: &str) -> String {
    format!("the cell runs again: started by {by}")
}

#[must_use]
pub fn next_is_submitted(refusal: &str) -> String {
    format!("{refusal}, by another client meanwhile: the next one is submitted")
}

#[must_use]
pub fn next_must_be_asked_for(refusal: &str) -> String {
    format!("{refusal}, by another client meanwhile: `:demo` again takes the next one")
}

/// The engine's answer about an alarm, and the number of those that were changed with it.
#[must_use]
pub fn alarm_changed(text: &str, others: usize) -> String {
    match others {
        0 => text.to_owned(),
        1 => format!("{text}, and so is 1 other"),
        _ => format!("{text}, and so are {others} others"),
    }
}
