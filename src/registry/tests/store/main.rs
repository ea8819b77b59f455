//! The store from outside: what it keeps, what it refuses, what survives.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]
#![allow(clippy::print_stdout, reason = "a child tells its parent what it did")]

mod approvals;
mod damage;
mod edits;
mod kill;
mod killed;
mod long;
mod opening;
mod rebuild;
mod registry;
mod released;
mod signed;
mod support;
mod telemetry;
