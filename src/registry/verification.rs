//! The checks of a store that exists.
//!
//! Owns the checks before its use, the verifier of its whole history, and the check of signed authorizations. Must not write.

pub(crate) mod authorizations;
pub(crate) mod check;
pub(crate) mod verify;
