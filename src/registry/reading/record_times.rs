//! When records were written, without their content: for drawing a long record over time.

use rusqlite::{OptionalExtension as _, params};

use crate::reading::views::Views;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{RecordTime, StoreError};

/// The most record numbers per query.
const NUMBERS_MAX: i64 = 4_000_000;

impl Views {
    /// The stamp of a record; `None` if there is none of that number.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn stamp(&self, seq: u64) -> Result<Option<RecordTime>, StoreError> {
        let sql = "SELECT at_ms, wall_ms FROM audit WHERE seq = ?1";
        let seq_there = i64::try_from(seq).unwrap_or(i64::MAX);
        self.connection
            .prepare_cached(sql)
            .and_then(|mut select| {
                let read = |row: &rusqlite::Row<'_>| {
                    let wall_ms: i64 = row.get(1)?;
                    Ok(RecordTime { seq, at_ms: row.get(0)?, wall_ms: (wall_ms > 0).then_some(wall_ms) })
                };
                select.query_row([seq_there], read).optional()
            })
            .map_err(sqlite_error("read when records were written"))
    }

    /// Numbers of the records of a kind, of those from `from_seq` on and before `before_seq`, in order.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn numbers_of(
        &self,
        kind: RecordKind,
        from_seq: u64,
        before_seq: u64,
    ) -> Result<Vec<u64>, StoreError> {
        let bound = |seq: u64| i64::try_from(seq).unwrap_or(i64::MAX);
        let sql = "SELECT seq FROM audit WHERE kind = ?1 AND seq >= ?2 AND seq < ?3 ORDER BY seq LIMIT ?4";
        self.connection
            .prepare_cached(sql)
            .and_then(|mut select| {
                let parameters = params![kind.name(), bound(from_seq), bound(before_seq), NUMBERS_MAX];
                select.query_map(parameters, |row| row.get(0))?.collect()
            })
            .map_err(sqlite_error("read which records there are"))
    }
}
