//! Approvers and their signed decisions.
//!
//! Owns identities (ed25519 keys with a role in the store's `keys/identities`, with or without a passphrase), the acts that
//! enroll them as persons of a store, and the approval object: its content, bytes and signature. Must not decide on quorum
//! and roles: that is governance. Must not remember used approvals: the store does, in the transaction of the state change.

mod admin_authorization;
pub mod agent;
mod authorship;
mod display_binding;
mod encrypted_key;
mod identity;
pub mod keyfile;
mod passphrase;
mod person;
mod profile_act;
mod signed_approval;
mod signed_call;
mod witness_act;

pub use authorship::SignedAuthorship;
pub use display_binding::{DisplayBinding, SignedFacts, SignerName, facts_digest, lines_digest};
pub use encrypted_key::{EncryptedKey, EncryptedKeyError, KdfCost};
pub use identity::{Identity, IdentityError, IdentityFolder, IdentityInfo, LockedIdentity};
pub use passphrase::{
    PASSPHRASE_BYTES_MAX, PASSPHRASE_CHARS_MIN, Passphrase, PassphraseCause, PassphraseError,
};
pub use person::{
    PERSONS_MAX, Person, PersonAct, PersonActKind, PersonDirectory, PersonError, PersonState, SignedPersonAct,
};
pub use profile_act::{ProfileAct, RulesChange, SignedProfileAct};
pub use signed_approval::{Approval, ApprovalError, Nonce, SignedApproval};
pub use signed_call::{CallClaim, CallError, SignedCall};
pub use witness_act::{SignedWitnessAct, WitnessAct};
