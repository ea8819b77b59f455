//! The open store.
//!
//! Owns the one thread with the one connection that writes, the locked store before its record was read, and the acts that
//! commit by themselves: first administrator, witnesses, an authorized profile. Must not repair a store.

pub(crate) mod administrator;
mod open_store;
pub(crate) mod profile_authorization;
pub(crate) mod store;
pub(crate) mod unverified_store;
pub(crate) mod witness_appointment;
