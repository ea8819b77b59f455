//! Names a build by the sources that compute it, the compiler and the target; for the build scripts of cells and engine.
//! A changed comment changes the name too, which only costs time.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use sha2::{Digest, Sha256};

/// Extensions of the files that count.
const ENDINGS: [&str; 6] = ["rs", "toml", "urdf", "lock", "cedar", "wit"];

/// A digest of sources.
pub struct SourceDigest {
    root: PathBuf,
    digest: Sha256,
}

impl SourceDigest {
    /// The digest of these files and folders of the workspace whose root is at `root` from the package.
    pub fn of(root: &str, names: &[&str]) -> io::Result<Self> {
        let mut digest =
            Self { root: PathBuf::from(env("CARGO_MANIFEST_DIR")).join(root), digest: Sha256::new() };
        digest.add(root, names)?;
        Ok(digest)
    }

    /// Adds files and folders.
    pub fn add(&mut self, root: &str, names: &[&str]) -> io::Result<()> {
        for name in names {
            println!("cargo::rerun-if-changed={root}/{name}");
            add(&mut self.digest, &self.root, Path::new(name))?;
        }
        Ok(())
    }

    /// Adds compiler and target.
    pub fn add_compiler(&mut self) -> io::Result<()> {
        part(&mut self.digest, env("TARGET").as_bytes());
        part(&mut self.digest, &Command::new(env("RUSTC")).arg("--version").output()?.stdout);
        Ok(())
    }

    /// Gives the digest so far to the compiled crate, as a variable.
    pub fn tell(&self, name: &str) -> io::Result<()> {
        let mut digits = String::new();
        for byte in self.digest.clone().finalize() {
            write!(digits, "{byte:02x}").map_err(io::Error::other)?;
        }
        println!("cargo::rustc-env={name}={digits}");
        Ok(())
    }
}

/// Adds a file, or the files of a folder sorted by name, without tests. One that is not there is an error.
fn add(digest: &mut Sha256, root: &Path, path: &Path) -> io::Result<()> {
    let full = root.join(path);
    if fs::metadata(&full)?.is_dir() {
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
