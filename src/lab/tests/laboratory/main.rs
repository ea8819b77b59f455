//! The laboratory from outside: its program, pools of candidates, the optimizer.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test reports by failing")]

mod command_line;
mod pool;
mod refine;

#[path = "../../../../tests/program/reported_error.rs"]
#[allow(dead_code, reason = "the program's own tests use the rest")]
mod reported_error;
