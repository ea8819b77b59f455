//! Components as they come from outside, good and hostile.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test says so by failing")]

mod compiled_cache;
mod contract;
mod contract_2;
mod guest;
mod hostile;
mod refused;
mod wasi;
