//! The texts of the view of one candidate.

use holdpoint_governance::ids::{CapabilityId, Family};

pub const HELP: &str = "Candidate: every check and its evidence";
pub const TOUR: &str = "Why it is in this state; tab leads on to the evidence";
pub const NO_CANDIDATE: &str = "No candidate yet: choose a version in the registry, or submit one (`:demo`)";
pub const TOOK_OVER_FROM_NONE: &str =
    "It took over from no other version, so there is nothing that it differs from";
pub const NO_DECISION_YET: &str = "No decision has been made about it yet";
pub const NO_RECORD_READ: &str = "No record about it has been read";
pub const COMMISSIONED: &str =
    "It was commissioned with the cell: no evaluation compared it with another version";
pub const NO_SANDBOX_EPISODE: &str = "No sandbox episode";
pub const NO_RECOVERY_DRILL: &str = "No recovery drill";
pub const NO_DECISION: &str = "No decision yet";
pub const NO_CHECK: &str = "No check";
pub const NOT_MEASURED_YET: &str = "not measured yet";
pub const NOT_COMPARED: &str = "  not compared";

#[must_use]
pub fn asking_the_engine(glyph: &str, version: &CapabilityId) -> String {
    format!("{glyph} Asking the engine about {version}")
}

#[must_use]
pub fn origin(digest: &str, evidence: &str, parent: &str, registered: &str) -> String {
    format!("digest {digest}  evidence {evidence}  made from {parent}  registered {registered}")
}

#[must_use]
pub fn admitted_and_waived(below: &str, people: &str) -> String {
    format!("admitted below its limit: {below}; waived by {people}")
}

#[must_use]
pub fn shows_live_tasks(key: &str) -> String {
    format!("{key} shows how its live tasks go")
}

#[must_use]
pub fn no_field_differs(against: &CapabilityId) -> String {
    format!("No field of manifest or parameters differs from {against}")
}

#[must_use]
pub fn nothing_to_compare_with(family: &Family) -> String {
    format!("Nothing to compare with: no version of {family} is active")
}

#[must_use]
pub fn nothing_on_record(what: &str, state: &str) -> String {
    format!("{what} of it is on record: it was {state} before")
}

#[must_use]
pub fn nothing_ran_yet(what: &str) -> String {
    format!("{what} of it has run yet")
}

#[must_use]
pub fn better_to_worse(better: f64, worse: f64) -> String {
    format!("{better:.3} better to {worse:.3} worse")
}

#[must_use]
pub fn drills_of_the_active(passed: u64, all: u64) -> String {
    format!(" active {passed} of {all} (the line)")
}

#[must_use]
pub fn would_change_it(change: &str) -> String {
    format!("would change it: {change}")
}

#[must_use]
pub fn not_established(change: &str) -> String {
    format!("not established: {change}")
}

#[must_use]
pub fn not_tested(glyph: &str, what: &str) -> String {
    format!("{glyph} not tested: {what}")
}

#[must_use]
pub fn better_by(least: f64, most: f64) -> String {
    format!("better by {least:.3}..{most:.3}")
}

#[must_use]
pub fn worse_by(least: f64, most: f64) -> String {
    format!("worse by {least:.3}..{most:.3}")
}
