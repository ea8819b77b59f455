//! The texts of the smallest windows.

pub const MAKE_IT_LARGER: &str = "Make the window larger to read what is open, or leave it with Esc";
pub const NOTHING_HERE_YET: &str = "Nothing here yet";
pub const NOTHING_WAITS: &str = "Nothing waits";
