//! The texts of the event log.

use crate::counted;

pub const NO_LINE_FITS: &str = "No line fits the filter";
pub const NOTHING_HAPPENED: &str = "Nothing has happened yet";

#[must_use]
pub fn sequences(sequences: u32, done: u32) -> String {
    format!("{}, {done} done, the last: ", counted(sequences, "sequence"))
}

#[must_use]
pub fn tasks_past_limit(tasks: u32) -> String {
    format!("{}, the last: ", counted(tasks, "task"))
}

#[must_use]
pub fn shows_more(key: &str) -> String {
    format!("{key} shows more")
}
