//! Names this build by what computes an episode beside the cell: the sources of ports, runtime, rules, trials and live
//! world, the versions of everything they are built with, the compiler and the target. The cell states its own build.
//! Evidence and cached results are bound to both names (`Cell::computed_by`), so results of other physics or other
//! rules do not count.

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

#[path = "../cell/source_digest.rs"]
mod source_digest;

use std::io;

use source_digest::SourceDigest;

/// Sources that compute an episode, from the workspace's root. The live world computes those of the live cell.
const COMPUTES: [&str; 11] = [
    "Cargo.lock",
    "src/body",
    "src/cell",
    "src/compiled",
    "src/component",
    "src/engine/live",
    "src/governance",
    "src/runtime",
    "src/sdk/wit",
    "src/skill",
    "src/trials",
];

fn main() -> io::Result<()> {
    let mut digest = SourceDigest::of("../..", &COMPUTES)?;
    digest.add_compiler()?;
    digest.tell("HOLDPOINT_COMPUTED_BY")
}
