//! The process that holds a lock, from the kernel and not from a file.
//!
//! The locks are those of `flock(2)`; `/proc/locks` names the process of each (`proc_locks(5)`). A process of another
//! PID namespace is not named there.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, fcntl_lock, major, minor};

/// The most of the kernel's list of locks that is read, bytes; a line has some 60.
const LOCKS_BYTES_MAX: u64 = 4 << 20;

/// How long the list is read to answer one question. Every account of the machine can make the list long and slow.
const LOOK_WITHIN: Duration = Duration::from_millis(300);

const READ_BYTES: usize = 64 << 10;

/// How often the list is read for a lock that is held. The kernel returns it in parts, and may omit a line if another
/// process releases a lock between two of them.
const LOOKS_MAX: usize = 20;

/// The most bytes read of the kernel's data about one open file.
const FDINFO_BYTES_MAX: u64 = 64 << 10;

/// The most open files of a process that are looked at for a lock.
const OPEN_FILES_MAX: usize = 4096;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LockHolder {
    /// No process.
    Nobody,
    Process(i32),
    /// Some process may hold it; the kernel does not name it, or not in time.
    Untold,
}

/// Whether a process holds the lock of a folder, according to the kernel's data about its open files. Other accounts cannot
/// delay this, unlike [`lock_holder`]; `false` as well for a process of another account, which keeps these data to itself.
#[must_use]
pub fn holds_lock(process: i32, folder: &Path) -> bool {
    let Ok(found) = fs::metadata(folder) else { return false };
    let Ok(open) = fs::read_dir(format!("/proc/{process}/fdinfo")) else { return false };
    let infos = open.take(OPEN_FILES_MAX).filter_map(|entry| {
        let path = entry.ok()?.path();
        read_limited(File::open(path).ok()?, FDINFO_BYTES_MAX, None).ok()
    });
    let locks: String = infos.collect::<Vec<_>>().concat().replace("lock:", "");
    let holds = |name: &KernelName| holders(&locks, name, "WRITE").any(|holder| holder == process);
    let other_name = || KernelName::from_lock_list(&File::open(folder).ok()?);
    holds(&KernelName::of(&found)) || other_name().is_some_and(|name| holds(&name))
}

/// The process that holds the lock of a folder: an engine's, on its store or its second socket.
#[must_use]
pub fn lock_holder(folder: &Path) -> LockHolder {
    let found = match fs::metadata(folder) {
        Ok(found) => found,
        Err(error) if error.kind() == ErrorKind::NotFound => return LockHolder::Nobody,
        Err(_) => return LockHolder::Untold,
    };
    let file = File::open(folder).ok();
    let mut names = vec![KernelName::of(&found)];
    let until = Instant::now() + LOOK_WITHIN;
    for look in 0..LOOKS_MAX {
        let Ok(locks) = read_locks(until) else { return LockHolder::Untold };
        if let Some(process) = names.iter().find_map(|name| holders(&locks, name, "WRITE").next()) {
            return LockHolder::Process(process);
        }
        let Some(file) = file.as_ref().filter(|_| look == 0) else { continue };
        if file.try_lock_shared().is_ok() {
            drop(file.unlock());
            return LockHolder::Nobody;
        }
        // Some file systems (btrfs, overlayfs) have another device number here than in the list.
        names.extend(KernelName::from_lock_list(file));
    }
    LockHolder::Untold
}

/// The processes that share the lock of an open file, one entry for each lock, or two: the kernel returns its list in parts,
/// and may repeat a line if another process takes a lock between two of them.
#[must_use]
pub fn lock_sharers(file: &File) -> Vec<i32> {
    let (Ok(found), Ok(locks)) = (file.metadata(), read_locks(Instant::now() + LOOK_WITHIN)) else {
        return Vec::new();
    };
    let by_stat = KernelName::of(&found);
    let sharers: Vec<i32> = holders(&locks, &by_stat, "READ").collect();
    if !sharers.is_empty() {
        return sharers;
    }
    KernelName::from_lock_list(file).map_or_else(Vec::new, |name| holders(&locks, &name, "READ").collect())
}

/// A file's name in the kernel's list of locks: `major:minor:inode`.
#[derive(Debug, PartialEq, Eq)]
struct KernelName(String);

impl KernelName {
    fn of(found: &fs::Metadata) -> Self {
        Self(format!("{:02x}:{:02x}:{}", major(found.dev()), minor(found.dev()), found.ino()))
    }

    /// By a lock of another kind (`fcntl(2)`), which does not block a `flock`: the file's name in the kernel's list.
    fn from_lock_list(file: &File) -> Option<Self> {
        fcntl_lock(file, FlockOperation::NonBlockingLockShared).ok()?;
        let info = File::open(format!("/proc/self/fdinfo/{}", file.as_raw_fd()))
            .and_then(|info| read_limited(info, FDINFO_BYTES_MAX, None));
        let _ = fcntl_lock(file, FlockOperation::NonBlockingUnlock);
        let lock = info.ok()?.lines().find_map(|line| {
            let lock = KernelLock::read(line.strip_prefix("lock:")?)?;
            (lock.kind == "POSIX").then(|| lock.file.to_owned())
        })?;
        Some(Self(lock))
    }
}

/// One line of the kernel's list.
struct KernelLock<'a> {
    kind: &'a str,
    mode: &'a str,
    process: i32,
    file: &'a str,
}

impl<'a> KernelLock<'a> {
    /// `1: FLOCK  ADVISORY  WRITE 712 fe:00:5414914 0 EOF`; a line about a process that waits for a lock is none.
    fn read(line: &'a str) -> Option<Self> {
        let mut fields = line.split_whitespace().skip(1);
        let kind = fields.next().filter(|kind| *kind != "->")?;
        let (mode, process, file) = (fields.nth(1)?, fields.next()?.parse().ok()?, fields.next()?);
        Some(Self { kind, mode, process, file })
    }
}

/// The processes with a `flock` of this mode on a file.
fn holders<'a>(locks: &'a str, name: &'a KernelName, mode: &'a str) -> impl Iterator<Item = i32> {
    let held = move |lock: &KernelLock<'_>| {
        lock.kind == "FLOCK" && lock.mode == mode && lock.file == name.0 && lock.process > 0
    };
    locks.lines().filter_map(KernelLock::read).filter(held).map(|lock| lock.process)
}

fn read_locks(until: Instant) -> io::Result<String> {
    read_limited(File::open("/proc/locks")?, LOCKS_BYTES_MAX, Some(until))
}

/// Reads all of a source, but not for long.
///
/// # Errors
/// [`ErrorKind::TimedOut`] if the source has not ended at `until`.
fn read_limited(source: impl Read, bytes_max: u64, until: Option<Instant>) -> io::Result<String> {
    let mut source = source.take(bytes_max);
    // The kernel keeps the list consistent for one read alone, so the reads are large.
    let (mut text, mut part) = (Vec::with_capacity(READ_BYTES), vec![0; READ_BYTES]);
    loop {
        match source.read(&mut part) {
            Ok(0) => return String::from_utf8(text).map_err(io::Error::other),
            Ok(count) => text.extend_from_slice(part.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
        if until.is_some_and(|until| Instant::now() >= until) {
            return Err(ErrorKind::TimedOut.into());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    fn own() -> i32 {
        i32::try_from(std::process::id()).unwrap()
    }

    #[test]
    fn kernel_names_the_holder_of_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(lock_holder(folder.path()), LockHolder::Nobody);
        let lock = File::open(folder.path()).unwrap();
        lock.try_lock().unwrap();
        assert_eq!(lock_holder(folder.path()), LockHolder::Process(own()));
        lock.unlock().unwrap();
        // Another process, whose number is in no file.
        let mut other = Command::new("flock")
            .arg(folder.path())
            .args(["sh", "-c", "echo up; read line"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut up = [0; 3];
        other.stdout.as_mut().unwrap().read_exact(&mut up).unwrap();
        assert_eq!(lock_holder(folder.path()), LockHolder::Process(i32::try_from(other.id()).unwrap()));
        drop(other.stdin.take());
        other.wait().unwrap();
        assert_eq!(lock_holder(folder.path()), LockHolder::Nobody);
        assert_eq!(lock_holder(&folder.path().join("absent")), LockHolder::Nobody);
    }

    #[test]
    fn a_process_that_holds_a_lock_is_known_without_the_list_of_all_locks() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!holds_lock(own(), folder.path()));
        let lock = File::open(folder.path()).unwrap();
        lock.try_lock_shared().unwrap();
        assert!(!holds_lock(own(), folder.path()), "a shared lock is no engine's");
        lock.try_lock().unwrap();
        assert!(holds_lock(own(), folder.path()));
        assert!(!holds_lock(-1, folder.path()) && !holds_lock(own(), &folder.path().join("absent")));
    }

    /// Any account of the machine can add 90,000 locks to the list, and a stop waited until all of it was read.
    #[test]
    fn a_list_without_an_end_is_read_for_a_bounded_time() {
        let begun = Instant::now();
        let error = read_limited(io::repeat(b'x'), u64::MAX, Some(begun + Duration::from_millis(1)));
        assert_eq!(error.unwrap_err().kind(), ErrorKind::TimedOut);
        assert_eq!(read_limited(&b"abc"[..], 2, Some(begun + Duration::from_hours(1))).unwrap(), "ab");
        assert!(begun.elapsed() < Duration::from_mins(1));
    }

    #[test]
    fn kernel_name_of_a_file_is_found_without_its_device_number() {
        let folder = tempfile::tempdir().unwrap();
        let held = File::open(folder.path()).unwrap();
        held.try_lock().unwrap();
        let file = File::open(folder.path()).unwrap();
        let name = KernelName::from_lock_list(&file).expect("the kernel says it");
        let locks = read_locks(Instant::now() + Duration::from_mins(1)).unwrap();
        let mut found: Vec<i32> = holders(&locks, &name, "WRITE").collect();
        // Other processes take locks meanwhile, so the kernel may repeat the line.
        found.dedup();
        assert_eq!(found, [own()]);
    }

    #[test]
    fn shared_locks_are_listed_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mark");
        let first = File::create(&path).unwrap();
        assert!(lock_sharers(&first).is_empty());
        let second = File::open(&path).unwrap();
        first.try_lock_shared().unwrap();
        second.try_lock_shared().unwrap();
        let sharers = lock_sharers(&first);
        assert!(sharers.len() >= 2 && sharers.iter().all(|sharer| *sharer == own()), "{sharers:?}");
    }

    #[test]
    fn process_that_waits_for_a_lock_is_no_holder() {
        let locks = "1: FLOCK  ADVISORY  WRITE 712 fe:00:54 0 EOF\n1: -> FLOCK  ADVISORY  WRITE 713 fe:00:54 0 EOF\n\
                     2: POSIX  ADVISORY  WRITE 714 fe:00:54 0 EOF\n3: FLOCK  ADVISORY  WRITE -1 fe:00:55 0 EOF\n4: FLOCK\n";
        let of = |name: &str| holders(locks, &KernelName(name.to_owned()), "WRITE").collect::<Vec<_>>();
        assert_eq!((of("fe:00:54"), of("fe:00:55"), of("fe:00:5")), (vec![712], vec![], vec![]));
    }
}
