//! The texts of the view of the audit log. The sentences of its records are in [`record`](super::record).

use crate::counted;

pub const TOUR: &str = "Each record has the hash of the one before; v checks them";
pub const NO_RECORD_READ: &str = "No record has been read yet";
pub const NO_RECORD_OF_THIS_KIND: &str = "There is no record of this kind";
pub const NO_RECORD_OF_THIS_KIND_READ: &str = "No record of this kind among those that were read";
pub const NO_RECORD_FITS: &str = "No record fits the filter";
/// The heading of the sentences of the records.
pub const SENTENCE_COLUMN: &str = "what it says";
pub const CHECKS_IT: &str = " checks it";

#[must_use]
pub fn raw_cut(lines: usize) -> String {
    format!("… cut after {}; `holdpoint audit export` has all of it", counted(lines, "line"))
}

#[must_use]
pub fn run_of_telemetry(count: usize, newest: &str) -> String {
    format!("{} of sealed telemetry, the newest: {newest}", counted(count, "record"))
}

#[must_use]
pub fn raw_place(line: usize, lines: usize, key: &str) -> String {
    format!("line {line} of {lines}, {key} closes")
}

#[must_use]
pub fn raw_title(seq: u64) -> String {
    format!("Record {seq} as it was written")
}

#[must_use]
pub fn observed(activations: u64, unsafe_activations: u64, tasks: u64, violations: u64) -> String {
    format!(
        "since this engine began: {activations} let in, {unsafe_activations} unsafe; in upgrades {}, {}",
        counted(tasks, "task"),
        counted(violations, "violation")
    )
}

#[must_use]
pub fn rolled_back_safely(recovered: u64, rollbacks: u64) -> String {
    format!("; {recovered} of {rollbacks} rolled back safely")
}

#[must_use]
pub fn chain_not_checked(glyph: &str) -> String {
    format!("{glyph} chain not checked yet: ")
}

#[must_use]
pub fn chain_holds(glyph: &str, records: u64, finding: &str) -> String {
    format!("{glyph} chain holds, {} checked: {finding}", counted(records, "record"))
}

#[must_use]
pub fn chain_broken(glyph: &str, records: u64, finding: &str) -> String {
    format!("{glyph} CHAIN BROKEN after {}: {finding}", counted(records, "record"))
}

#[must_use]
pub fn hash_and_key(hash: &str, key: &str) -> String {
    format!("hash {hash}, {key} shows it raw")
}
