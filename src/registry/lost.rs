//! What a rebuild could not have again: the marks in its place, and the record that names it.

use rusqlite::{Connection, OptionalExtension};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::compare::LOST;
use super::error::StoreError;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::AuditRecord;

/// A row that was not what the chain says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DifferingRow {
    pub table: String,
    pub key: String,
    /// What was wrong with it.
    pub problem: String,
    /// The columns that the rebuilt row has otherwise; empty where it was missing, or is gone.
    pub columns: Vec<String>,
}

/// What a rebuild did; the body of its record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rebuilt {
    /// The last record of the chain it was made from.
    pub from_seq: u64,
    pub from_hash: Digest,
    /// What was found wrong first.
    pub problem: String,
    pub differed: Vec<DifferingRow>,
    /// Rows of which a text could not be had again: table and key.
    pub lost: Vec<(String, String)>,
    /// Name of the damaged file, beside the store.
    pub kept_as: String,
    /// Records at the end that nobody had signed: no checkpoint that is there speaks for them.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unsigned: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The rebuild and who asked for it, as its record has them.
#[derive(Serialize, Deserialize)]
pub(crate) struct RebuiltChange {
    pub(super) change: String,
    pub(super) by: Value,
    #[serde(flatten)]
    pub(crate) rebuilt: Rebuilt,
}

/// A mark that stands for a text that was lost.
pub(super) fn lost_mark(what: &str) -> String {
    format!("{LOST}{}}}", json!(what))
}

/// The rows that an earlier rebuild marked as lost.
pub(super) fn rows_lost(record: &AuditRecord) -> Result<Vec<(String, String)>, StoreError> {
    #[derive(Deserialize)]
    struct RebuiltBody {
        change: RebuiltChange,
    }
    let body: RebuiltBody = serde_json::from_str(&record.body)
        .map_err(|error| StoreError::invalid("audit record", record.seq, error))?;
    Ok(body.change.rebuilt.lost)
}

/// A text of a row of the damaged store, `None` if it has none that can be read.
pub(super) fn text_of(damaged_store: &Connection, sql: &str, key: &str) -> Option<String> {
    let read = damaged_store
        .prepare_cached(sql)
        .and_then(|mut select| select.query_row([key], |row| row.get::<_, Option<String>>(0)).optional());
    read.ok().flatten().flatten()
}
