//! Answers questions from what was recorded: why a version stands where it does, what was measured, health over time.
//!
//! Owns the explanations, the answers about versions, the metrics and health of a store, the re-runs of a recorded episode for
//! display and of a store's evaluations, and the tryout of a candidate for its author. Works without an engine, and beside a running one. Must not write
//! to the record, decide, move the live arm, or name an engine.

pub mod episode_replay;
pub mod fault;
pub mod health_series;
pub mod record_query;
pub mod store_metrics;
pub mod tryout;
pub mod view;
pub mod why;
