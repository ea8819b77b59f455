//! Texts that several views and keys of the console share.

use std::fmt::Display;

pub const NO_VERSION_HERE: &str = "there is no version under the cursor";
pub const READ_ONLY: &str = "this console is read-only";
pub const QUESTION_CLOSED: &str = "the question is closed";
pub const ENGINE_STARTING: &str = "The engine is starting";
pub const RECORD_IS_BEING_READ: &str = "The record is being read";
pub const ENGINE_SHUT_DOWN_CLEANLY: &str = "the engine shut down cleanly";
pub const NO_ENGINE_HERE: &str = "no engine is running here";
pub const NO_ENGINE_HERE_TITLE: &str = "No engine is running here";
pub const ORDER_OF_TIME: &str = "this list is in the order of time; the registry can be sorted";
pub const CHOOSE_IDENTITY_FIRST: &str = "choose your identity first (`:as NAME`)";

#[must_use]
pub fn more_below(rows: usize, key: &str) -> String {
    format!("{rows} more below: {key}")
}

#[must_use]
pub fn without_action(consequence: &str) -> String {
    format!("without action: {consequence}")
}

#[must_use]
pub fn look_at(what: &str) -> String {
    format!("look at: {what}")
}

#[must_use]
pub fn not_in_this_list(text: &str) -> String {
    format!("{text:?} is not in this list")
}

#[must_use]
pub fn file_too_large(bytes: usize, most: usize) -> String {
    format!("the file has {bytes} bytes; at most {most} are allowed")
}

#[must_use]
pub fn frozen(glyph: &str, since: &str, key: &str) -> String {
    format!("{glyph} FROZEN since {since}, {key} lets it run")
}

#[must_use]
pub fn who_first(title: &str) -> String {
    format!("{CHOOSE_IDENTITY_FIRST}: {title}")
}

#[must_use]
pub fn cannot_use_terminal(error: impl Display) -> String {
    format!("cannot use this terminal: {error}")
}

/// The pace of the live cell; none for as fast as it computes.
#[must_use]
pub fn live_pace(times: Option<f64>) -> String {
    times.map_or_else(
        || "the live cell runs as fast as it computes".to_owned(),
        |times| format!("the live cell runs {times} simulated seconds a second"),
    )
}
