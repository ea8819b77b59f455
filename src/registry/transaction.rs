//! The changes of one transaction, each with its audit record.
//!
//! Owns their checks and their rows, for the first time or, in a rebuild, again. Must not begin or commit: the caller holds
//! the transaction.

pub(crate) mod activate;
pub(crate) mod apply;
pub(crate) mod approve;
pub(crate) mod person_acts;
pub(crate) mod profile_acts;
pub(crate) mod rebuild_losses;
pub(crate) mod replay;
pub(crate) mod telemetry_sealing;
pub(crate) mod version;
pub(crate) mod witness_acts;
