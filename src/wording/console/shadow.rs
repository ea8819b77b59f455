//! The texts of the shadow view.

use crate::counted;

pub const HELP: &str = "Shadow: twin against live";
pub const TOUR: &str = "The twin against the live arm on the same sequences; f freezes";
pub const NO_TWIN: &str = "No candidate yet, and so no twin";
pub const DISAGREEMENTS: &str = "Disagreements, newest first";
pub const ACTIVE_HAS_NO_TWIN: &str = "It is active, and no twin runs beside it";
pub const NOT_IN_MEMORY: &str = "No shadow of it is in memory";
pub const NO_SEQUENCE_YET: &str = "No sequence has been shadowed yet";
pub const JUDGED_IN_PAIRS: &str = "signals judged in pairs";
pub const NO_LIMIT: &str = "no limit of its own";
pub const MONITORS: &str = "Monitors of active versions";
pub const NO_MONITOR_OPEN: &str = "No version is provisional or restricted, so no monitor's window is open";
pub const ONE_SEQUENCE_ALIKE: &str = "The one sequence so far ended alike in twin and live world";

#[must_use]
pub fn last_shown(shown: usize, zoom: u64) -> String {
    format!("the last {shown} shown, zoom {zoom}")
}

#[must_use]
pub fn shadow_is_over(key: &str) -> String {
    format!("Its shadow is over, not in memory: {key} opens the recording")
}

#[must_use]
pub fn window_over(tasks: u32, window: u32) -> String {
    format!("{}, window of {window} over", counted(tasks, "task"))
}

#[must_use]
pub fn all_sequences_alike(sequences: u64) -> String {
    format!("All {sequences} sequences so far ended alike in twin and live world")
}
