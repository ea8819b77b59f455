//! Files of a history: written whole, so that either the old or the new content is there, whatever happens.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// A file or folder that could not be used.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("cannot {what} {path:?}: {source}")]
    Io {
        /// The act, as a verb.
        what: &'static str,
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{what} {value:?} is not allowed: {allowed}")]
    Invalid {
        /// The kind of value.
        what: &'static str,
        value: String,
        allowed: String,
    },
}

impl FileError {
    /// Wraps an I/O error.
    pub(crate) fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { what, path, source }
    }

    pub(crate) fn invalid(what: &'static str, value: impl ToString, allowed: impl ToString) -> Self {
        Self::Invalid { what, value: value.to_string(), allowed: allowed.to_string() }
    }
}

impl Hint for FileError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Io { path, .. } => ErrorDetails::of_path(ErrorReason::Store, path).with_cause("io"),
            Self::Invalid { .. } => ErrorReason::BadInput.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}

/// Forces a folder's entries to disk.
///
/// # Errors
/// [`FileError::Io`].
pub fn sync_folder(path: &Path) -> Result<(), FileError> {
    File::open(path).and_then(|folder| folder.sync_all()).map_err(FileError::io("write the folder", path))
}

/// Writes a whole file so that either the old or the new one is there, whatever happens.
///
/// # Errors
/// [`FileError::Io`].
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let part = path.with_extension("part");
    // Never writes through an existing entry: a leftover of a crash, or a planted link.
    match fs::remove_file(&part) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            return Err(FileError::io("create", &part)(error));
        }
        Ok(()) | Err(_) => {}
    }
    let mut file = File::create_new(&part).map_err(FileError::io("create", &part))?;
    file.write_all(bytes).and_then(|()| file.sync_all()).map_err(FileError::io("write", &part))?;
    fs::rename(&part, path).map_err(FileError::io("rename", &part))?;
    path.parent().map_or(Ok(()), sync_folder)
}
