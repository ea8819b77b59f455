//! The mark that requests a stop in the store's folder, so that a stop does not depend on the process at a socket.
//!
//! A program that may write to the folder creates the file `stop.asked` with the id of the stop, and shares its lock. The
//! engine's watch sees it, stops the arm, and then shares the lock as well. That is the answer: the kernel names the processes
//! that share a lock, and only the engine holds the store's lock. Once the stop is on record, or stored beside the database,
//! the mark is removed; while anything is in its place the cell cannot be started.
//!
//! Anything in its place is a stop: a folder, a pipe, a link, an unreadable text. While an engine does not take the mark, the
//! stops of other processes wait behind it, in files `stop.asked.PROCESS-NUMBER`. The watch puts one after the other in its
//! place.

mod watch;

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use holdpoint_protocol::wire::ID_BYTES_MAX;
use holdpoint_store::{Layout, lock_sharers};
use holdpoint_text::file::{NO_LINK, kind_of, regular};
use rustix::fs::{AtFlags, CWD, OFlags, RenameFlags, linkat, renameat_with};
use serde::{Deserialize, Serialize};

use crate::live::stop_switch::StopRequest;
use holdpoint_record::{REASON_BYTES_MAX, caller};
use holdpoint_wording::program::engine::mark_replaced;

pub use watch::StopMarkWatch;

/// A file that has no name yet (`open(2)`).
#[allow(clippy::cast_possible_wrap, reason = "a flag's bits, which the kernel takes as they are")]
const NAMELESS: i32 = OFlags::TMPFILE.bits() as i32;

/// The beginning of the name of a mark that waits behind another one.
const BEHIND: &str = "stop.asked.";

/// The most marks of one process number that wait: in other namespaces, other processes have the same number.
const BEHIND_MAX: u32 = 16;

/// The most bytes read of a mark: id, name and reason, escaped.
const MARK_BYTES_MAX: u64 = 32 << 10;

/// The content of a mark. It does not name the process of its maker.
#[derive(Serialize, Deserialize)]
struct StopMarkText {
    id: String,
    by: String,
    reason: String,
}

/// A mark that this process made.
#[derive(Debug)]
pub struct OwnStopMark(File);

impl OwnStopMark {
    /// Requests a stop of the cell.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`] if another stop is requested; any other if the folder takes no mark.
    pub fn put(layout: &Layout, id: &str, by: &str, reason: &str) -> io::Result<Self> {
        Self::put_at(layout, &layout.stop_request(), (id, by, reason))
    }

    /// Requests a stop of the cell behind the mark of another stop, which no engine has taken.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`] if the same person's stop waits there for the same reason; any other if the folder takes no
    /// mark.
    pub fn put_behind(layout: &Layout, id: &str, by: &str, reason: &str) -> io::Result<Self> {
        for number in 0..BEHIND_MAX {
            let path = layout.folder().join(format!("{BEHIND}{}-{number}", std::process::id()));
            match Self::put_at(layout, &path, (id, by, reason)) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists && !says(&path, by, reason) => {}
                put => return put,
            }
        }
        Err(io::Error::other("too many stops wait there"))
    }

    fn put_at(layout: &Layout, path: &Path, (id, by, reason): (&str, &str, &str)) -> io::Result<Self> {
        let text = StopMarkText { id: id.to_owned(), by: by.to_owned(), reason: reason.to_owned() };
        let text = serde_json::to_string(&text)?;
        match Self::put_whole(layout, path, &text) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => Self::put_by_name(path, &text),
            put => put,
        }
    }

    /// Without a name until it is complete: the engine never sees a part of it.
    fn put_whole(layout: &Layout, path: &Path, text: &str) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).mode(0o600).custom_flags(NAMELESS);
        let mut file = options.open(layout.folder())?;
        write_shared(&mut file, text)?;
        let open = format!("/proc/self/fd/{}", file.as_raw_fd());
        linkat(CWD, open, CWD, path, AtFlags::SYMLINK_FOLLOW)?;
        Ok(Self(file))
    }

    /// For file systems without unnamed files.
    fn put_by_name(path: &Path, text: &str) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true).mode(0o600);
        let mut file = options.open(path)?;
        write_shared(&mut file, text)?;
        Ok(Self(file))
    }

    /// Whether the mark was removed.
    #[must_use]
    pub fn is_removed(&self) -> bool {
        self.0.metadata().is_ok_and(|found| found.nlink() == 0)
    }

    /// Whether a process shares the lock of the mark, beside the maker.
    #[must_use]
    pub fn is_shared_by(&self, process: i32) -> bool {
        let own = i32::try_from(std::process::id()).unwrap_or(0);
        let mut sharers = lock_sharers(&self.0);
        if let Some(at) = sharers.iter().position(|sharer| *sharer == own) {
            sharers.remove(at);
        }
        sharers.contains(&process)
    }
}

/// The shared lock names the maker's process to the engine; without it only that name is missing.
fn write_shared(file: &mut File, text: &str) -> io::Result<()> {
    drop(file.try_lock_shared());
    file.write_all(text.as_bytes())
}

/// The file in the place of the mark.
#[derive(Debug)]
pub(crate) struct StopMarkFile {
    pub(crate) request: StopRequest,
    /// Device and inode; zeros where the system does not provide them.
    is: (u64, u64),
    /// The file, if it is one.
    file: Option<File>,
    /// Whether it could be read.
    clear: bool,
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).custom_flags(NO_LINK).open(path).and_then(regular)
}

/// Whether a mark is that of a person for a reason.
fn says(path: &Path, by: &str, reason: &str) -> bool {
    let text = open(path).ok().and_then(|file| read(&file));
    text.is_some_and(|mark| mark.by == by && mark.reason == reason)
}

/// Looks for a mark; `None` if there is none.
pub(crate) fn look(layout: &Layout) -> Option<StopMarkFile> {
    let (is, made, owner, kind) = match fs::symlink_metadata(layout.stop_request()) {
        Ok(found) => {
            ((found.dev(), found.ino()), (found.ctime(), found.ctime_nsec()), found.uid(), kind_of(&found))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => return None,
        Err(_) => ((0, 0), (0, 0), rustix::process::geteuid().as_raw(), "something"),
    };
    let file = open(&layout.stop_request()).ok();
    let text = file.as_ref().and_then(read);
    let own = i32::try_from(std::process::id()).unwrap_or(0);
    let mut sharers = file.as_ref().map_or_else(Vec::new, lock_sharers);
    sharers.retain(|process| *process != own);
    sharers.dedup();
    let process = match sharers[..] {
        [process] => u32::try_from(process).ok(),
        _ => None,
    };
    let clear = text.is_some();
    let StopMarkText { id, by, reason } = text.unwrap_or_else(|| StopMarkText {
        // A mark that is removed before it is read may have the number of one before it.
        id: format!("mark-{}-{}-{}-{}", is.0, is.1, made.0, made.1),
        by: String::new(),
        reason: mark_replaced(kind),
    });
    let request = StopRequest { id, by, reason, caller: caller::named(owner, process) };
    Some(StopMarkFile { request, is, file, clear })
}

/// Whether anything is in the place of the mark.
pub(crate) fn is_there(layout: &Layout) -> bool {
    !fs::symlink_metadata(layout.stop_request()).is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

/// The marks that wait behind another one.
fn waiting(layout: &Layout) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(layout.folder()) else { return Vec::new() };
    let names = entries.flatten().map(|entry| entry.file_name());
    let behind = names.filter(|name| name.as_encoded_bytes().starts_with(BEHIND.as_bytes()));
    behind.map(|name| layout.folder().join(name)).collect()
}

/// Everything that requests a stop and is not taken yet: the mark, and those behind it.
pub(crate) fn requested_at(layout: &Layout) -> Vec<PathBuf> {
    // Those behind come first: one may be put in the place of the mark meanwhile.
    let mut all = waiting(layout);
    if is_there(layout) {
        all.insert(0, layout.stop_request());
    }
    all
}

/// Puts a mark that waits in the place of the one before, if that is free. One that cannot be moved keeps the cell from being
/// started, and no other one from its turn.
pub(crate) fn bring_forward(layout: &Layout) {
    let mark = layout.stop_request();
    for path in waiting(layout) {
        // A folder, or a mark of another account, can be renamed and not linked. Some file systems can only link.
        let moved = renameat_with(CWD, &path, CWD, &mark, RenameFlags::NOREPLACE).map_err(io::Error::from);
        if moved.or_else(|_| fs::hard_link(&path, &mark).and_then(|()| fs::remove_file(&path))).is_ok() {
            return;
        }
    }
}

fn read(file: &File) -> Option<StopMarkText> {
    let mut text = String::new();
    file.take(MARK_BYTES_MAX).read_to_string(&mut text).ok()?;
    let fits = |mark: &StopMarkText| {
        (1..=ID_BYTES_MAX).contains(&mark.id.len())
            && mark.by.len() <= REASON_BYTES_MAX
            && mark.reason.len() <= REASON_BYTES_MAX
    };
    serde_json::from_str(&text).ok().filter(fits)
}

/// Removes the mark of a stop that is on record, or stored elsewhere.
pub fn settle(layout: &Layout, id: &str) {
    if look(layout).is_some_and(|found| found.request.id == id) {
        let path = layout.stop_request();
        // A mark that cannot be removed keeps stopping the cell.
        drop(fs::remove_file(&path).or_else(|_| fs::remove_dir(&path)));
    }
}
