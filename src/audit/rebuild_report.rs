//! What a rebuild of a store's tables from its chain changed, as its record holds it.

use holdpoint_governance::ids::Digest;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A row that did not match the chain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DifferingRow {
    pub table: String,
    pub key: String,
    pub problem: String,
    /// The changed columns of the rebuilt row; empty if the row was missing or is gone.
    pub columns: Vec<String>,
}

/// The summary of a rebuild; the body of its record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RebuildReport {
    /// The last record of the chain it was made from.
    pub from_seq: u64,
    pub from_hash: Digest,
    pub problem: String,
    pub differed: Vec<DifferingRow>,
    /// Rows with a lost text: table and key.
    pub lost: Vec<(String, String)>,
    /// Name of the damaged file, beside the store.
    pub kept_as: String,
    /// Unsigned records at the end: no existing checkpoint covers them.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unsigned: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The rebuild and its requesting user, in its record's form.
#[derive(Debug, Serialize, Deserialize)]
pub struct RebuildRecordChange {
    /// `store-rebuilt`.
    pub change: String,
    /// The requesting system user.
    pub by: Value,
    #[serde(flatten)]
    pub rebuilt: RebuildReport,
}
