//! The telemetry file, the second database of a store.
//!
//! Owns batches, quarantine of a foreign file, and the rows of cached results. Must not write to the chain: a transaction seals batches.

pub(crate) mod cached_rows;
pub(crate) mod telemetry_file;
pub(crate) mod telemetry_quarantine;
pub(crate) mod telemetry_views;
