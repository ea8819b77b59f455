//! Read access to a store's telemetry, also while an engine has it open.

use std::collections::BTreeSet;
use std::path::Path;

use rusqlite::{Connection, Params, Row, params};

use crate::database::migrate::TELEMETRY;
use crate::database::open::{open_reader, refused};
use crate::telemetry::telemetry_file::{STORED_BATCH_SQL, stored_digest};
use crate::telemetry::telemetry_quarantine::wrong_shape;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_store::{Batch, RefusalCause, StoreError, StoredBatch, TelemetryReader};

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
        match wrong_shape(&connection, &TELEMETRY).map_err(sqlite_error("read telemetry"))? {
            None => Ok(Self { connection }),
            Some(problem) => Err(refused(path, &problem, RefusalCause::Telemetry)),
        }
    }

    fn each_where(
        &self,
        condition: &str,
        parameters: impl Params,
        visit: &mut dyn FnMut(StoredBatch),
    ) -> Result<(), StoreError> {
        self.connection
            .prepare_cached(&format!("{STORED_BATCH_SQL} WHERE {condition} ORDER BY id"))
            .and_then(|mut select| {
                let mut rows = select.query(parameters)?;
                while let Some(row) = rows.next()? {
                    visit(StoredBatch {
                        number: row.get(0)?,
                        digest: stored_digest(row)?,
                        batch: batch_of(row).ok().flatten(),
                    });
                }
                Ok(())
            })
            .map_err(sqlite_error("read telemetry"))
    }
}

impl TelemetryReader for TelemetryViews {
    fn each_batch(&self, to_batch: u64, visit: &mut dyn FnMut(StoredBatch)) -> Result<(), StoreError> {
        self.each_where("id BETWEEN 1 AND ?1", [bound(to_batch)], visit)
    }

    fn each_of_streams(
        &self,
        [one, other]: [&str; 2],
        (first, last): (u64, u64),
        visit: &mut dyn FnMut(StoredBatch),
    ) -> Result<(), StoreError> {
        let parameters = params![bound(first), bound(last), one, other];
        self.each_where("id BETWEEN ?1 AND ?2 AND stream IN (?3, ?4)", parameters, visit)
    }

    fn each_of(&self, numbers: &[u64], visit: &mut dyn FnMut(u64)) -> Result<(), StoreError> {
        let mut look = || {
            let mut select = self.connection.prepare_cached("SELECT 1 FROM batch WHERE id = ?1")?;
            for number in numbers {
                if select.exists([bound(*number)])? {
                    visit(*number);
                }
            }
            Ok(())
        };
        look().map_err(sqlite_error("read telemetry"))
    }

    fn oldest(&self) -> Result<Option<u64>, StoreError> {
        self.connection
            .query_row("SELECT min(id) FROM batch WHERE id > 0", [], |row| row.get(0))
            .map_err(sqlite_error("read telemetry"))
    }

    fn numbers(&self) -> Result<BTreeSet<u64>, StoreError> {
        self.connection
            .prepare("SELECT id FROM batch WHERE id > 0")
            .and_then(|mut select| select.query_map([], |row| row.get(0))?.collect())
            .map_err(sqlite_error("read telemetry"))
    }
}

fn bound(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

fn batch_of(row: &Row<'_>) -> rusqlite::Result<Option<Batch>> {
    let Ok(version) = row.get_ref(1)?.as_str()?.parse() else { return Ok(None) };
    let (from_ms, to_ms, rows) = (row.get(3)?, row.get(4)?, row.get(5)?);
    Ok(Some(Batch { version, stream: row.get(2)?, from_ms, to_ms, rows, body: row.get(6)? }))
}
