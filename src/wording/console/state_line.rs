//! The texts of the line below the views.

use holdpoint_protocol::snapshot::StartupProgressView;

use crate::program::run::startup_progress;

pub const NOTHING_DRIVES: &str = " no version drives the arm now";

#[must_use]
pub fn held_elsewhere(stop: &str) -> String {
    format!("NO ENGINE HERE: another one holds the store and may move the arm; {stop} asks it to stop")
}

#[must_use]
pub fn ended(seen: &str) -> String {
    format!("ENGINE ENDED, last seen {seen}: no version drives the arm, and nothing here stops it")
}

#[must_use]
pub fn gone(seen: &str) -> String {
    format!("ENGINE GONE, last seen {seen}: the arm may move; use its physical stop")
}

#[must_use]
pub fn ending(stop: &str) -> String {
    format!("ENGINE ENDING: the arm may move until it has ended; {stop} stops it")
}

#[must_use]
pub fn silent(seen: &str, stop: &str) -> String {
    format!("ENGINE SILENT since {seen}: the arm may move; press {stop}, or its physical stop")
}

#[must_use]
pub fn starts_the_cell(who: &str, key: &str, why: &str) -> String {
    format!("{who}: {key} starts the cell{why}")
}

#[must_use]
pub fn starting(reading: Option<StartupProgressView>, stop: &str) -> String {
    format!("STARTING, {}; only {stop} works", startup_progress(reading))
}

#[must_use]
pub fn halted(why: &str) -> String {
    format!("ENGINE HALTED, no version is evaluated: {why}")
}

#[must_use]
pub fn not_authorized(why: &str) -> String {
    format!("PROFILE NOT AUTHORIZED: {why}")
}

#[must_use]
pub fn time_not_confirmed(why: &str) -> String {
    format!("TIME NOT CONFIRMED, nothing is activated: {why}")
}
