//! Names this build by what computes an episode beside the cell: the sources of ports, runtime, rules, trials and live
//! world, the versions of everything they are built with, the compiler and the target. The cell states its own build.
//! Evidence and cached results are bound to both names (`Cell::computed_by`), so results of other physics or other
//! rules do not count.
//!
//! A second name (`DECIDED_BY`) covers these and everything that takes a candidate through the stages. Cached decisions
//! of an experiment are bound to it.

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

#[path = "../cell/source_digest.rs"]
mod source_digest;

use std::io;

use source_digest::SourceDigest;

/// The workspace's root, from this package.
const ROOT: &str = "../..";

/// Sources that compute an episode, from the workspace's root.
const COMPUTES: [&str; 11] = [
    "Cargo.lock",
    "src/body",
    "src/cell",
    "src/compiled",
    "src/component",
    "src/engine/trial",
    "src/engine/world",
    "src/governance",
    "src/runtime",
    "src/sdk/wit",
    "src/skill",
];

/// Further sources that take a candidate through the stages, from the workspace's root.
const DECIDES: [&str; 4] = ["profiles", "src/approvals", "src/engine", "src/registry"];

fn main() -> io::Result<()> {
    let mut digest = SourceDigest::of(ROOT, &COMPUTES)?;
    digest.add_compiler()?;
    digest.tell("HOLDPOINT_COMPUTED_BY")?;
    digest.add(ROOT, &DECIDES)?;
    digest.tell("HOLDPOINT_DECIDED_BY")
}
