//! What `version` prints: a version with its evidence and activations, the history of a family.

use std::fmt::Display;

/// A version without a decision.
pub const NOTHING_DECIDED: &str = "nothing has been decided about it yet";

/// Versions that a limit leaves out.
#[must_use]
pub fn more(left: usize) -> String {
    format!("{left} more; see --limit")
}

/// The author of a version, the origin, the parent, the estimated risk.
#[must_use]
pub fn submitted(
    author: impl Display,
    provenance: impl Display,
    parent: impl Display,
    risk: impl Display,
) -> String {
    format!("submitted by {author} ({provenance}), parent {parent}, estimated risk {risk}")
}

/// Whether evidence still counts.
#[must_use]
pub const fn is_current(current: bool) -> &'static str {
    if current { "yes" } else { "no: it was voided later" }
}

/// A move of the pointer to the active version.
#[must_use]
pub fn pointer_moved(record: u64, cause: impl Display, at: &str) -> String {
    format!("record {record}: active pointer moved ({cause}) at {at}")
}

/// The number of records about a version.
#[must_use]
pub fn audit_records(count: usize) -> String {
    format!("audit records: {count}")
}

/// A family: its active version, the target of a rollback, and the reason of a safe stop.
#[must_use]
pub fn family(
    name: impl Display,
    active: impl Display,
    rollback_target: impl Display,
    safe_stopped: Option<&str>,
) -> String {
    let stopped = safe_stopped.map_or_else(String::new, |reason| format!(", safe-stopped: {reason}"));
    format!("{name}: active {active}, rollback target {rollback_target}{stopped}")
}

/// A family without an activation.
pub const NEVER_ACTIVE: &str = "no version was active yet";
