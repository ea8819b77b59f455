//! The losses of a rebuild: the marks in their place, and the texts that the damaged store still has.

use rusqlite::{Connection, OptionalExtension};
use serde::Deserialize;
use serde_json::json;

use crate::chain::compare::LOST;
use holdpoint_audit::rebuild_report::RebuildRecordChange;
use holdpoint_governance::record::AuditRecord;
use holdpoint_store::StoreError;

/// A mark in place of a lost text.
pub(crate) fn lost_mark(what: &str) -> String {
    format!("{LOST}{}}}", json!(what))
}

/// The rows that an earlier rebuild marked as lost.
pub(crate) fn rows_lost(record: &AuditRecord) -> Result<Vec<(String, String)>, StoreError> {
    #[derive(Deserialize)]
    struct RebuildRecordBody {
        change: RebuildRecordChange,
    }
    let body: RebuildRecordBody = serde_json::from_str(&record.body)
        .map_err(|error| StoreError::invalid("audit record", record.seq, error))?;
    Ok(body.change.rebuilt.lost)
}

/// A text of a row of the damaged store, `None` if it cannot be read.
pub(crate) fn text_of(damaged_store: &Connection, sql: &str, key: &str) -> Option<String> {
    let read = damaged_store
        .prepare_cached(sql)
        .and_then(|mut select| select.query_row([key], |row| row.get::<_, Option<String>>(0)).optional());
    read.ok().flatten().flatten()
}
