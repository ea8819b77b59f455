//! What an engine needs of its store, without the database behind it.
//!
//! Owns the traits [`OpenStore`] and [`ReadableStore`] with their views, and changes, entries, filters and errors as plain
//! data. Also owns the store's folder with its lock and its marks of stops, the check of a signed decision, and the
//! authentication of cached results. The crate `registry` implements the traits with SQLite. Must not decide, or know a
//! database.

mod approval_check;
mod change;
mod entries;
mod error;
mod layout;
mod lock_holder;
mod open_store;
mod opening;
mod result_cache;
mod stop_mark;
mod store_terms;
mod telemetry_batch;
mod verify_error;
mod verify_report;
mod views;

pub use approval_check::{ApprovalFault, verify_approval};
pub use change::{
    AUDIT_MAX, ActiveCause, ApprovalRequest, AuditBody, BLOCK_BATCHES_MAX, BODY_BYTES_MAX, BatchReceipt,
    CHANGES_MAX, Change, GAPS_MAX, NOTICE_BYTES_MAX, NewVersion, QUARANTINED_MAX, QuarantinedFile, Receipt,
    TEXT_BYTES_MAX, Transaction, command_id,
};
pub use entries::{
    ActivationEntry, AlarmEntry, ApprovalEntry, AuditFilter, EvidenceEntry, FamilyStatus, PAGE_ROWS_MAX,
    RecordTime, VersionDetail, VersionFilter, VersionHistory,
};
pub use error::{ROW_BYTES_MAX, RefusalCause, StoreError, StoreFailure};
pub use layout::{EngineLock, Layout, lock_owner, other_owner, size, utc};
pub use lock_holder::{LockHolder, holds_lock, lock_holder, lock_sharers};
pub use open_store::OpenStore;
pub use opening::{InterruptedWork, OpenReport, StartupTelemetry};
pub use result_cache::{CacheLookup, CacheSecret, ResultCache, ResultRows};
pub use stop_mark::StopMarks;
pub use store_terms::{EvidenceKind, FIRST_ADMINISTRATOR, RequestState};
pub use telemetry_batch::{BATCH_BYTES_MAX, Batch, EpisodeKey, StoredBatch};
pub use verify_error::VerifyError;
pub use verify_report::{MissingBatches, VerifyReport};
pub use views::{ReadableStore, RecordViews, TelemetryReader};
