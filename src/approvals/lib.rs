//! People who may decide, and their signed decisions.
//!
//! Owns identities (ed25519 keys with a role, kept in the store's `keys/identities`) and the approval object: what
//! it binds, its bytes, its signature. Must not decide how many approvals are enough or who may approve what: that
//! is governance. Must not remember what was used: the store does, in the transaction of the state change.

mod identity;
pub mod keyfile;
mod signed;

pub use identity::{Identity, IdentityError, IdentityInfo, People, WORD_LEN_MAX};
pub use signed::{Approval, ApprovalError, Nonce, SignedApproval};
