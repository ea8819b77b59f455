//! The texts of the alarms and of their history.

pub const TOUR: &str = "Space says that you have seen an alarm, and resumes nothing";
pub const ORDER_OF_ATTENTION: &str = "alarms stand in the order of attention";
pub const NO_ALARM_OPEN: &str = "No alarm is open";
pub const IN_A_FLOOD: &str = " in a flood, critical ones apart";
pub const CHATTERING: &str = ", chattering: shown as one";
pub const CONDITION_GONE: &str = "the condition is gone; not acknowledged";
pub const NOT_ACKNOWLEDGED: &str = "not acknowledged";
pub const LAST_30_DAYS: &str = "Alarms of the last 30 days";
pub const NONE_IN_30_DAYS: &str = "No alarm was raised in the last 30 days";

#[must_use]
pub fn rate(more: &str, recent: usize) -> String {
    let calls = if recent == 1 { "call" } else { "calls" };
    format!(", {more}{recent} {calls} in 10 min (1 to 2 are normal)")
}

#[must_use]
pub fn group(glyph: &str, count: usize, first: &str) -> String {
    format!("{glyph} {count} alarms, the first: {first}")
}

#[must_use]
pub fn about(subject: &str, since: &str, times: &str, chatter: &str) -> String {
    format!("about {subject}, for {since}, raised {times}{chatter}")
}

#[must_use]
pub fn shelved(by: &str, until: &str, below: &str, why: &str) -> String {
    format!("shelved by {by} until {until}, then {below} again: {why}")
}

#[must_use]
pub fn stays_until_reset(glyph: &str) -> String {
    format!("{glyph} stays until it is reset with a reason")
}

#[must_use]
pub fn group_keys(count: usize, subject: &str, open: &str, acknowledge: &str) -> String {
    format!("{count} alarms of {subject}: {open} shows each, {acknowledge} acknowledges all")
}

#[must_use]
pub fn acknowledged(by: &str) -> String {
    format!("acknowledged by {by}; acknowledging resumes nothing")
}
