//! Answers to typed lines and pasted text.

pub const CHANGE_THE_PACE: &str = "change the pace";
pub const NO_PACE_YET: &str = "no engine has told a pace yet";
pub const LET_A_DRIFT_SET_IN: &str = "let a drift set in";
pub const PASTE_IGNORED: &str = "pasted text is ignored here";
pub const NO_PASTE_IN_A_PROMPT: &str = "a prompt takes no pasted text: type it";

#[must_use]
pub fn no_such_theme(name: &str, known: &str) -> String {
    format!("there is no theme {name:?}; there are {known}")
}

#[must_use]
pub fn pace(times: Option<f64>) -> String {
    format!("{}; `:pace N` changes it", super::shared::live_pace(times))
}
