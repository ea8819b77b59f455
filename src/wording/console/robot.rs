//! The texts of the robot pane.

pub const NO_FRAME: &str = "No frame: the live cell has sent none yet, or it is not a simulated one";
pub const DRIVES_NOTHING: &str = "; it drives nothing";

#[must_use]
pub fn unexpected_contact(glyph: &str) -> String {
    format!("{glyph} unexpected contact")
}

#[must_use]
pub fn last_seen(time: &str) -> String {
    format!("last seen {time}: ")
}
