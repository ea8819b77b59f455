//! Puts an administrator's authorization of a change of profile on record.

use crate::writer::store::Store;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_governance::profile::ProfileName;
use holdpoint_store::{Change, StoreError};

/// Puts an administrator's authorization of a change of profile on record. It is valid while no other record follows
/// it.
///
/// # Errors
/// If the signer may not authorize, or not this change.
pub fn allow_profile(
    store: &Store,
    profile: ProfileName,
    (by, act): (String, SignedProfileAct),
    wall_ms: i64,
) -> Result<(), StoreError> {
    store.commit_alone("profile", Change::AllowProfile { profile, by, act: Box::new(act) }, wall_ms)
}
