//! The rules of governance against tables of worked values, and against invalid values.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]

mod anchored;
mod approvals;
mod cell_fault;
mod compared_rates;
mod compatibility;
mod early;
mod fixture;
mod gating;
mod harm;
mod live_harm;
mod live_like;
mod metric_mutations;
mod monitoring;
mod never_pass;
mod outputs_alone;
mod paper;
mod permissions;
mod risk;
mod texts;
mod time_excess;
mod tries;
