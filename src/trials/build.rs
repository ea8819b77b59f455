//! Names this build by what computes an episode beside the cell: the sources of ports, runtime, rules, trials and live
//! world, the versions of everything they are built with, the compiler and the target. The cell states its own build.
//! Evidence and cached results are bound to both names (`Cell::computed_by`), so results of other physics or other
//! rules do not count.
//!
//! Also lists the baselines that the program embeds, from the shipped site file.

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

#[path = "../cell/source_digest.rs"]
mod source_digest;

use std::path::PathBuf;
use std::{env, fs, io};

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
    digest.tell("HOLDPOINT_COMPUTED_BY")?;
    list_baselines()
}

/// Lists the folders of the shipped site's first versions, in its order, for `embedded.rs`.
fn list_baselines() -> io::Result<()> {
    const SITE: &str = "../../manifests/site.toml";
    println!("cargo::rerun-if-changed={SITE}");
    let site = fs::read_to_string(SITE)?;
    let folders = site.lines().filter_map(|line| line.strip_prefix("baseline = \"")?.strip_suffix('"'));
    let root = fs::canonicalize("../../manifests")?;
    let entry = |folder: &str| {
        let texts = ["manifest.toml", "submission.toml", "params.toml"]
            .map(|file| format!("include_str!({:?})", root.join(folder).join(file)));
        format!("    (\"manifests/{folder}\", [{}]),\n", texts.join(", "))
    };
    let entries: Vec<String> = folders.map(entry).collect();
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or_else(|| io::Error::other("OUT_DIR is not set"))?);
    fs::write(out.join("baselines.rs"), format!("&[\n{}]\n", entries.concat()))
}
