//! Read access to a store.
//!
//! Owns views and lists, what an interrupted engine left, the export of a history, and proofs. Must not write.

pub(crate) mod audit_query;
pub(crate) mod export_store;
pub(crate) mod interrupted_work;
pub(crate) mod profile_views;
pub(crate) mod prove;
pub(crate) mod record_times;
pub(crate) mod record_views;
pub(crate) mod sqlite_reader;
pub(crate) mod views;
pub(crate) mod witness_views;
