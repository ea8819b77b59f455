//! What the sink is asked for and what it tells: the same with and without the feature `rerun`.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::governance::ids::{CapabilityId, Digest};
#[cfg(feature = "rerun")]
use crate::text::Untrusted;

/// What is kept and served.
#[derive(Clone, Debug, Default)]
pub struct SceneConfig {
    /// The folder of the recordings; absent: none are written.
    pub recordings: Option<PathBuf>,
    /// Names of the files whose digest is on the audit record: never touched again.
    pub closed: BTreeSet<String>,
    /// Serve a live viewer here from the start.
    pub view: Option<std::net::SocketAddr>,
    /// Put the machine's time into the rows too. Not in scripts: there the same seed gives the same bytes.
    pub wall_clock: bool,
}

/// Why no sink runs.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The feature is off.
    #[error("{0}")]
    NotBuiltIn(&'static str),
    /// The folder of the recordings cannot be made or listed.
    #[error(
        "cannot use the folder of the recordings \"{path}\": {source}. Hint: make it writable, or name another"
    )]
    Folder {
        /// The folder.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// No thread.
    #[error("cannot start the scene thread: {0}. Hint: close other programs, or raise the limit of threads")]
    Thread(std::io::Error),
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The feature is off.
    #[error("{0}")]
    NotBuiltIn(&'static str),
    /// The file cannot be opened, read or written.
    #[error("cannot use the recording \"{path}\": {source}. Hint: check that it exists and is readable")]
    File {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no recording of this program.
    #[error(
        "\"{path}\" is no recording of an upgrade: {text}. Hint: name a file from the folder of the recordings"
    )]
    Foreign {
        /// The file.
        path: String,
        /// What is missing or wrong.
        text: String,
    },
}

#[cfg(feature = "rerun")]
impl ReadError {
    /// The file cannot be used.
    pub(super) fn file(path: &std::path::Path, source: std::io::Error) -> Self {
        Self::File { path: shown(path), source }
    }

    /// The file is something else.
    pub(super) fn foreign(path: &std::path::Path, text: impl Into<String>) -> Self {
        Self::Foreign { path: shown(path), text: Untrusted::new(text).line().into_string() }
    }
}

/// A path for a message.
#[cfg(feature = "rerun")]
pub(super) fn shown(path: &std::path::Path) -> String {
    Untrusted::new(path.to_string_lossy()).line().into_string()
}

/// What the sink tells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// An upgrade's recording is ended, compacted and safe on the disk.
    Closed(Closed),
    /// A recording failed: said once for each, the rest of it is not written.
    Failed {
        /// Whose; absent where it is about no single one.
        version: Option<CapabilityId>,
        /// What failed, one sentence.
        text: String,
    },
    /// A viewer can connect.
    Serving {
        /// Where: `rerun+http://127.0.0.1:9876/proxy`.
        url: String,
    },
    /// No viewer can connect.
    NotServing {
        /// Why, one sentence.
        text: String,
    },
}

/// A recording that is ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Closed {
    /// The candidate.
    pub version: CapabilityId,
    /// How the upgrade ended.
    pub outcome: String,
    /// The file's name in the folder.
    pub file: String,
    /// SHA-256 of the file.
    pub digest: Digest,
    /// Its size, bytes.
    pub bytes: u64,
    /// Pictures in it.
    pub pictures: u64,
    /// Pictures and events that were dropped before they came here.
    pub dropped: (u64, u64),
}

/// The name of a version's recording without its ending: `<family>-<version>-<first 8 hex digits of the digest>`.
///
/// What a file name should not hold (a version's build part may hold `+`) becomes `_`.
#[must_use]
pub fn file_stem(version: &CapabilityId, digest: &Digest) -> String {
    let digits: String = digest.to_string().chars().take(8).collect();
    let plain = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '.' | '_');
    format!("{}-{}-{digits}", version.family, version.version)
        .chars()
        .map(|letter| if plain(letter) { letter } else { '_' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_files_name_holds_letters_that_every_system_takes() {
        let version: CapabilityId = "grasp@1.2.0+a.b".parse().unwrap();
        let digest = Digest::of_parts("test", &[b"x"]);
        let stem = file_stem(&version, &digest);
        assert_eq!(stem, format!("grasp-1.2.0_a.b-{}", &digest.to_string()[..8]));
    }
}
