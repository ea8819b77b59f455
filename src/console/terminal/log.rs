//! The log file, where fd 2 points while the screen is up: messages of libraries and panics must not land in a frame.
//!
//! Owns the file, its rotation and the restoring of fd 2. Only its owner can read the file; it contains messages,
//! never secrets.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use holdpoint_wording::console::run as wording;

/// A log of this size becomes `holdpoint.log.1` at the next start, bytes.
pub const LOG_BYTES_MAX: u64 = 1_000_000;

/// Where fd 2 pointed before.
static STDERR: Mutex<Option<OwnedFd>> = Mutex::new(None);

#[derive(Debug)]
pub struct LogFile {
    file: File,
    path: PathBuf,
}

impl LogFile {
    /// Opens `holdpoint.log` in a folder, which is made if missing.
    ///
    /// # Errors
    /// If folder or file cannot be made or written.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        let path = folder.join("holdpoint.log");
        if fs::metadata(&path).is_ok_and(|known| known.len() >= LOG_BYTES_MAX) {
            fs::rename(&path, folder.join("holdpoint.log.1"))?;
        }
        let mut file = OpenOptions::new().append(true).create(true).mode(0o600).open(&path)?;
        // An older file may have wider permissions.
        file.set_permissions(fs::Permissions::from_mode(0o600))?;
        let secs = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        writeln!(file, "{}", wording::log_begins(std::process::id(), secs))?;
        Ok(Self { file, path })
    }

    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Points fd 2 to the log, and remembers its former target.
    ///
    /// # Errors
    /// If there are no file descriptors left.
    pub fn take_stderr(&self) -> io::Result<()> {
        let mut before = STDERR.lock().unwrap_or_else(PoisonError::into_inner);
        if before.is_none() {
            // Children must not inherit the copy.
            let copy = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stderr(), 3)?;
            *before = Some(copy);
        }
        rustix::stdio::dup2_stderr(&self.file)?;
        Ok(())
    }
}

/// Restores fd 2. Does nothing the second time.
pub fn restore_stderr() {
    let before = STDERR.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(before) = before {
        // If it fails, fd 2 keeps pointing to the log: nothing is lost.
        rustix::stdio::dup2_stderr(before).ok();
    }
}

/// The folder of the log and of exports: `$XDG_STATE_HOME/holdpoint`, else `~/.local/state/holdpoint`; absent if
/// neither is set. Relative paths in the environment do not count.
#[must_use]
pub fn state_folder() -> Option<PathBuf> {
    let variable = |name| std::env::var_os(name).map(PathBuf::from);
    state_folder_from(variable("XDG_STATE_HOME"), variable("HOME"))
}

fn state_folder_from(xdg: Option<PathBuf>, home: Option<PathBuf>) -> Option<PathBuf> {
    let absolute = |path: Option<PathBuf>| path.filter(|path| path.is_absolute());
    let base = absolute(xdg).or_else(|| absolute(home).map(|home| home.join(".local/state")))?;
    Some(base.join("holdpoint"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_file_is_private_and_rotates() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("state/holdpoint");
        let log = LogFile::open(&state).unwrap();
        let mode = fs::metadata(log.path()).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        let old = "x".repeat(usize::try_from(LOG_BYTES_MAX).unwrap());
        fs::write(log.path(), &old).unwrap();
        let again = LogFile::open(&state).unwrap();
        assert!(fs::metadata(again.path()).unwrap().len() < 200);
        assert_eq!(fs::read_to_string(state.join("holdpoint.log.1")).unwrap(), old);
    }

    #[test]
    fn state_folder_follows_the_environment() {
        for (xdg, home, expected) in [
            (Some("/x"), Some("/h"), Some("/x/holdpoint")),
            (Some("x"), Some("/h"), Some("/h/.local/state/holdpoint")),
            (None, Some("/h"), Some("/h/.local/state/holdpoint")),
            (None, Some("h"), None),
            (None, None, None),
        ] {
            let got = state_folder_from(xdg.map(Into::into), home.map(Into::into));
            assert_eq!(got, expected.map(PathBuf::from), "{xdg:?} {home:?}");
        }
    }
}
