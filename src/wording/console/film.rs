//! The texts of a re-run.

pub const DIFFERS_FROM_THE_RECORD: &str = "this re-run differs from the record";
pub const STOPPED_IN_IT: &str = "stopped in this re-run";
pub const NOT_AS_RECORDED: &str = "NOT AS RECORDED";

#[must_use]
pub fn no_frame(ended: &str) -> String {
    format!("No frame: it {ended}")
}
