//! Names this build by what computes an episode: the sources of body, simulator, runtime, rules, trials and live
//! world, the versions of everything they are built with, the compiler and the target.
//! Evidence and cached results are bound to that name (`COMPUTED_BY` in `cell.rs`), so results of other physics or other
//! rules do not count. A changed comment changes the name too, which only costs time.
//!
//! A second name (`DECIDED_BY`) covers these and everything that takes a candidate through the stages. Cached decisions
//! of an experiment are bound to it.

#![allow(clippy::print_stdout, reason = "a build script tells cargo what it found by printing it")]

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use sha2::{Digest, Sha256};

/// Sources that compute an episode, from the workspace's root.
const COMPUTES: [&str; 14] = [
    "Cargo.lock",
    "sim/assets",
    "sim/scenes",
    "sim/src",
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

/// Extensions of the files that count.
const ENDINGS: [&str; 6] = ["rs", "toml", "urdf", "lock", "cedar", "wit"];

fn main() -> io::Result<()> {
    let root = PathBuf::from(env("CARGO_MANIFEST_DIR")).join("../..");
    let mut digest = Sha256::new();
    for name in COMPUTES {
        println!("cargo::rerun-if-changed=../../{name}");
        add(&mut digest, &root, Path::new(name))?;
    }
    part(&mut digest, env("TARGET").as_bytes());
    part(&mut digest, &Command::new(env("RUSTC")).arg("--version").output()?.stdout);
    tell("HOLDPOINT_COMPUTED_BY", digest.clone())?;
    for name in DECIDES {
        println!("cargo::rerun-if-changed=../../{name}");
        add(&mut digest, &root, Path::new(name))?;
    }
    tell("HOLDPOINT_DECIDED_BY", digest)
}

fn tell(name: &str, digest: Sha256) -> io::Result<()> {
    let mut digits = String::new();
    for byte in digest.finalize() {
        write!(digits, "{byte:02x}").map_err(io::Error::other)?;
    }
    println!("cargo::rustc-env={name}={digits}");
    Ok(())
}

/// Adds a file, or the files of a folder sorted by name, without tests.
fn add(digest: &mut Sha256, root: &Path, path: &Path) -> io::Result<()> {
    let full = root.join(path);
    if full.is_dir() {
        let mut names = fs::read_dir(&full)?
            .map(|entry| entry.map(|entry| entry.file_name()))
            .collect::<io::Result<Vec<_>>>()?;
        names.sort();
        let counted = names
            .iter()
            .filter(|name| !matches!(name.to_str(), None | Some("tests" | "examples" | "tests.rs")));
        return counted.map(|name| path.join(name)).try_for_each(|path| add(digest, root, &path));
    }
    if path.extension().and_then(|ending| ending.to_str()).is_some_and(|ending| ENDINGS.contains(&ending)) {
        part(digest, path.to_string_lossy().as_bytes());
        part(digest, &fs::read(full)?);
    }
    Ok(())
}

/// Adds bytes after their length, so that different lists of parts have different digests.
fn part(digest: &mut Sha256, bytes: &[u8]) {
    digest.update((bytes.len() as u64).to_le_bytes());
    digest.update(bytes);
}

/// A variable that cargo sets for every build script.
fn env(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}
