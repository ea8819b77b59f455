//! The verification of a signed decision, the same for every store.

use holdpoint_approvals::{PersonDirectory, PersonState, SignedApproval};

/// The one verification of a signed decision: its signer is enrolled, in this role, and signed exactly this. It runs in the
/// transaction that stores the decision, in the one that uses it, and when a restart restores it from its row.
///
/// # Errors
/// The problem.
pub fn verify_approval(signed: &SignedApproval, persons: &PersonDirectory) -> Result<(), String> {
    let name = &signed.approval().who;
    let person = persons.named(name).filter(|person| person.state == PersonState::Enrolled);
    let person = person.ok_or_else(|| format!("{name:?} is not enrolled in this store"))?;
    signed.verify(&person.info()).map_err(|error| error.to_string())
}
