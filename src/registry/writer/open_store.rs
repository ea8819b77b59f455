//! The open store of the crate `store`, written with SQLite.

use std::sync::Arc;

use ed25519_dalek::VerifyingKey;

use crate::reading::sqlite_reader::SqliteReader;
use crate::writer::store::Store;
use holdpoint_store::{
    Batch, BatchReceipt, Layout, OpenReport, OpenStore, ReadableStore, Receipt, ResultCache, StoreError,
    Transaction,
};

impl OpenStore for Store {
    fn store_id(&self) -> &str {
        Self::store_id(self)
    }

    fn public_key(&self) -> &VerifyingKey {
        Self::public_key(self)
    }

    fn layout(&self) -> &Layout {
        Self::layout(self)
    }

    fn opening(&self) -> &OpenReport {
        Self::opening(self)
    }

    fn result_cache(&self) -> &ResultCache {
        Self::result_cache(self)
    }

    fn reader(&self) -> Arc<dyn ReadableStore> {
        Arc::new(SqliteReader::new(Self::layout(self).clone()))
    }

    fn first_administrator(&self, wall_ms: i64) -> Result<Option<String>, StoreError> {
        Self::first_administrator(self, wall_ms)
    }

    fn commit(&self, transaction: Transaction) -> Result<Receipt, StoreError> {
        Self::commit(self, transaction)
    }

    fn commit_sealing(&self, transaction: Transaction) -> Result<Receipt, StoreError> {
        Self::commit_sealing(self, transaction)
    }

    fn checkpoint_problem(&self) -> Option<String> {
        Self::checkpoint_problem(self)
    }

    fn mark_problems_reported(&self) {
        Self::mark_problems_reported(self);
    }

    fn check_unaltered(&self) -> Result<(), StoreError> {
        Self::check_unaltered(self)
    }

    fn check_undisturbed(&self) -> Result<(), StoreError> {
        Self::check_undisturbed(self)
    }

    fn append_telemetry(&self, batch: &Batch) -> Result<BatchReceipt, StoreError> {
        Self::append_telemetry(self, batch)
    }

    fn telemetry_is_due(&self, now_ms: u64) -> Result<bool, StoreError> {
        Self::telemetry_is_due(self, now_ms)
    }

    fn telemetry_waits(&self) -> Option<u64> {
        Self::telemetry_waits(self)
    }
}
