//! Pools of candidates for experiments: generated packages, and a sealed file with the hidden ground truth.
//!
//! Owns the generator, the index `pool.json` and the truth file beside the folder. Must not be named by anything that
//! decides. The truth is opened to score a run after its last decision; the index holds its digest, so that a later
//! change is detected.

pub mod component_faults;
pub mod draft;
pub mod generate;
pub mod kind;
pub mod mutant;
pub mod paper_kinds;
pub mod recipes;
pub mod structure;
pub mod truth_file;

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use holdpoint_governance::ids::Family;
use holdpoint_text::hex::hex;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Untrusted};

pub use kind::Preset;
pub use truth_file::{Class, PoolTruth, TruthEntry};

/// The form of `pool.json` that this build writes and reads.
pub const FORMAT: u32 = 1;

/// The most candidates in a pool.
pub const CANDIDATES_MAX: usize = 20_000;

/// The largest index or truth file, bytes: about half a kilobyte for each of the most candidates.
pub const FILE_BYTES_MAX: u64 = 16 * 1024 * 1024;

/// The name of the index in a pool's folder.
pub const INDEX_FILE: &str = "pool.json";

/// The content of `pool.json`. It does not tell the class of a candidate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoolIndex {
    /// The form of the file: [`FORMAT`].
    pub format: u32,
    /// Version of the program that made it.
    pub generator: String,
    /// The seed of the pool.
    pub seed: u64,
    /// Which kinds it holds.
    pub preset: Preset,
    /// How many times each kind occurs in a family.
    pub sets: u32,
    /// SHA-256 of the truth file's bytes, hexadecimal.
    pub truth_digest: String,
    /// The candidates, by name.
    pub candidates: Vec<PoolCandidate>,
}

/// One candidate of a pool; its package is the folder of its name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoolCandidate {
    /// Name of its folder, e.g. `grasp-007`.
    pub name: String,
    pub family: Family,
    pub version: semver::Version,
}

/// A pool on disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pool {
    pub dir: PathBuf,
    pub index: PoolIndex,
}

/// Why a pool could not be made or read.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// A file cannot be read or written.
    #[error("{file}: {source}")]
    File {
        /// Which file, already made safe to print.
        file: String,
        source: std::io::Error,
    },
    /// A file is too large, no JSON, or not of this form.
    #[error("{file}: {problem}")]
    Content {
        /// Which file, already made safe to print.
        file: String,
        /// The problem, and the allowed content.
        problem: String,
    },
    /// The truth file is not the one the index was made with.
    #[error("{file}: its SHA-256 is {found}, and the index says {expected}")]
    Tampered {
        /// The truth file, already made safe to print.
        file: String,
        found: String,
        /// The digest in the index.
        expected: String,
    },
    /// The requested size is not allowed.
    #[error("{sets} sets are not allowed; 1 to {allowed} are")]
    Sets {
        /// The requested number.
        sets: u32,
        /// The most there may be.
        allowed: u32,
    },
    /// The path for the pool is taken.
    #[error("{0} exists already")]
    Exists(String),
    /// A generated package is not well formed: a defect of the generator.
    #[error("the generated candidate {name} is not well formed: {problem}")]
    Generated { name: String, problem: String },
}

impl Hint for PoolError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::File { file, .. } | Self::Content { file, .. } | Self::Tampered { file, .. } => {
                ErrorDetails::of_file(ErrorReason::BadFile, file.as_str())
            }
            Self::Sets { .. } => ErrorReason::Usage.into(),
            Self::Exists(path) => ErrorDetails::of_file(ErrorReason::Exists, path.as_str()),
            Self::Generated { .. } => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Tampered { .. } => {
                Some("the truth was changed or belongs to another pool; nothing can be scored with it".into())
            }
            Self::Exists(_) => {
                Some("a pool is never overwritten; name a folder that is not there yet".into())
            }
            Self::File { .. } | Self::Content { .. } | Self::Sets { .. } | Self::Generated { .. } => None,
        }
    }
}

impl Pool {
    /// Reads the index of a pool's folder.
    ///
    /// # Errors
    /// [`PoolError::File`] or [`PoolError::Content`], which name the file.
    pub fn read(dir: &Path) -> Result<Self, PoolError> {
        let path = dir.join(INDEX_FILE);
        let bytes = read_bytes(&path)?;
        let index: PoolIndex = parse(&path, &bytes)?;
        let content = |problem: String| PoolError::Content { file: display_path(&path), problem };
        if index.format != FORMAT {
            return Err(content(format!("the format {} is not known; {FORMAT} is", index.format)));
        }
        if index.candidates.len() > CANDIDATES_MAX {
            let count = index.candidates.len();
            return Err(content(format!(
                "{count} candidates are too many; up to {CANDIDATES_MAX} are allowed"
            )));
        }
        if let Some(strange) = index.candidates.iter().find(|c| !holdpoint_governance::ids::is_name(&c.name))
        {
            return Err(content(format!("the candidate's name {:?} is no name of a folder", strange.name)));
        }
        Ok(Self { dir: dir.to_owned(), index })
    }

    /// Opens the sealed truth: the file `<DIR>.truth.json` beside the folder.
    ///
    /// # Errors
    /// [`PoolError::Tampered`] if its digest is not the index's; otherwise as [`Pool::read`].
    pub fn truth(&self) -> Result<PoolTruth, PoolError> {
        let path = truth_path(&self.dir);
        let bytes = read_bytes(&path)?;
        let found = sha256(&bytes);
        if found != self.index.truth_digest {
            let expected = self.index.truth_digest.clone();
            return Err(PoolError::Tampered { file: display_path(&path), found, expected });
        }
        parse(&path, &bytes)
    }

    /// The folder of a candidate.
    #[must_use]
    pub fn folder(&self, candidate: &PoolCandidate) -> PathBuf {
        self.dir.join(&candidate.name)
    }
}

/// The path of a pool's truth: beside its folder, not in it.
#[must_use]
pub fn truth_path(dir: &Path) -> PathBuf {
    let mut name = dir.file_name().unwrap_or_default().to_owned();
    name.push(".truth.json");
    dir.with_file_name(name)
}

/// SHA-256 of some bytes, hexadecimal.
pub(crate) fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// A path as it may be printed.
#[must_use]
pub fn display_path(path: &Path) -> String {
    Untrusted::new(path.display().to_string()).line().into_string()
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, PoolError> {
    use std::io::Read as _;
    let error = |source| PoolError::File { file: display_path(path), source };
    let mut bytes = Vec::new();
    let file = holdpoint_text::file::open(path).map_err(error)?;
    file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(error)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        let problem = format!("more than {FILE_BYTES_MAX} bytes are not allowed");
        return Err(PoolError::Content { file: display_path(path), problem });
    }
    Ok(bytes)
}

fn parse<T: serde::de::DeserializeOwned>(path: &Path, bytes: &[u8]) -> Result<T, PoolError> {
    serde_json::from_slice(bytes)
        .map_err(|error| PoolError::Content { file: display_path(path), problem: error.to_string() })
}
