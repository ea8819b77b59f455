//! The store from outside: what it keeps, what it refuses, what survives.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]
#![allow(clippy::print_stdout, reason = "a child tells its parent what it did")]

#[path = "support/store.rs"]
mod support;

#[path = "store/approvals.rs"]
mod approvals;
#[path = "store/damage.rs"]
mod damage;
#[path = "store/kill.rs"]
mod kill;
#[path = "store/opening.rs"]
mod opening;
#[path = "store/registry.rs"]
mod registry;
#[path = "store/telemetry.rs"]
mod telemetry;
