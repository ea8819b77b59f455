//! Bodies of audit records as they are read back, by whoever tells what came of things.
//!
//! The forms that more than one reader needs. Reads and judges nothing.

use serde::Deserialize;

use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::record::{ActivationCause, AuditRecord};
use holdpoint_governance::words::Word;

#[derive(Deserialize)]
struct ChangeBody<T> {
    change: T,
}

/// Another version of a family acts, or none.
#[derive(Deserialize)]
pub(crate) struct ActiveSet {
    pub(crate) family: Family,
    pub(crate) active: Option<CapabilityId>,
    pub(crate) cause: CauseBody,
}

/// Why it does.
#[derive(Deserialize)]
pub(crate) struct CauseBody {
    pub(crate) cause: Word<ActivationCause>,
}

/// A batch of telemetry that was sealed.
#[derive(Deserialize)]
pub(crate) struct Sealed {
    pub(crate) batch: u64,
    pub(crate) digest: Digest,
}

/// Several of them in one record.
#[derive(Deserialize)]
pub(crate) struct SealedBlock {
    pub(crate) batches: Vec<Sealed>,
    #[serde(default)]
    pub(crate) found: bool,
}

/// The change that a record is about; `None` if it cannot be read as one.
pub(crate) fn change<T: for<'de> Deserialize<'de>>(record: &AuditRecord) -> Option<T> {
    serde_json::from_str::<ChangeBody<T>>(&record.body).ok().map(|body| body.change)
}
