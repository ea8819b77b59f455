//! Bodies of audit records that more than one reader needs. Reads and judges nothing.

use serde::Deserialize;

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::record::{ActivationCause, AuditRecord};

#[derive(Deserialize)]
struct AuditChangeBody<T> {
    change: T,
}

/// The change of a family's active version.
#[derive(Deserialize)]
pub(crate) struct ActiveSet {
    pub(crate) family: Family,
    pub(crate) active: Option<CapabilityId>,
    pub(crate) cause: CauseBody,
}

/// The cause of the change.
#[derive(Deserialize)]
pub(crate) struct CauseBody {
    pub(crate) cause: Lenient<ActivationCause>,
}

/// A sealed batch of telemetry.
#[derive(Deserialize)]
pub(crate) struct SealedBatchBody {
    pub(crate) batch: u64,
    pub(crate) digest: Digest,
}

/// Several of them in one record.
#[derive(Deserialize)]
pub(crate) struct SealedBlockBody {
    pub(crate) batches: Vec<SealedBatchBody>,
    #[serde(default)]
    pub(crate) found: bool,
}

/// The change in a record; `None` if it cannot be read.
pub(crate) fn change<T: for<'de> Deserialize<'de>>(record: &AuditRecord) -> Option<T> {
    serde_json::from_str::<AuditChangeBody<T>>(&record.body).ok().map(|body| body.change)
}
