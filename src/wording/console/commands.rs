//! The help and the refusals of the command line.

use std::fmt::Display;

use holdpoint_governance::profile::ProfileName;

pub const USE_IDENTITY: &str = "Use this identity";
pub const SHOW_VERSION: &str = "Show a version in full";
pub const BLOCK_FOR_A_PROFILE: &str = "Block the version under the cursor for a profile, reason required";
pub const SUBMIT_DEMONSTRATION: &str = "Submit a demonstration candidate: the next one, or this one";
pub const START_A_DRIFT: &str = "Start a drift of the simulated cell, or end it";
pub const EXPORT_VIEW: &str = "Export this view as text and JSON";
pub const FILTER_BY_STATE: &str =
    "List only running, queued, waiting, held, rejected or own versions, or all";
pub const SET_THE_GOAL: &str = "Set the goal of the agent of the live cell, reason required";
pub const CONFIRM_TIME: &str =
    "Confirm the machine's time after a clock mismatch; nothing is activated before";
pub const LEAVE_A_NOTE: &str = "Leave a note for the next shift: on record, and marked in Health";
pub const UNBLOCK_FOR_A_PROFILE: &str = "Unblock the version under the cursor for a profile, reason required";
pub const SET_THE_PACE: &str = "Simulated seconds in a second of the live cell";
pub const SUBMIT_A_FOLDER: &str = "Submit a candidate's folder";
pub const USE_THEME: &str = "Use this theme";
pub const NEEDS_IDENTITY: &str = "the name of an identity; `holdpoint identity list` shows them";
pub const NEEDS_THEME: &str = "a name; tab shows them";
pub const NEEDS_GOAL: &str = "a goal: pick-align-place, grasp, align or place";

#[must_use]
pub fn needs_profile() -> String {
    format!("a profile: {}", ProfileName::listed("or"))
}

#[must_use]
pub fn is_no_version(text: &str, error: impl Display) -> String {
    format!("{text:?} is no version: {error}")
}

#[must_use]
pub fn no_such_command(command: &str) -> String {
    format!("there is no command {command:?}; ? lists them")
}

#[must_use]
pub fn takes_nothing(command: &str) -> String {
    format!(":{command} takes nothing after it")
}

#[must_use]
pub fn pace_not_allowed(text: &str, least: f64, most: f64) -> String {
    format!("the pace {text:?} is not allowed; max or a number from {least} to {most} is")
}

#[must_use]
pub fn no_such_demonstration(name: &str, known: &str) -> String {
    format!("there is no demonstration {name:?}; there are {known}")
}

#[must_use]
pub fn no_such_filter(name: &str, known: &str) -> String {
    format!("there is no filter {name:?}; there are {known}")
}

#[must_use]
pub fn allowed_drifts(kinds: &str, magnitudes: &str) -> String {
    format!("allowed are `:drift off`, or a kind ({kinds}) and a magnitude ({magnitudes})")
}
