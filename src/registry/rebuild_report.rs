//! The losses of a rebuild: the marks in their place, and the record that names them.

use rusqlite::{Connection, OptionalExtension};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::compare::LOST;
use super::error::StoreError;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::AuditRecord;

/// A row that did not match the chain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DifferingRow {
    pub table: String,
    pub key: String,
    /// The problem.
    pub problem: String,
    /// The changed columns of the rebuilt row; empty if the row was missing or is gone.
    pub columns: Vec<String>,
}

/// The summary of a rebuild; the body of its record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RebuildReport {
    /// The last record of the chain it was made from.
    pub from_seq: u64,
    pub from_hash: Digest,
    /// The first problem.
    pub problem: String,
    pub differed: Vec<DifferingRow>,
    /// Rows with a lost text: table and key.
    pub lost: Vec<(String, String)>,
    /// Name of the damaged file, beside the store.
    pub kept_as: String,
    /// Unsigned records at the end: no existing checkpoint covers them.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unsigned: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The rebuild and its requesting user, in its record's form.
#[derive(Serialize, Deserialize)]
pub(crate) struct RebuildRecordChange {
    pub(super) change: String,
    pub(super) by: Value,
    #[serde(flatten)]
    pub(crate) rebuilt: RebuildReport,
}

/// A mark in place of a lost text.
pub(super) fn lost_mark(what: &str) -> String {
    format!("{LOST}{}}}", json!(what))
}

/// The rows that an earlier rebuild marked as lost.
pub(super) fn rows_lost(record: &AuditRecord) -> Result<Vec<(String, String)>, StoreError> {
    #[derive(Deserialize)]
    struct RebuildRecordBody {
        change: RebuildRecordChange,
    }
    let body: RebuildRecordBody = serde_json::from_str(&record.body)
        .map_err(|error| StoreError::invalid("audit record", record.seq, error))?;
    Ok(body.change.rebuilt.lost)
}

/// A text of a row of the damaged store, `None` if it cannot be read.
pub(super) fn text_of(damaged_store: &Connection, sql: &str, key: &str) -> Option<String> {
    let read = damaged_store
        .prepare_cached(sql)
        .and_then(|mut select| select.query_row([key], |row| row.get::<_, Option<String>>(0)).optional());
    read.ok().flatten().flatten()
}
