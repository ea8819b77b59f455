//! The store from outside: its contents, its refusals, and its durability.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]
#![allow(clippy::print_stdout, reason = "a child tells its parent what it did")]

mod approvals;
#[path = "../../../../tests/fuzz/campaign.rs"]
mod campaign;
mod copied;
mod damage;
mod decay;
#[path = "../../../../tests/support/disk.rs"]
mod disk;
mod edits;
mod failing;
mod forged;
mod key_files;
mod kill;
mod killed;
mod lengths;
mod long;
#[path = "../../../../tests/fuzz/mutate.rs"]
mod mutate;
mod opening;
mod persons;
mod planted;
mod power;
mod profile_downgrade;
mod proofs;
#[path = "../../../../tests/support/quick_folder.rs"]
mod quick_folder;
mod races;
mod rebuild;
mod registry;
mod released;
mod signed;
mod strict;
mod support;
mod telemetry;
mod telemetry_quarantine;
mod traits;
mod tree;
mod verifier_fuzz;
mod verifiers;
mod wall_time;
mod witnesses;
