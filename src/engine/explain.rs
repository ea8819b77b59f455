//! Answers questions from what was recorded: why a version stands where it does, what was measured, health over time.
//!
//! Owns the explanations, the views of a snapshot, the metrics and health of a store, the re-run of a recorded episode for
//! display, and the tryout of a candidate for its author. Must not write to the record, decide, or move the live arm.

pub(crate) mod episode_replay;
pub mod health_series;
pub(crate) mod record_query;
pub mod store_metrics;
pub mod tryout;
pub(crate) mod view;
pub mod why;
