//! Read access to a store's telemetry, also while an engine has it open.

use std::collections::BTreeSet;
use std::path::Path;

use rusqlite::{Connection, Row};

use crate::database::migrate::TELEMETRY;
use crate::database::open::{not_telemetry, open_reader};
use crate::telemetry::telemetry_file::{STORED_BATCH_SQL, stored_digest};
use crate::telemetry::telemetry_quarantine::wrong_shape;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_store::{Batch, StoreError, StoredBatch};

/// See the module's head.
#[derive(Debug)]
pub struct TelemetryViews {
    connection: Connection,
}

impl TelemetryViews {
    /// Opens a store's telemetry file for reading.
    ///
    /// # Errors
    /// If it cannot be opened, or is not as this program makes it.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let connection = open_reader(path, &TELEMETRY)?;
        let problem = wrong_shape(&connection, &TELEMETRY).map_err(sqlite_error("read telemetry"))?;
        problem.map_or(Ok(Self { connection }), |problem| Err(not_telemetry(path, &problem)))
    }

    /// Calls `visit` with each batch up to the number `to_batch`, in order, one at a time.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn each_batch(&self, to_batch: u64, mut visit: impl FnMut(StoredBatch)) -> Result<(), StoreError> {
        let sql = format!("{STORED_BATCH_SQL} WHERE id BETWEEN 1 AND ?1 ORDER BY id");
        let to_batch = i64::try_from(to_batch).unwrap_or(i64::MAX);
        let mut read = || {
            let mut select = self.connection.prepare_cached(&sql)?;
            let mut rows = select.query([to_batch])?;
            while let Some(row) = rows.next()? {
                visit(StoredBatch {
                    number: row.get(0)?,
                    digest: stored_digest(row)?,
                    batch: batch_of(row).ok().flatten(),
                });
            }
            Ok(())
        };
        read().map_err(sqlite_error("read telemetry"))
    }

    /// Calls `visit` with each batch of two streams from the number `first` to `last`, in order, one at a time.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn each_of_streams(
        &self,
        [one, other]: [&str; 2],
        (first, last): (u64, u64),
        mut visit: impl FnMut(StoredBatch),
    ) -> Result<(), StoreError> {
        let sql = format!("{STORED_BATCH_SQL} WHERE id BETWEEN ?1 AND ?2 AND stream IN (?3, ?4) ORDER BY id");
        let bound = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let mut read = || {
            let mut select = self.connection.prepare_cached(&sql)?;
            let mut rows = select.query(rusqlite::params![bound(first), bound(last), one, other])?;
            while let Some(row) = rows.next()? {
                visit(StoredBatch {
                    number: row.get(0)?,
                    digest: stored_digest(row)?,
                    batch: batch_of(row).ok().flatten(),
                });
            }
            Ok(())
        };
        read().map_err(sqlite_error("read telemetry"))
    }

    /// Calls `visit` with each of these numbers that has a batch.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn each_of(&self, numbers: &[u64], mut visit: impl FnMut(u64)) -> Result<(), StoreError> {
        let mut look = || {
            let mut select = self.connection.prepare_cached("SELECT 1 FROM batch WHERE id = ?1")?;
            for number in numbers {
                if select.exists([i64::try_from(*number).unwrap_or(i64::MAX)])? {
                    visit(*number);
                }
            }
            Ok(())
        };
        look().map_err(sqlite_error("read telemetry"))
    }

    /// The number of the oldest batch; `None` without one.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn oldest(&self) -> Result<Option<u64>, StoreError> {
        self.connection
            .query_row("SELECT min(id) FROM batch WHERE id > 0", [], |row| row.get(0))
            .map_err(sqlite_error("read telemetry"))
    }

    /// The numbers of all batches.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn numbers(&self) -> Result<BTreeSet<u64>, StoreError> {
        self.connection
            .prepare("SELECT id FROM batch WHERE id > 0")
            .and_then(|mut select| select.query_map([], |row| row.get(0))?.collect())
            .map_err(sqlite_error("read telemetry"))
    }
}

fn batch_of(row: &Row<'_>) -> rusqlite::Result<Option<Batch>> {
    let Ok(version) = row.get_ref(1)?.as_str()?.parse() else { return Ok(None) };
    let (from_ms, to_ms, rows) = (row.get(3)?, row.get(4)?, row.get(5)?);
    Ok(Some(Batch { version, stream: row.get(2)?, from_ms, to_ms, rows, body: row.get(6)? }))
}
