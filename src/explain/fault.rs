//! Faults of an answer.

use holdpoint_record::version_table::VersionTableError;
use holdpoint_store::StoreError;

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum ExplainFault {
    /// A version cannot be read.
    #[error(transparent)]
    VersionTable(#[from] VersionTableError),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A record has no canonical form.
    #[error("a record has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
}
