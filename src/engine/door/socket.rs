//! The socket's file: its name, its limits, and what an engine that is gone left.

use std::fs::{self, Permissions};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::DoorError;
use holdpoint_registry::Layout;

/// The longest path of a unix socket, bytes: 108 with the terminating zero (unix(7)).
pub(super) const PATH_BYTES_MAX: usize = 107;

/// What had the name of a socket at work and was moved aside; beyond so many the last is replaced.
const ASIDE_MAX: u32 = 100;

/// Where the engine of a store listens.
#[must_use]
pub fn socket_path(layout: &Layout) -> PathBuf {
    layout.folder().join("engine.sock")
}

/// A socket that is listened at, and where.
pub(super) struct BoundSocket {
    pub(super) listener: UnixListener,
    pub(super) place: SocketPlace,
}

/// The name of a socket, and the file that had it when it was bound.
pub(super) struct SocketPlace {
    path: PathBuf,
    file: Option<(u64, u64)>,
}

impl SocketPlace {
    fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), file: file_at(path) }
    }

    /// Whether the name still leads to this socket.
    pub(super) fn is_ours(&self) -> bool {
        self.file.is_some() && file_at(&self.path) == self.file
    }

    /// Listens at the name once more. The store is this engine's: whatever has the name meanwhile is moved aside.
    pub(super) fn bind_anew(&self) -> Result<BoundSocket, DoorError> {
        if fs::symlink_metadata(&self.path).is_ok() {
            let aside = |nth: u32| self.path.with_extension(format!("sock.aside-{nth}"));
            let free = (1..=ASIDE_MAX).map(aside).find(|path| fs::symlink_metadata(path).is_err());
            let free = free.unwrap_or_else(|| aside(ASIDE_MAX));
            fs::rename(&self.path, &free).map_err(DoorError::io("move aside", &self.path))?;
        }
        bind(&self.path)
    }
}

fn file_at(path: &Path) -> Option<(u64, u64)> {
    fs::symlink_metadata(path).ok().map(|found| (found.dev(), found.ino()))
}

/// Listens at `path`. The caller's engine holds the store's lock, so a socket nobody answers at is a leftover.
pub(super) fn bind(path: &Path) -> Result<BoundSocket, DoorError> {
    check_length(path)?;
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(DoorError::io("look at", path)(error)),
        Ok(found) if !found.file_type().is_socket() => {
            let hint = "move it away, or choose another folder with --data";
            return Err(DoorError::Taken { path: path.to_owned(), problem: "is not a socket", hint });
        }
        Ok(_) if UnixStream::connect(path).is_ok() => {
            let (problem, hint) = ("is served by another engine", "end that one first");
            return Err(DoorError::Taken { path: path.to_owned(), problem, hint });
        }
        Ok(_) => fs::remove_file(path).map_err(DoorError::io("remove the old socket", path))?,
    }
    let listener = UnixListener::bind(path).map_err(DoorError::io("listen at", path))?;
    fs::set_permissions(path, Permissions::from_mode(0o600))
        .map_err(DoorError::io("set the permissions of", path))?;
    listener.set_nonblocking(true).map_err(DoorError::io("listen at", path))?;
    Ok(BoundSocket { listener, place: SocketPlace::of(path) })
}

pub(super) fn check_length(path: &Path) -> Result<(), DoorError> {
    let bytes = path.as_os_str().as_bytes().len();
    if bytes > PATH_BYTES_MAX {
        return Err(DoorError::PathTooLong { path: path.to_owned(), bytes, allowed: PATH_BYTES_MAX });
    }
    Ok(())
}
