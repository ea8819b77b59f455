//! Stages 2 to 7: functions over the parts they need, which return the outcome.
//!
//! Stage 1 is a registration (`operations.rs`). Stage 6 includes the confirmation of a concern, stage 7 the first tasks of the
//! rollback target; `ladder.rs` and `closing.rs` write the records.

pub mod activation;
pub(crate) mod break_glass;
mod cache_mismatch;
pub(crate) mod closing;
mod comparison_slice;
pub mod confirmation;
mod counted_try;
mod early_hold;
pub(crate) mod ladder;
pub(crate) mod live_harm;
mod live_task_output;
pub mod monitoring;
pub(crate) mod omitted_stage;
pub(crate) mod re_evaluation;
pub(crate) mod release;
pub mod resume;
pub mod rollback;
pub mod sandbox;
pub mod shadow;
mod shared_stops;
pub mod validation;

#[cfg(test)]
mod tests;
