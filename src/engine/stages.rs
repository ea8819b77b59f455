//! Stages 2 to 7 and how they end: functions over the parts they need, which return how they ended.
//!
//! Stage 1 is a registration (`operations.rs`). Stage 6 goes on in the confirmation of a doubt, stage 7 in the first
//! tasks under the predecessor; `ladder.rs` and `closing.rs` keep the records.

pub mod activation;
pub(crate) mod again;
pub(crate) mod closing;
mod compared;
pub mod confirmation;
pub(crate) mod emergency;
pub(crate) mod ladder;
pub(crate) mod left_out;
pub mod monitoring;
pub(crate) mod release;
pub mod resume;
pub mod rollback;
pub mod sandbox;
pub mod shadow;
pub mod validation;
mod voided;

#[cfg(test)]
mod tests;
