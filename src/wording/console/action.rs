//! The headings of the help.

pub const VERSION_UNDER_THE_CURSOR: &str = "Version under the cursor";
pub const OPEN_PROMPT: &str = "Open approval prompt";
