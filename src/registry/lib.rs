//! The registry: the versions, their states, their evidence, and the audit chain of their history.
//!
//! Owns the store's folder and files, the one writing connection, the tables with the audit chain and their verifier, the
//! views, the telemetry file and the cached results. The forms of the chain and their proofs are the crate `audit`'s. Must
//! not decide anything: it applies whole transactions of plain changes, refuses those that would break an invariant, and
//! stores bodies (manifests, evidence, decisions) as given. The dispatcher gets the [`ActiveVersions`] and nothing else.
//!
//! A room uses only rooms above it: terms, place, database, chain, telemetry, transaction, verification, reading, writer,
//! upkeep.

mod chain;
mod database;
pub mod failpoint;
mod place;
mod reading;
mod telemetry;
mod terms;
mod transaction;
mod upkeep;
mod verification;
mod writer;

pub use chain::audit::ExportError;
pub use chain::invariants::{Invariant, Violation, check_invariants};
pub use chain::telemetry_seals::StartupTelemetry;
pub use place::layout::{Layout, lock_owner, other_owner, size, utc};
pub use place::lock_holder::{LockHolder, holds_lock, lock_holder, lock_sharers};
pub use place::stop_mark::StopMarks;
pub use reading::entries::{
    ActivationEntry, AlarmEntry, ApprovalEntry, AuditFilter, EvidenceEntry, FamilyStatus, VersionDetail,
    VersionFilter, VersionHistory,
};
pub use reading::export_store::{ExportScope, export_store};
pub use reading::interrupted_work::InterruptedWork;
pub use reading::prove::{ProveError, prove_consistency, prove_record, stored_head};
pub use reading::record_times::RecordTime;
pub use reading::views::{ActiveVersion, ActiveVersions, PAGE_ROWS_MAX, Views};
pub use reading::witness_views::witnesses;
pub use telemetry::result_cache::{CacheLookup, CacheSecret, ResultCache};
pub use telemetry::telemetry_file::{Batch, EpisodeKey, TelemetryLimits};
pub use telemetry::telemetry_views::{StoredBatch, TelemetryViews};
pub use terms::change::{
    AUDIT_MAX, ActiveCause, ApprovalRequest, AuditBody, BODY_BYTES_MAX, BatchReceipt, CHANGES_MAX, Change,
    NewVersion, QuarantinedFile, Receipt, TEXT_BYTES_MAX, Transaction, command_id,
};
pub use terms::error::{RefusalCause, StoreError, StoreFailure};
pub use terms::store_terms;
pub use terms::store_terms::FIRST_ADMINISTRATOR;
pub use transaction::approve::verify_approval;
pub use transaction::witness_acts::witnesses_are_signed;
pub use upkeep::backup::{
    BackupError, BackupParts, BackupReport, ListRecordings, OmittedFile, RetainedRecording, backup,
};
pub use upkeep::info::{StoreCheck, StoreInfo, check_store, store_info};
pub use upkeep::rebuild::{UnsignedRecords, rebuild};
pub use verification::verify::{
    DatabaseLocation, MissingBatches, VerifyOptions, VerifyReport, verify, verify_against, verify_copy,
};
pub use verification::verify_error::VerifyError;
pub use writer::profile_authorization::allow_profile;
pub use writer::store::{OpenReport, Store};
pub use writer::unverified_store::UnverifiedStore;
pub use writer::witness_appointment::{WitnessRequester, add_witness, remove_witness};
