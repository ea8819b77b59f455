//! The parts of the status line.

pub const NO_DATA_YET: &str = "No data from the engine yet";

#[must_use]
pub fn stopped_by(by: &str, since: &str) -> String {
    format!("STOPPED by {by} since {since}")
}

#[must_use]
pub fn stopped_again(by: &str, since: &str, last: &str, again: &str, more: &str) -> String {
    format!("STOPPED by {by} {since}, {last} {again}{more}")
}

/// As [`stopped_by`] or [`stopped_again`], without the times.
#[must_use]
pub fn stopped_untimed(by: &str, last: Option<&str>, more: &str) -> String {
    let last = last.map_or_else(String::new, |last| format!(", {last}"));
    format!("STOPPED by {by}{last}{more}")
}

pub const NO_ALARM: &str = "no alarm";
pub const ONLY_SHELVED_ALARMS: &str = "only shelved alarms";

#[must_use]
pub fn none_last_seen(seen: &str, none: &str) -> String {
    format!("last seen {seen}: {none}")
}
