//! The store of a running engine: its one writer.

use std::fmt::Debug;
use std::sync::Arc;

use ed25519_dalek::VerifyingKey;

use crate::change::{BatchReceipt, Receipt, Transaction};
use crate::error::StoreError;
use crate::layout::Layout;
use crate::opening::OpenReport;
use crate::result_cache::ResultCache;
use crate::telemetry_batch::Batch;
use crate::views::{ReadableStore, RecordViews, TelemetryReader};
use holdpoint_approvals::PersonDirectory;

/// An open store. It belongs to this process until it is dropped.
///
/// An implementation applies the transactions of all callers one at a time, each whole or not at all. It checks each change
/// against the present rows. Once another program changed them, it admits no version.
pub trait OpenStore: Debug + Send + Sync {
    /// The store's id; approvals are bound to it.
    fn store_id(&self) -> &str;

    /// The key that verifies the store's checkpoints.
    fn public_key(&self) -> &VerifyingKey;

    /// The store's folder on this machine.
    fn layout(&self) -> &Layout;

    /// The state of the store when it was opened.
    fn opening(&self) -> &OpenReport;

    fn result_cache(&self) -> &ResultCache;

    /// Read access for other threads.
    fn reader(&self) -> Arc<dyn ReadableStore>;

    /// A read-only view of everything that is on record, also of transactions that follow.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn views(&self) -> Result<Box<dyn RecordViews>, StoreError> {
        self.reader().views()
    }

    /// A read-only view of the telemetry; `None` if there is none.
    ///
    /// # Errors
    /// If it cannot be read.
    fn telemetry_reader(&self) -> Result<Option<Box<dyn TelemetryReader>>, StoreError> {
        self.reader().telemetry()
    }

    /// All persons of the store.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn persons(&self) -> Result<PersonDirectory, StoreError> {
        self.views()?.persons()
    }

    /// Makes the store's first administrator if no one is enrolled, and returns the name.
    ///
    /// # Errors
    /// If the key or the record cannot be written; the next try takes a key that was written.
    fn first_administrator(&self, wall_ms: i64) -> Result<Option<String>, StoreError>;

    /// Applies a transaction, whole or not at all, and returns once it is on disk. Blocks the calling thread.
    ///
    /// # Errors
    /// [`StoreError`]; nothing was changed, unless it is [`StoreError::Unknown`]: then send the same command again.
    fn commit(&self, transaction: Transaction) -> Result<Receipt, StoreError>;

    /// As [`Self::commit`], after sealing all pending telemetry, so that a record rests on sealed data only. If
    /// telemetry cannot be flushed, only changes that remove authority are written, without seals.
    ///
    /// # Errors
    /// As [`Self::commit`].
    fn commit_sealing(&self, transaction: Transaction) -> Result<Receipt, StoreError>;

    /// Why the last checkpoint could not be written here or at a witness, if so. The records themselves are on disk.
    fn checkpoint_problem(&self) -> Option<String>;

    /// [`Self::checkpoint_problem`] is on record: witnesses that the start found silent get heads again.
    fn mark_problems_reported(&self);

    /// A foreign change of this engine's database, if a write found one: its content must no longer decide anything.
    ///
    /// # Errors
    /// [`StoreError::Altered`].
    fn check_unaltered(&self) -> Result<(), StoreError>;

    /// No other program wrote since the opening, even with a later undo.
    ///
    /// # Errors
    /// [`StoreError::Disturbed`].
    fn check_undisturbed(&self) -> Result<(), StoreError>;

    /// Stores a batch of telemetry. A power cut may lose it until a transaction seals it.
    ///
    /// # Errors
    /// If the batch is empty, too large, or cannot be written.
    fn append_telemetry(&self, batch: &Batch) -> Result<BatchReceipt, StoreError>;

    /// Whether telemetry must be sealed now, by age or amount, although nothing else is written.
    ///
    /// # Errors
    /// If another thread failed with it.
    fn telemetry_is_due(&self, now_ms: u64) -> Result<bool, StoreError>;

    /// The latest virtual time of unsealed telemetry, ms; `None` if all is sealed.
    fn telemetry_waits(&self) -> Option<u64>;
}
