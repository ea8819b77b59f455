//! The registry: the store of the versions, their states, their evidence, and the audit chain of their history, with SQLite.
//!
//! Owns the one writing connection, the tables with the audit chain and their verifier, the views, and the telemetry file.
//! Implements the traits of the crate `store`, which has the changes, entries and errors, and the store's folder. The forms
//! of the chain and their proofs are the crate `audit`'s. Must not decide anything: it applies whole transactions of plain
//! changes, refuses those that would break an invariant, and stores bodies (manifests, evidence, decisions) as given.
//!
//! A room uses only rooms above it: terms, database, chain, telemetry, transaction, verification, reading, writer, upkeep.

mod chain;
mod database;
pub mod failpoint;
mod reading;
mod telemetry;
mod terms;
mod transaction;
mod upkeep;
mod verification;
mod writer;

pub use chain::audit::ExportError;
pub use chain::invariants::{Invariant, Violation, check_invariants};
pub use reading::export_store::{ExportScope, export_store};
pub use reading::prove::{ProveError, prove_consistency, prove_record, stored_head};
pub use reading::sqlite_reader::SqliteReader;
pub use reading::views::Views;
pub use reading::witness_views::witnesses;
pub use telemetry::telemetry_file::TelemetryLimits;
pub use telemetry::telemetry_views::TelemetryViews;
pub use transaction::witness_acts::witnesses_are_signed;
pub use upkeep::backup::{
    BackupError, BackupParts, BackupReport, ListRecordings, OmittedFile, RetainedRecording, backup,
};
pub use upkeep::info::{StoreInfo, check_store, store_info};
pub use upkeep::rebuild::{UnsignedRecords, rebuild};
pub use verification::verify::{DatabaseLocation, VerifyOptions, verify, verify_against, verify_copy};
pub use writer::profile_authorization::allow_profile;
pub use writer::store::Store;
pub use writer::unverified_store::UnverifiedStore;
pub use writer::witness_appointment::{WitnessRequester, add_witness, remove_witness};
