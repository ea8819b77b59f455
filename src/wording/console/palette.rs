//! The texts of the window of keys and commands.

pub const TITLE: &str = "Keys and commands";
pub const NOTHING_FITS: &str = "Nothing fits; Backspace widens the search";
