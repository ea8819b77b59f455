//! Answers to keys that belong to no view.

use holdpoint_governance::ids::Family;

pub const RELOADED: &str = "keys and themes are reloaded: their files changed";
pub const HAS_LEFT_THE_LIST: &str =
    "what was under the cursor has just left the list: look again, then press the key";
pub const NO_SUSPENDING: &str =
    "a suspended console shows no alarm and stops nothing; `:quit` leaves it cleanly";
pub const MOUSE_IS_OURS: &str = "the mouse is this console's: it clicks and turns here";
pub const MOUSE_IS_THE_TERMINALS: &str = "the mouse is the terminal's again: it marks text there";
pub const NOTHING_TO_COPY: &str = "there is nothing under the cursor to copy";
pub const OPEN_THE_APPROVAL: &str = "open the waiting approval first (a, then Enter)";
pub const NOTHING_MARKED_ANY_MORE: &str = "nothing is marked any more";

#[must_use]
pub fn impossible_read_only(action: &str) -> String {
    format!("{action:?} is not possible: this console is read-only")
}

#[must_use]
pub fn no_active_version(family: &Family) -> String {
    format!("{family} has no active version: choose one of its versions")
}
