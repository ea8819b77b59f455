//! The socket's file: its name, its limits, and the leftovers of an earlier engine.

use std::fs::{self, File, Permissions};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, chown};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::ControlSocketError;
use holdpoint_store::{Layout, LockHolder, lock_holder, lock_sharers};
use holdpoint_text::shell_word;
use holdpoint_text::users::{described_group, described_user, user_name};

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
        let account = account_word(rustix::process::geteuid().as_raw());
        let shown = shell_word(&folder.display().to_string());
        let taken = |problem: String, hint: String| ControlSocketError::Taken {
            path: folder.to_owned(),
            problem,
            hint,
        };
        let lock = match File::open(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let group = described_group(rustix::process::getegid().as_raw());
                let hint = format!("`sudo install -d -m 0710 -o {account} -g {group} {shown}` makes it");
                return Err(taken("does not exist".to_owned(), hint));
            }
            opened => opened.map_err(ControlSocketError::io("open", folder))?,
        };
        let found = lock.metadata().map_err(ControlSocketError::io("look at", folder))?;
        if !found.is_dir() {
            let hint = "name a folder for the socket with --seats".to_owned();
            return Err(taken("is no folder".to_owned(), hint));
        }
        if found.uid() != rustix::process::geteuid().as_raw() || found.mode() & 0o022 != 0 {
            let owner = described_user(found.uid());
            let problem = format!(
                "is owned by {owner} with the mode {:04o}: others than {account} may write to it",
                found.mode() & 0o7777
            );
            let hint = format!(
                "`sudo chown {account} {shown} && sudo chmod 0710 {shown}` makes it the engine's own"
            );
            return Err(taken(problem, hint));
        }
        lock.try_lock().map_err(|_| locked(folder, &lock))?;
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
            let hint = "move it away, or choose another folder with --data".to_owned();
            let problem = "is not a socket".to_owned();
            return Err(ControlSocketError::Taken { path: path.to_owned(), problem, hint });
        }
        Ok(_) if UnixStream::connect(path).is_ok() => {
            let (problem, hint) = ("is served by another engine".to_owned(), "end that one first".to_owned());
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
            chown(&new, None, Some(group)).map_err(|_| refused_group(path, group, is_member_of(group)))?;
            0o660
        }
    };
    fs::set_permissions(&new, Permissions::from_mode(mode))
        .map_err(ControlSocketError::io("set the permissions of", path))?;
    if let SocketAccess::Group(group) = openness {
        let found = fs::symlink_metadata(&new).map_err(ControlSocketError::io("look at", path))?;
        // Some file systems take a group and a mode, and keep neither.
        if (found.gid(), found.mode() & 0o777) != (group, mode) {
            return Err(refused_group(path, group, true));
        }
    }
    listener.set_nonblocking(true).map_err(ControlSocketError::io("listen at", path))?;
    let place = SocketPlace { path: path.to_owned(), openness, file: file_at(&new) };
    fs::rename(&new, path).map_err(ControlSocketError::io("listen at", path))?;
    Ok(BoundSocket { listener, place })
}

fn is_member_of(group: u32) -> bool {
    let others = rustix::process::getgroups().unwrap_or_default();
    others.into_iter().chain([rustix::process::getegid()]).any(|own| own.as_raw() == group)
}

/// An account as commands take it: by name, or by number.
fn account_word(uid: u32) -> String {
    user_name(uid).unwrap_or_else(|| uid.to_string())
}

/// The error for a folder that another process has locked. An account that can open the folder can lock it.
fn locked(folder: &Path, file: &File) -> ControlSocketError {
    let engine = match lock_holder(folder) {
        LockHolder::Process(process) => Some(process),
        LockHolder::Nobody | LockHolder::Untold => None,
    };
    let process = engine.or_else(|| lock_sharers(file).first().copied());
    let owner = process.and_then(|process| fs::metadata(format!("/proc/{process}")).ok());
    let owner = owner.map_or_else(String::new, |found| format!(" of {}", described_user(found.uid())));
    let shown = shell_word(&folder.display().to_string());
    let (holder, hint) = match process {
        Some(process) if engine.is_some() => (
            format!("process {process}{owner}, as by an engine"),
            "end that engine, or name another folder with --seats".to_owned(),
        ),
        Some(process) => (
            format!("process {process}{owner}, which is no engine"),
            format!(
                "`sudo kill {process}` ends it; `sudo chmod 0710 {shown}` lets no other account lock the folder"
            ),
        ),
        None => (
            "a process that the kernel does not name".to_owned(),
            format!(
                "`sudo lslocks` lists locks; `sudo chmod 0710 {shown}` lets no other account lock the folder"
            ),
        ),
    };
    ControlSocketError::Locked { path: folder.to_owned(), holder, hint }
}

/// The error for a group that cannot get the socket, and the commands that help.
fn refused_group(path: &Path, group: u32, is_member: bool) -> ControlSocketError {
    let uid = rustix::process::geteuid().as_raw();
    let (account, name) = (described_user(uid), described_group(group));
    let no_member = || format!("{account}, which runs the engine, is no member of the group {name}");
    let (problem, hint) = match user_name(uid) {
        _ if is_member => {
            let problem = format!("its file system does not keep the group {name} and the mode 0660");
            let command =
                format!("sudo install -d -m 0710 -o {} -g {name} /run/holdpoint", account_word(uid));
            let hint =
                format!("use a folder of another file system: `{command}`, and `--seats /run/holdpoint`");
            (problem, hint)
        }
        Some(user) => {
            let command = format!("sudo usermod -a -G {name} {user}");
            (no_member(), format!("`{command}` makes it one; then start the engine from a new login"))
        }
        // An account without a name is a member of the groups that it was started with, and of no others.
        None => {
            let folder = path.parent().unwrap_or(Path::new(".")).display().to_string();
            let own = described_group(rustix::process::getegid().as_raw());
            let command = format!("sudo chgrp {own} {}", shell_word(&folder));
            (no_member(), format!("`{command}` gives the folder to a group of the engine"))
        }
    };
    let path = path.to_owned();
    ControlSocketError::GroupRefused { path, problem, hint }
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

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_text::Hint as _;

    #[test]
    fn a_group_that_cannot_get_the_socket_is_named_with_the_command_that_helps() {
        let of = |is_member| {
            let error = refused_group(Path::new("/run/x/engine.sock"), u32::MAX - 1, is_member);
            (error.to_string(), error.hint().unwrap().into_owned())
        };
        let group = described_group(u32::MAX - 1);
        let has_name = user_name(rustix::process::geteuid().as_raw()).is_some();
        let join = if has_name { "usermod -a -G" } else { "sudo chgrp" };
        for (is_member, command) in [(false, join), (true, "install -d -m 0710")] {
            let (text, hint) = of(is_member);
            assert!(text.contains(&group) && hint.contains(command), "{text}: {hint}");
            assert!(!hint.contains("number"), "no command takes that word: {hint}");
        }
    }

    /// A member of the group kept the engine from starting by a shared lock, and the error named another engine.
    #[test]
    fn the_process_that_locks_the_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o750)).unwrap();
        let own = format!("process {}", std::process::id());
        let other = File::open(folder.path()).unwrap();
        for is_shared in [true, false] {
            let lock = if is_shared { other.try_lock_shared() } else { other.try_lock() };
            lock.unwrap();
            let error = ConsoleSocketFolder::take(folder.path()).unwrap_err();
            let ControlSocketError::Locked { holder, hint, .. } = &error else { panic!("{error}") };
            assert!(holder.contains(&own), "{holder}");
            assert_eq!(hint.contains("`sudo kill") && hint.contains("chmod 0710"), is_shared, "{hint}");
        }
        other.unlock().unwrap();
        ConsoleSocketFolder::take(folder.path()).unwrap();
    }

    #[test]
    fn a_folder_that_is_missing_or_of_another_account_is_described_with_the_command_that_helps() {
        let root = tempfile::tempdir().unwrap();
        let refused = |folder: &Path| {
            let error = ConsoleSocketFolder::take(folder).unwrap_err();
            assert!(matches!(error, ControlSocketError::Taken { .. }), "{error}");
            (error.to_string(), error.hint().unwrap().into_owned())
        };
        let (text, hint) = refused(&root.path().join("absent"));
        assert!(text.contains("absent") && hint.contains("sudo install -d -m 0710 -o "), "{text}: {hint}");
        fs::set_permissions(root.path(), Permissions::from_mode(0o777)).unwrap();
        let (text, hint) = refused(root.path());
        let owner = described_user(rustix::process::geteuid().as_raw());
        assert!(text.contains(&owner) && text.contains("0777"), "{text}");
        assert!(hint.contains("chmod 0710"), "{hint}");
    }

    #[test]
    fn the_socket_of_a_group_has_that_group_and_is_closed_to_others() {
        let folder = tempfile::tempdir().unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o710)).unwrap();
        let group = fs::metadata(folder.path()).unwrap().gid();
        let taken = ConsoleSocketFolder::take(folder.path()).unwrap();
        let path = folder.path().join("engine.sock");
        let bound = taken.bind(&path).unwrap();
        let found = fs::symlink_metadata(&path).unwrap();
        assert_eq!((found.gid(), found.mode() & 0o777), (group, 0o660));
        assert!(bound.place.is_ours());
        // A group that this process is not in: only root may give the socket to it.
        if !rustix::process::geteuid().is_root() && !is_member_of(61_001) {
            let error = listen(&path, SocketAccess::Group(61_001)).err().unwrap();
            assert!(matches!(error, ControlSocketError::GroupRefused { .. }), "{error}");
        }
        for open in [0o770, 0o757] {
            fs::set_permissions(folder.path(), Permissions::from_mode(open)).unwrap();
            assert!(matches!(
                ConsoleSocketFolder::take(folder.path()),
                Err(ControlSocketError::Taken { .. })
            ));
        }
    }
}
