//! What the console says about a recording that it read.

#[must_use]
pub fn read_while_busy(version: &str) -> String {
    format!("the recording of {version} is read; ask for it again to see it")
}

#[must_use]
pub fn holds_nothing_yet(version: &str) -> String {
    format!("the recording of {version} has neither frames nor events yet")
}

#[must_use]
pub fn replayed_here(why: &str) -> String {
    format!("{why}; this terminal replays it")
}
