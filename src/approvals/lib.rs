//! People who may decide, and their signed decisions.
//!
//! Owns identities (ed25519 keys with a role, kept in the store's `keys/identities`, under a passphrase or not), the acts
//! by which they become persons of a store, and the approval object: what it binds, its bytes, its signature. Must not decide how many approvals are enough or who may
//! approve what: that is governance. Must not remember what was used: the store does, in the transaction of the state
//! change.

pub mod agent;
mod authorship;
mod call;
mod identity;
pub mod keyfile;
mod passphrase;
mod person;
mod profile_act;
mod sealed;
mod shown;
mod signed;
mod witness_act;
mod word;

pub use authorship::SignedAuthorship;
pub use call::{CallClaim, CallError, SignedCall};
pub use identity::{Identity, IdentityError, IdentityInfo, KeptIdentity, People, WORD_LEN_MAX};
pub use passphrase::{PASSPHRASE_BYTES_MAX, PASSPHRASE_CHARS_MIN, Passphrase, PassphraseError};
pub use person::{
    PERSONS_MAX, Person, PersonAct, PersonActKind, PersonError, PersonState, Persons, SignedPersonAct,
};
pub use profile_act::{ProfileAct, RulesChange, SignedProfileAct};
pub use sealed::{Cost, SealedError, SealedKey};
pub use shown::{AskedName, BoundFacts, ShownQuestion, facts_digest, lines_digest};
pub use signed::{Approval, ApprovalError, Nonce, SignedApproval};
pub use witness_act::{SignedWitnessAct, WitnessAct};
