//! The sentences that the programs print: answers of verbs, lines of reports, notes of runs, and marks of a service.
//!
//! One file for each concern. A text of an error stands with its error, and the help of the command line with its
//! arguments. Nothing here reads a store or decides.

pub mod alarms;
pub mod audit;
pub mod bench;
pub mod candidate;
pub mod cell;
pub mod cell_promise;
pub mod doctor;
pub mod engine;
pub mod health;
pub mod identity;
pub mod metrics;
pub mod profile;
pub mod recordings;
pub mod replay;
pub mod run;
pub mod skill;
pub mod status;
pub mod store;
pub mod store_check;
pub mod version;

/// Names as a list, or another word without one.
fn listed_or(names: &[String], none: &str) -> String {
    if names.is_empty() { none.to_owned() } else { names.join(", ") }
}
