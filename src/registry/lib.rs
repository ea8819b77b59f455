//! The registry: the versions, their states, their evidence, and the audit chain of their history.
//!
//! Owns the store's folder and files, the one writing connection, the tables with the audit chain and their verifier, the
//! views, the telemetry file and the cached results. The forms of the chain and their proofs are the crate `audit`'s. Must not decide anything: it applies whole transactions of
//! plain changes, refuses those that would break an invariant, and stores bodies (manifests, evidence, decisions) as
//! given. The dispatcher gets the [`ActiveVersions`] and nothing else.

mod activate;
mod administrator;
mod apply;
mod approve;
mod audit;
mod audit_query;
mod authorizations;
mod backup;
mod chain_signature;
mod change;
mod check;
mod columns;
mod compare;
mod entries;
mod error;
mod export_store;
pub mod failpoint;
mod fold;
mod info;
mod interrupted_work;
mod invariants;
mod key_files;
mod layout;
mod lock_holder;
mod migrate;
mod open;
mod person_rows;
mod profile_downgrade;
mod prove;
mod rebuild;
mod rebuild_losses;
mod record_times;
mod replay;
mod result_cache;
mod row_images;
mod row_limit;
mod schema_shape;
mod snapshot;
mod stop_mark;
mod store;
mod store_id;
pub mod store_terms;
mod structure;
mod telemetry;
mod telemetry_quarantine;
mod telemetry_sealing;
mod telemetry_seals;
mod telemetry_views;
mod unverified_store;
mod verify;
mod verify_error;
mod version;
mod views;
mod witness_appointment;

pub use administrator::FIRST_ADMINISTRATOR;
pub use approve::verify_approval;
pub use audit::ExportError;
pub use backup::{
    BackupError, BackupParts, BackupReport, ListRecordings, OmittedFile, RetainedRecording, backup,
};
pub use change::{
    AUDIT_MAX, ActiveCause, ApprovalRequest, AuditBody, BODY_BYTES_MAX, BatchReceipt, CHANGES_MAX, Change,
    NewVersion, QuarantinedFile, Receipt, TEXT_BYTES_MAX, Transaction, command_id,
};
pub use entries::{
    ActivationEntry, AlarmEntry, ApprovalEntry, AuditFilter, EvidenceEntry, FamilyStatus, VersionDetail,
    VersionFilter, VersionHistory,
};
pub use error::{RefusalCause, StoreError, StoreFailure};
pub use export_store::{ExportScope, export_store};
pub use info::{StoreCheck, StoreInfo, check_store, store_info};
pub use interrupted_work::InterruptedWork;
pub use invariants::{Invariant, Violation, check_invariants};
pub use layout::{Layout, lock_owner, other_owner, size, utc};
pub use lock_holder::{LockHolder, holds_lock, lock_holder, lock_sharers};
pub use profile_downgrade::allow_profile;
pub use prove::{ProveError, prove_consistency, prove_record, stored_head};
pub use rebuild::{UnsignedRecords, rebuild};
pub use record_times::RecordTime;
pub use result_cache::{CacheLookup, CacheSecret, ResultCache};
pub use stop_mark::StopMarks;
pub use store::{OpenReport, Store};
pub use telemetry::{Batch, EpisodeKey, TelemetryLimits};
pub use telemetry_seals::StartupTelemetry;
pub use telemetry_views::{StoredBatch, TelemetryViews};
pub use unverified_store::UnverifiedStore;
pub use verify::{
    DatabaseLocation, MissingBatches, VerifyOptions, VerifyReport, verify, verify_against, verify_copy,
};
pub use verify_error::VerifyError;
pub use views::{ActiveVersion, ActiveVersions, PAGE_ROWS_MAX, Views};
pub use witness_appointment::{
    WitnessRequester, add_witness, remove_witness, witnesses, witnesses_are_signed,
};
