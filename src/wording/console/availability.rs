//! Why a key has no effect here and now.

pub const MEANS_NOTHING_HERE: &str = "it means nothing in this view";
pub const NO_VERSION: &str = "no version is under the cursor";
pub const NOTHING_UNDER_WAY: &str = "nothing is under way";
pub const NO_ALARM: &str = "no alarm is under the cursor";
pub const NOTHING_SEARCHED: &str = "nothing was searched for yet";
pub const NOTHING_TO_MARK: &str = "nothing under the cursor can be marked";
pub const NO_BREAK_GLASS: &str = "break-glass does not apply to it";
