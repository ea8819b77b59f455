//! What the verification of a whole store found.

use holdpoint_governance::ids::Digest;
use serde::Serialize;

/// The sound content of a store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct VerifyReport {
    pub store_id: String,
    pub records: u64,
    /// Hash of the last one.
    pub head: Digest,
    /// Root of the tree over all records (RFC 9162).
    pub root: Digest,
    /// Checkpoints whose signature and record match.
    pub checkpoints: u64,
    /// Heads kept elsewhere that are of this chain: named ones, and those of its witnesses.
    pub copies: u64,
    /// Unreadable witnesses, and files of theirs that are not heads, each with the reason.
    pub witnesses_silent: Vec<String>,
    /// Whether a public key was given; without one, signatures of checkpoints were not checked.
    pub key_given: bool,
    /// Approvals whose signature matches.
    pub approvals: u64,
    /// Persons, enrolled and revoked, whose acts are signed by an administrator of their time.
    pub persons: u64,
    /// First and last of the unsigned records that a rebuild took: no signature covers those.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub taken_unsigned: Vec<(u64, u64)>,
    /// Those of them whom a verified administrator verified with a passphrase-protected key, the first administrator
    /// included.
    pub confirmed: u64,
    /// Sealed batches of telemetry that match.
    pub batches: u64,
    /// Sealed batches that were removed for age.
    pub batches_pruned: u64,
    /// Sealed batches that are missing, which is on record.
    pub batches_missed: u64,
    /// Sealed batches that could not be checked: the database was copied without its telemetry file.
    pub batches_unseen: u64,
    /// The missing ones among all these.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batches_missing: Option<MissingBatches>,
}

/// Missing sealed batches of telemetry: without a gap the oldest ones, or all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MissingBatches {
    pub first: u64,
    pub last: u64,
    pub first_sealed_by: u64,
    pub last_sealed_by: u64,
}

impl MissingBatches {
    /// With one more, which was sealed later.
    #[must_use]
    pub fn with(before: Option<Self>, (batch, seq): (u64, u64)) -> Self {
        let before =
            before.unwrap_or(Self { first: batch, last: batch, first_sealed_by: seq, last_sealed_by: seq });
        Self { last: batch, last_sealed_by: seq, ..before }
    }
}
