//! Every screen of the console and of a replay, as a user sees it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]

mod console;
mod live;
mod overview;
mod replay;
mod situations;
mod support;

#[path = "../support/health.rs"]
mod health;
#[path = "../support/shift.rs"]
mod shift;
#[path = "../support/upgrade.rs"]
mod upgrade;
