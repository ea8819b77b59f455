//! The socket's file: its name, its limits, and the leftovers of an earlier engine.

use std::fs::{self, File, Permissions};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, chown};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::ControlSocketError;
use holdpoint_registry::Layout;

/// The longest path of a unix socket, bytes: 108 with the terminating zero (unix(7)).
pub(super) const PATH_BYTES_MAX: usize = 107;

/// The socket path of a store.
#[must_use]
pub fn socket_path(layout: &Layout) -> PathBuf {
    layout.folder().join("engine.sock")
}

/// The accounts that may connect to a socket, by its file's permissions.
#[derive(Clone, Copy, Debug)]
pub(super) enum SocketAccess {
    /// The owner alone.
    Owner,
    /// Members of this group as well.
    Group(u32),
}

/// A listening socket and its place.
pub(super) struct BoundSocket {
    pub(super) listener: UnixListener,
    pub(super) place: SocketPlace,
}

/// The name of a socket, and the file that had it when it was bound.
pub(super) struct SocketPlace {
    path: PathBuf,
    openness: SocketAccess,
    file: Option<(u64, u64)>,
}

impl SocketPlace {
    /// Whether the name still leads to this socket.
    pub(super) fn is_ours(&self) -> bool {
        self.file.is_some() && file_at(&self.path) == self.file
    }

    /// Listens at the name once more. The store is this engine's, so a socket, link or pipe with the name is replaced. A file
    /// or folder may contain a user's data: the last one is renamed to `engine.sock.aside`.
    pub(super) fn rebind(&self) -> Result<BoundSocket, ControlSocketError> {
        let path = &self.path;
        let found = fs::symlink_metadata(path).ok();
        if found.is_some_and(|found| found.is_file() || found.is_dir()) && fs::remove_dir(path).is_err() {
            let aside = path.with_extension("sock.aside");
            // A folder cannot replace a folder that is not empty.
            drop(fs::remove_file(&aside));
            fs::rename(path, &aside).map_err(ControlSocketError::io("move aside", path))?;
        }
        listen(path, self.openness)
    }
}

/// A folder for the socket of consoles of other accounts. The process holds its lock as long as this lives; the lock
/// identifies the engine to clients.
#[derive(Debug)]
pub(super) struct ConsoleSocketFolder {
    /// Its lock ends with it.
    _lock: File,
    group: u32,
}

impl ConsoleSocketFolder {
    /// Locks a folder that only this process's account may write to.
    pub(super) fn take(folder: &Path) -> Result<Self, ControlSocketError> {
        let taken = |problem| ControlSocketError::Taken {
            path: folder.to_owned(),
            problem,
            hint: "make it the engine's own: `chown` to its account, the group of the consoles, `chmod 0750`",
        };
        let lock = File::open(folder).map_err(ControlSocketError::io("open", folder))?;
        let found = lock.metadata().map_err(ControlSocketError::io("look at", folder))?;
        if !found.is_dir() {
            return Err(taken("is no folder"));
        }
        if found.uid() != rustix::process::geteuid().as_raw() || found.mode() & 0o022 != 0 {
            return Err(taken("may be written to by others than this account"));
        }
        lock.try_lock().map_err(|_| taken("is another engine's console folder"))?;
        Ok(Self { _lock: lock, group: found.gid() })
    }

    pub(super) fn bind(&self, path: &Path) -> Result<BoundSocket, ControlSocketError> {
        bind(path, SocketAccess::Group(self.group))
    }
}

fn file_at(path: &Path) -> Option<(u64, u64)> {
    fs::symlink_metadata(path).ok().map(|found| (found.dev(), found.ino()))
}

/// Listens at `path`. The caller's engine holds the store's lock, so a socket that does not answer is a leftover.
pub(super) fn bind(path: &Path, openness: SocketAccess) -> Result<BoundSocket, ControlSocketError> {
    check_length(path)?;
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(ControlSocketError::io("look at", path)(error)),
        Ok(found) if !found.file_type().is_socket() => {
            let hint = "move it away, or choose another folder with --data";
            return Err(ControlSocketError::Taken {
                path: path.to_owned(),
                problem: "is not a socket",
                hint,
            });
        }
        Ok(_) if UnixStream::connect(path).is_ok() => {
            let (problem, hint) = ("is served by another engine", "end that one first");
            return Err(ControlSocketError::Taken { path: path.to_owned(), problem, hint });
        }
        Ok(_) => fs::remove_file(path).map_err(ControlSocketError::io("remove the old socket", path))?,
    }
    listen(path, openness)
}

/// Listens under another name, which then replaces `path` in one step.
fn listen(path: &Path, openness: SocketAccess) -> Result<BoundSocket, ControlSocketError> {
    let new = path.with_extension("new");
    match fs::remove_file(&new) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            return Err(ControlSocketError::io("remove", &new)(error));
        }
        Ok(()) | Err(_) => {}
    }
    let listener = UnixListener::bind(&new).map_err(ControlSocketError::io("listen at", path))?;
    let mode = match openness {
        SocketAccess::Owner => 0o600,
        SocketAccess::Group(group) => {
            chown(&new, None, Some(group)).map_err(ControlSocketError::io("give to its group", path))?;
            0o660
        }
    };
    fs::set_permissions(&new, Permissions::from_mode(mode))
        .map_err(ControlSocketError::io("set the permissions of", path))?;
    listener.set_nonblocking(true).map_err(ControlSocketError::io("listen at", path))?;
    let place = SocketPlace { path: path.to_owned(), openness, file: file_at(&new) };
    fs::rename(&new, path).map_err(ControlSocketError::io("listen at", path))?;
    Ok(BoundSocket { listener, place })
}

pub(super) fn check_length(path: &Path) -> Result<(), ControlSocketError> {
    let bytes = path.as_os_str().as_bytes().len();
    if bytes > PATH_BYTES_MAX {
        return Err(ControlSocketError::PathTooLong {
            path: path.to_owned(),
            bytes,
            allowed: PATH_BYTES_MAX,
        });
    }
    Ok(())
}
