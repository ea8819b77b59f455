//! Names this build of the simulated cell by what computes it. Evidence is bound to the name
//! (`CellFactory::build_digest`), so results of other physics do not count.

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

#[path = "../src/cell/source_digest.rs"]
mod source_digest;

use std::io;

use source_digest::SourceDigest;

/// Sources that compute the cell, from the workspace's root.
const COMPUTES: [&str; 6] = ["Cargo.lock", "sim/assets", "sim/scenes", "sim/src", "src/body", "src/cell"];

fn main() -> io::Result<()> {
    let mut digest = SourceDigest::of("..", &COMPUTES)?;
    digest.add_compiler()?;
    digest.tell("HOLDPOINT_SIM_BUILD")
}
