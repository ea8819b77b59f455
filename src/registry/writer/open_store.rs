//! The open store of the crate `store`, written with SQLite.

use std::sync::Arc;

use ed25519_dalek::VerifyingKey;

use crate::reading::record_views::forward;
use crate::reading::sqlite_reader::SqliteReader;
use crate::writer::store::Store;
use holdpoint_store::{
    Batch, BatchReceipt, Layout, OpenReport, OpenStore, ReadableStore, Receipt, ResultCache, StoreError,
    Transaction,
};

impl OpenStore for Store {
    forward! {
        store_id() -> &str;
        public_key() -> &VerifyingKey;
        layout() -> &Layout;
        opening() -> &OpenReport;
        result_cache() -> &ResultCache;
        first_administrator(wall_ms: i64) -> Result<Option<String>, StoreError>;
        commit(transaction: Transaction) -> Result<Receipt, StoreError>;
        commit_sealing(transaction: Transaction) -> Result<Receipt, StoreError>;
        checkpoint_problem() -> Option<String>;
        check_unaltered() -> Result<(), StoreError>;
        check_undisturbed() -> Result<(), StoreError>;
        append_telemetry(batch: &Batch) -> Result<BatchReceipt, StoreError>;
        telemetry_is_due(now_ms: u64) -> Result<bool, StoreError>;
        telemetry_waits() -> Option<u64>;
    }

    fn reader(&self) -> Arc<dyn ReadableStore> {
        Arc::new(SqliteReader::new(Self::layout(self).clone()))
    }

    fn mark_problems_reported(&self) {
        Self::mark_problems_reported(self);
    }
}
