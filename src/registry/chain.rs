//! The audit chain in its table, and what its records produce.
//!
//! Owns the rows of the chain with their signed end, the fold with its snapshots, the comparison of the other tables with it,
//! the invariants, and the rows of persons. Must not write to another table, or apply a change.

pub(crate) mod audit;
pub(crate) mod chain_signature;
pub(crate) mod compare;
pub(crate) mod fold;
pub(crate) mod invariants;
pub(crate) mod person_rows;
pub(crate) mod row_images;
pub(crate) mod snapshot;
pub(crate) mod structure;
pub(crate) mod telemetry_seals;
