//! The program from outside: its verbs as a user starts them, and an engine as a front end uses it.
//!
//! One binary, because each links everything. Tests that need a process of their own are beside it: a terminal
//! (`console_pty`), kills (`kill`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test reports by failing")]

mod altered_messages;
mod attach;
mod bad_input;
mod bench;
mod bootstrap;
mod braking;
mod cached_results;
mod cell_faults;
mod cell_process;
mod cell_scenarios;
mod cli;
mod command_errors;
mod explain;
mod film;
mod forwarded_socket;
mod guide_samples;
mod health;
mod host;
mod impostor;
mod interrupted_script;
mod keys;
mod metrics;
mod old_stores;
mod other_accounts;
mod people;
mod profiles;
#[cfg(feature = "rerun")]
mod recordings;
#[cfg(feature = "rerun")]
mod replay_verbs;
mod reported_error;
mod requests;
mod scenarios;
mod second_arm;
mod serve;
mod signed_requests;
mod site;
mod skill;
mod socket;
mod socket_loss;
mod stages;
mod stop;
mod store_rebuild;
mod storm;
mod survives;
mod typed_commands;

#[path = "../support/agent.rs"]
mod agent;
#[path = "../support/folder_copy.rs"]
mod folder_copy;
#[path = "../fuzz/mutate.rs"]
#[allow(dead_code, reason = "the parsers' own tests use the rest")]
mod mutate;
#[path = "../support/quick_folder.rs"]
mod quick_folder;
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
