//! The rows of cached results in the telemetry file.

use std::sync::{Arc, Mutex};

use crate::telemetry::telemetry_file::TelemetryFile;
use holdpoint_governance::ids::Digest;
use holdpoint_store::{ResultRows, StoreError};

/// The table of cached results, for the [`ResultCache`](holdpoint_store::ResultCache).
#[derive(Debug)]
pub(crate) struct CachedRows(pub(crate) Arc<Mutex<TelemetryFile>>);

impl ResultRows for CachedRows {
    fn row(&self, key: &Digest) -> Result<Option<(String, Vec<u8>)>, StoreError> {
        self.0.lock().map_err(|_| StoreError::Unknown)?.cell(key)
    }

    fn put_row(&self, key: &Digest, mac: &str, body: &[u8]) -> Result<(), StoreError> {
        self.0.lock().map_err(|_| StoreError::Unknown)?.put_cell(key, mac, body)
    }

    fn delete_rows(&self) -> Result<(), StoreError> {
        self.0.lock().map_err(|_| StoreError::Unknown)?.void_cells()
    }
}
