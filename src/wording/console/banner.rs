//! The texts of the line above the views.

use std::fmt::Display;

pub const NO_MORE_LOOKS: &str = " (no more looks: start `holdpoint` again)";
pub const NO_NAME: &str = "  no name: `:as NAME`";
pub const ENGINE_ENDED: &str = "ENGINE ENDED";

#[must_use]
pub fn held_elsewhere(search: &str) -> String {
    format!("NO ENGINE HERE: another one holds the store{search}")
}

#[must_use]
pub fn not_verified_yet(read: u64, of: u64) -> String {
    format!("NOT VERIFIED YET {read} of {of} records")
}

#[must_use]
pub fn not_authorized(glyph: &str) -> String {
    format!("{glyph} PROFILE NOT AUTHORIZED")
}

#[must_use]
pub fn time_not_confirmed(glyph: &str) -> String {
    format!("{glyph} TIME NOT CONFIRMED")
}

#[must_use]
pub fn no_engine(search: &str, why: impl Display) -> String {
    format!("NO ENGINE{search}: {why}")
}

#[must_use]
pub fn engine_ended(search: &str, why: impl Display) -> String {
    format!("ENGINE ENDED{search}: {why}")
}

#[must_use]
pub fn engine_gone(search: &str, rest: &str) -> String {
    format!("ENGINE GONE{search}{rest}")
}

#[must_use]
pub fn last_seen(time: &str) -> String {
    format!("last seen {time}")
}

#[must_use]
pub fn engine_halted(glyph: &str, why: &str) -> String {
    format!("{glyph} ENGINE HALTED {why}")
}

#[must_use]
pub fn frozen_since(glyph: &str, time: &str) -> String {
    format!("{glyph} frozen since {time}")
}

#[must_use]
pub fn looks_again(tries: u32, most: u32) -> String {
    format!(" (looks again {tries}/{most})")
}

#[must_use]
pub fn others(count: usize, not_reading: usize) -> String {
    if not_reading > 0 { format!("+{count}, {not_reading} NOT READING") } else { format!("and {count} more") }
}
