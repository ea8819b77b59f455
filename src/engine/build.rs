//! Names this build by everything that takes a candidate through the stages, beside what computes an episode: the build
//! script of `trials` names that. Cached decisions of an experiment are bound to both names (`decided_by`).

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

#[path = "../cell/source_digest.rs"]
mod source_digest;

use std::io;

use source_digest::SourceDigest;

/// Sources that take a candidate through the stages, from the workspace's root.
const DECIDES: [&str; 9] = [
    "profiles",
    "src/approvals",
    "src/audit",
    "src/engine",
    "src/explain",
    "src/record",
    "src/registry",
    "src/service",
    "src/store",
];

fn main() -> io::Result<()> {
    let mut digest = SourceDigest::of("../..", &DECIDES)?;
    digest.add_compiler()?;
    digest.tell("HOLDPOINT_DECIDED_BY")
}
