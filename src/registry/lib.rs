//! The registry: what versions there are, in which state, on what evidence, and the audit chain of how it came so.
//!
//! Owns the store's folder and files, the one connection that writes, the audit chain with its checkpoints and
//! verifier, the views, the telemetry file and the kept cells. Must not decide anything: it takes whole transactions of plain
//! changes, refuses those that would break an invariant, and keeps bodies (manifests, evidence, decisions) as the
//! bytes it was given. The dispatcher gets the [`ActiveVersions`] and nothing else.

mod activate;
mod administrator;
mod apply;
mod appointment;
mod approve;
mod aside;
mod audit;
mod backup;
mod change;
mod check;
mod checkpoint;
mod columns;
mod compare;
mod copies;
mod entries;
mod error;
mod export_body;
mod export_judge;
mod export_line;
mod exported;
pub mod failpoint;
mod fold;
mod holder;
mod info;
mod invariants;
mod kept;
mod key_files;
mod layout;
mod listed;
mod loosened;
mod lost;
mod merkle;
mod migrate;
pub mod names;
mod open;
mod people;
mod proof;
mod rebuild;
mod recovery;
mod replay;
mod row_limit;
mod rows;
mod sealing;
mod seals;
mod shape;
mod shown;
mod signed;
mod snapshot;
mod stamps;
mod stop_mark;
mod store;
mod store_id;
mod structure;
mod taken;
mod telemetry;
mod telemetry_views;
mod unsound;
mod verify;
mod version;
mod views;
mod witness;
mod words;

pub use administrator::FIRST_ADMINISTRATOR;
pub use appointment::{WitnessedBy, add_witness, remove_witness, witnesses_are_signed};
pub use audit::{ExportError, Head};
pub use backup::{BackupError, BackupParts, BackupReport, LeftOut, RecordingOnRecord, RecordingsOf, backup};
pub use change::{
    AUDIT_MAX, ActiveCause, ApprovalRequest, AuditBody, BODY_BYTES_MAX, BatchReceipt, CHANGES_MAX, Change,
    NewVersion, Receipt, SetAside, TEXT_BYTES_MAX, Transaction, command_id,
};
pub use checkpoint::{Checkpoint, Link};
pub use entries::{
    ActivationEntry, AlarmEntry, ApprovalEntry, AuditFilter, Course, EvidenceEntry, FamilyStatus,
    VersionDetail, VersionFilter,
};
pub use error::StoreError;
pub use exported::{ExportReport, Exporting, export_store, is_exported, verify_export};
pub use holder::{LockHolder, lock_holder, lock_sharers};
pub use info::{Looked, StoreInfo, check_store, store_info};
pub use invariants::{Invariant, Violation, check_invariants};
pub use kept::{Found, KeptCells, KeptSecret};
pub use layout::{Layout, lock_owner, size, utc};
pub use loosened::{ContextRules, ProfileCourse, allow_profile};
pub use lost::{DifferingRow, Rebuilt};
pub use proof::{Proof, ProofError, ProvedRecord, kept_head, prove_consistency, prove_record};
pub use rebuild::{UnsignedRecords, rebuild};
pub use recovery::Interrupted;
pub use seals::FoundTelemetry;
pub use stamps::Stamp;
pub use stop_mark::StopMarks;
pub use store::{Opening, Store};
pub use taken::UnreadStore;
pub use telemetry::{Batch, EpisodeKey, TelemetryLimits};
pub use telemetry_views::{LyingBatch, TelemetryViews};
pub use unsound::VerifyError;
pub use verify::{JudgedBy, MissingBatches, Place, VerifyReport, verify, verify_against, verify_copy};
pub use views::{ActiveVersion, ActiveVersions, PAGE_ROWS_MAX, Views};
pub use witness::{WITNESSES_MAX, look_at_witness, witnesses};
