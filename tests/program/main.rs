//! The program from outside: its verbs as a user starts them, and an engine as a front end uses it.
//!
//! One binary, because each links everything. Tests that need a process of their own are beside it: a terminal
//! (`console_pty`), kills (`kill`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test reports by failing")]

mod asked;
mod attach;
mod bad_input;
mod bench;
mod between;
mod braking;
mod cli;
mod displaced;
mod door;
mod early;
mod explain;
mod film;
mod health;
mod host;
mod impostor;
mod kept;
mod keys;
mod mended;
mod metrics;
mod old_stores;
mod people;
mod pool;
mod profiles;
#[cfg(feature = "rerun")]
mod recorded;
#[cfg(feature = "rerun")]
mod recordings;
mod refine;
mod repeated;
mod scenarios;
mod second_arm;
mod serve;
mod signed;
mod skill;
mod stages;
mod stop;
mod storm;
mod survives;
mod typed;

#[path = "../support/agent.rs"]
mod agent;
#[path = "../fuzz/mutate.rs"]
#[allow(dead_code, reason = "the parsers' own tests use the rest")]
mod mutate;
#[cfg(feature = "rerun")]
#[path = "../support/shift.rs"]
#[allow(dead_code, reason = "the screens use the rest")]
mod shift;
#[path = "../../src/registry/tests/store/support.rs"]
#[allow(dead_code, reason = "the store's own tests use the rest")]
mod store;
#[cfg(feature = "rerun")]
#[path = "../support/upgrade.rs"]
#[allow(dead_code, reason = "the screens use the rest")]
mod upgrade;
