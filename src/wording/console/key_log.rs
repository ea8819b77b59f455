//! The texts of the log of keys.

pub const NO_KEY_YET: &str = "No key has done anything yet";
pub const NOT_ANSWERED_YET: &str = "the engine has not answered yet";

#[must_use]
pub fn more_answers_missing(text: &str) -> String {
    format!("the engine: {text}; more answers are missing")
}

#[must_use]
pub fn engine_answered(text: &str) -> String {
    format!("the engine: {text}")
}
