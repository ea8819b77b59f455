//! Options of the sink, and its errors.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::PathBuf;

use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Untrusted};

/// What is recorded and served.
#[derive(Clone, Debug, Default)]
pub struct SceneConfig {
    /// The folder of the recordings; absent: none are written.
    pub recordings: Option<PathBuf>,
    /// Names of the files whose digest is on the audit record: never modified again.
    pub closed: BTreeSet<String>,
    /// Serve a live viewer here from the start.
    pub view: Option<std::net::SocketAddr>,
    /// Write wall time into the rows too. Not in scripts: there the same seed gives the same bytes.
    pub wall_clock: bool,
}

/// Why no sink runs.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The folder of the recordings cannot be made or listed.
    #[error("cannot use the folder of the recordings \"{path}\": {source}")]
    Folder {
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    #[error("cannot start the scene thread: {0}")]
    Thread(std::io::Error),
}

impl Hint for SceneError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Folder { path, .. } => ErrorDetails::of_file(ErrorReason::CannotWrite, path.as_str()),
            Self::Thread(_) => ErrorReason::Environment.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        Some(match self {
            Self::Folder { .. } => "make it writable, or name another".into(),
            Self::Thread(_) => "close other programs, or raise the limit of threads".into(),
        })
    }
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened, read or written.
    #[error("cannot use the recording \"{path}\": {source}")]
    File {
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// It is not a recording of this program.
    #[error("\"{path}\" is no recording of an upgrade: {text}")]
    Foreign {
        path: String,
        /// What is missing or wrong.
        text: String,
    },
}

impl Hint for ReadError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::File { path, .. } | Self::Foreign { path, .. } => {
                Some(ErrorDetails::of_file(ErrorReason::BadFile, path.as_str()))
            }
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        Some(match self {
            Self::File { .. } => "check that it exists and is readable".into(),
            Self::Foreign { .. } => "name a file from the folder of the recordings".into(),
        })
    }
}

impl ReadError {
    /// The file cannot be used.
    pub(crate) fn file(path: &std::path::Path, source: std::io::Error) -> Self {
        Self::File { path: display_path(path), source }
    }

    /// The file is something else.
    pub(crate) fn foreign(path: &std::path::Path, text: impl Into<String>) -> Self {
        Self::Foreign { path: display_path(path), text: Untrusted::new(text).line().into_string() }
    }
}

/// A path for a message.
pub(crate) fn display_path(path: &std::path::Path) -> String {
    Untrusted::new(path.to_string_lossy()).line().into_string()
}
