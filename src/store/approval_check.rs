//! The verification of a signed decision, the same for every store.

use holdpoint_approvals::{ApprovalError, PersonDirectory, PersonState, SignedApproval};

/// Why an approval cannot be stored or used.
#[derive(Debug, thiserror::Error)]
pub enum ApprovalFault {
    #[error("it was made for the store {0:?}")]
    OtherStore(String),
    #[error("it was made for a store with another key")]
    OtherStoreKey,
    #[error("it is signed over nothing that was shown")]
    NothingShown,
    #[error("its nonce was seen before")]
    Repeated,
    #[error("it was used already")]
    Used,
    #[error("it is a refusal")]
    Refusal,
    #[error("it has expired")]
    Expired,
    #[error("the version has changed since")]
    VersionChanged,
    #[error("it is for another candidate")]
    OtherCandidate,
    #[error("the evidence has changed since")]
    EvidenceChanged,
    #[error("profile or policy have changed since")]
    RulesChanged,
    #[error("it was voided by a change of the family's active version, profile, policy or thresholds")]
    Voided,
    #[error("{0:?} is not enrolled in this store")]
    NotEnrolled(String),
    #[error(transparent)]
    Signature(#[from] ApprovalError),
    /// What is stored of it cannot be read.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

/// The one verification of a signed decision: its signer is enrolled, in this role, and signed exactly this. It runs in the
/// transaction that stores the decision, in the one that uses it, and when a restart restores it from its row.
///
/// # Errors
/// [`ApprovalFault::NotEnrolled`] and [`ApprovalFault::Signature`].
pub fn verify_approval(signed: &SignedApproval, persons: &PersonDirectory) -> Result<(), ApprovalFault> {
    let name = &signed.approval().who;
    let person = persons.named(name).filter(|person| person.state == PersonState::Enrolled);
    let person = person.ok_or_else(|| ApprovalFault::NotEnrolled(name.clone()))?;
    signed.verify(&person.info()).map_err(ApprovalFault::from)
}
