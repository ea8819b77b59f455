//! Puts an administrator's authorization of a change of profile on record.

use crate::writer::store::Store;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_governance::profile::ProfileName;
use holdpoint_store::{Change, StoreError, Transaction, command_id};

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
    let head = store.views()?.head()?;
    store
        .commit(Transaction {
            command_id: command_id("profile")?,
            at_ms: head.at_ms,
            wall_ms,
            changes: vec![Change::AllowProfile { profile, by, act: Box::new(act) }],
            audit: Vec::new(),
        })
        .map(drop)
}
