//! The engine's side of the mark: a thread that does nothing else sees it, halts the arm, and says so by the mark's lock.

use std::collections::VecDeque;
use std::ffi::CStr;
use std::fs::{self, File};
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use holdpoint_registry::Layout;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};
use rustix::io::Errno;

use super::{FoundMark, is_there, look};
use crate::caller;
use crate::world::switch::{AskedStop, Switch};

/// How often the folder is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How long a mark that is not complete may be still being written, in looks of [`WRITTEN_LOOK`].
const WRITTEN_LOOKS: u32 = 10;

/// Time between two looks at a mark that is not complete.
const WRITTEN_LOOK: Duration = Duration::from_millis(2);

/// How long the lock of a mark is shared: its maker looks for that at once.
const ANSWER_KEPT: Duration = Duration::from_secs(10);

/// The most marks whose lock is shared at a time.
const ANSWERS_MAX: usize = 8;

/// Who stops the cell where nobody else is known to have.
const BY_ITSELF: &str = "the engine";

/// A mark was made, and was gone before it could be read.
const REMOVED: &str =
    "somebody asked for a stop in the store's folder, and the mark was removed before the engine had read it";

/// The folder has another name, or another folder has its name.
const AWAY: &str =
    "the store's folder was moved or replaced: a stop that is asked for there does not reach this engine";

/// Room for the kernel's words on what was made in the folder, bytes: some 60 names at a time.
const MADE_BYTES: usize = 4096;

/// Watches the folder for a mark, on a thread of its own, until it is dropped.
#[derive(Debug)]
pub(crate) struct MarkWatch {
    /// Its end is the thread's.
    end: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl MarkWatch {
    /// # Errors
    /// If the system gives no thread, or the folder is not there.
    pub(crate) fn start(layout: Layout, switch: Arc<Switch>) -> io::Result<Self> {
        let (end, ended) = sync_channel(0);
        let folder = WatchedFolder::of(&layout)?;
        let watch = move || watch(&layout, &folder, &switch, &ended);
        let thread = std::thread::Builder::new().name("stop-watch".to_owned()).spawn(watch)?;
        Ok(Self { end: Some(end), thread: Some(thread) })
    }
}

impl Drop for MarkWatch {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// The folder in which marks are made.
struct WatchedFolder {
    path: PathBuf,
    /// Device and inode: which folder it is, whatever it is called.
    is: (u64, u64),
    /// The kernel tells here what is made in it; absent where the system gives none. Then it is looked at alone.
    told: Option<OwnedFd>,
}

impl WatchedFolder {
    fn of(layout: &Layout) -> io::Result<Self> {
        // A name that begins in the working folder would move with that.
        let path = std::path::absolute(layout.folder())?;
        let found = fs::metadata(&path)?;
        let told = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK).ok();
        let made = WatchFlags::CREATE | WatchFlags::MOVED_TO | WatchFlags::ONLYDIR;
        let told = told.filter(|told| inotify::add_watch(told, &path, made).is_ok());
        Ok(Self { path, is: (found.dev(), found.ino()), told })
    }

    /// Until something is made in it, or for [`LOOK_EVERY`].
    fn wait(&self) {
        let at_most = Timespec { tv_sec: 0, tv_nsec: i64::from(LOOK_EVERY.subsec_nanos()) };
        let Some(told) = &self.told else { return std::thread::sleep(LOOK_EVERY) };
        if poll(&mut [PollFd::new(told, PollFlags::IN)], Some(&at_most)).is_err() {
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// How many marks were made since this was asked last, those that are not there any more among them.
    fn marks_made(&self, layout: &Layout) -> u64 {
        let Some(told) = &self.told else { return 0 };
        let mark = layout.stop_asked();
        let is_mark =
            |name: &CStr| mark.file_name().is_some_and(|mark| mark.as_encoded_bytes() == name.to_bytes());
        let mut room = [MaybeUninit::uninit(); MADE_BYTES];
        let mut events = inotify::Reader::new(told, &mut room);
        let mut made = 0;
        loop {
            match events.next() {
                // Of more than the kernel keeps it is not known what they were.
                Ok(event) => {
                    let is_lost = event.events().contains(ReadFlags::QUEUE_OVERFLOW);
                    made += u64::from(is_lost || event.file_name().is_some_and(is_mark));
                }
                Err(Errno::INTR) => {}
                Err(_) => return made,
            }
        }
    }

    /// Whether its name leads somewhere else: whoever stops the cell by it does not reach this engine.
    fn is_away(&self) -> bool {
        !fs::metadata(&self.path).is_ok_and(|found| (found.dev(), found.ino()) == self.is)
    }
}

/// Which marks were seen, held against those that the kernel tells of.
#[derive(Default)]
struct SeenMarks {
    /// Device and inode of the last one.
    last: Option<(u64, u64)>,
    /// How many were seen that the kernel has not told of yet.
    untold: u64,
}

impl SeenMarks {
    /// Whether one was made that is gone and was never seen. `made` were told of, and then this was found.
    fn has_missed(&mut self, made: u64, found: Option<(u64, u64)>) -> bool {
        let mut missed = made.saturating_sub(self.untold);
        self.untold = self.untold.saturating_sub(made);
        let Some(found) = found else { return missed > 0 };
        let is_new = self.last.replace(found) != Some(found);
        if missed > 0 {
            missed -= 1;
        } else {
            self.untold += u64::from(is_new);
        }
        missed > 0
    }
}

fn watch(layout: &Layout, folder: &WatchedFolder, switch: &Switch, ended: &Receiver<()>) {
    let mut answers: VecDeque<(Instant, File)> = VecDeque::new();
    let mut seen = SeenMarks { last: look(layout).map(|found| found.is), untold: 0 };
    let mut own_stops = 0_u64;
    while ended.try_recv() == Err(TryRecvError::Empty) {
        if !switch.is_halted() {
            // They were about a stop that is over.
            answers.clear();
        }
        while answers.front().is_some_and(|(since, _)| since.elapsed() > ANSWER_KEPT) {
            answers.pop_front();
        }
        let made = folder.marks_made(layout);
        let found = complete(layout);
        let is_missed = seen.has_missed(made, found.as_ref().map(|found| found.is));
        let why = if is_missed { Some(REMOVED) } else { folder.is_away().then_some(AWAY) };
        if let Some(why) = why.filter(|_| !switch.is_halted()) {
            own_stops += 1;
            let (id, reason) = (format!("watch-{own_stops}"), why.to_owned());
            switch.halt(AskedStop { id, by: BY_ITSELF.to_owned(), reason, caller: caller::own() });
        }
        if let Some(found) = found {
            take(layout, switch, found, &mut answers);
        }
        folder.wait();
    }
}

/// Stops the cell by a mark, and shares its lock.
fn take(layout: &Layout, switch: &Switch, found: FoundMark, answers: &mut VecDeque<(Instant, File)>) {
    let FoundMark { asked, file, .. } = found;
    // A stop that came over the socket as well is one stop. One whose mark was put back after it was let go is another.
    if !switch.knows(&asked.id) || (!switch.is_halted() && is_there(layout)) {
        switch.halt(asked);
    }
    let is_new = |file: &File| !answers.iter().any(|(_, kept)| is_same(kept, file));
    let Some(file) = file.filter(is_new) else { return };
    // It says that the cell is stopped, and nothing else.
    if switch.is_halted() && file.try_lock_shared().is_ok() {
        if answers.len() >= ANSWERS_MAX {
            answers.pop_front();
        }
        answers.push_back((Instant::now(), file));
    }
}

/// As [`look`], once it is written.
fn complete(layout: &Layout) -> Option<FoundMark> {
    let mut found = look(layout)?;
    for _ in 0..WRITTEN_LOOKS {
        if found.clear || found.file.is_none() {
            break;
        }
        std::thread::sleep(WRITTEN_LOOK);
        // One that is taken away meanwhile asked for a stop all the same.
        found = look(layout).unwrap_or(found);
    }
    Some(found)
}

fn is_same(one: &File, other: &File) -> bool {
    let name = |file: &File| file.metadata().ok().map(|found| (found.dev(), found.ino()));
    name(one).is_some() && name(one) == name(other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop_mark::{OwnMark, settle};

    /// A folder, and an engine's watch over it.
    fn watched() -> (tempfile::TempDir, Layout, Arc<Switch>, MarkWatch) {
        let folder = tempfile::tempdir().unwrap();
        let (layout, switch) = (Layout::new(folder.path()), Arc::new(Switch::default()));
        let watch = MarkWatch::start(layout.clone(), Arc::clone(&switch)).unwrap();
        (folder, layout, switch, watch)
    }

    fn wait_for(what: &str, is_so: impl Fn() -> bool) {
        let until = Instant::now() + Duration::from_mins(1);
        while !is_so() {
            assert!(Instant::now() < until, "{what}");
            std::thread::yield_now();
        }
    }

    /// A mark that was linked back after `go` passed for a stop that the engine had taken, and the arm worked on.
    #[test]
    fn a_mark_that_is_put_back_after_the_cell_was_let_go_stops_it_again() {
        let (folder, layout, switch, watch) = watched();
        let own = OwnMark::put(&layout, "a", "ana", "a hand is in the cell").unwrap();
        wait_for("the mark stops the cell", || switch.is_halted());
        let kept = folder.path().join("kept");
        fs::hard_link(layout.stop_asked(), &kept).unwrap();
        settle(&layout, "a");
        assert!(!is_there(&layout), "it is on record");
        assert!(switch.first_asked().is_some_and(|asked| asked.id == "a"));
        wait_for("it is let go", || {
            switch.took_asked();
            switch.release()
        });
        fs::hard_link(&kept, layout.stop_asked()).unwrap();
        wait_for("the same mark stops it again", || switch.is_halted());
        assert!(switch.first_asked().is_some(), "and is asked for");
        drop((watch, own));
    }

    /// A lock that was shared for ten seconds passed for the confirmation of a later stop.
    #[test]
    fn a_lock_is_shared_for_no_stop_that_is_over() {
        let (_folder, layout, switch, watch) = watched();
        let own = OwnMark::put(&layout, "a", "ana", "").unwrap();
        let shares = || own.is_shared_by(i32::try_from(std::process::id()).unwrap());
        wait_for("the lock is shared", shares);
        settle(&layout, "a");
        switch.took_asked();
        assert!(switch.release());
        wait_for("it is shared no more", || !shares());
        drop(watch);
    }

    /// A program that took the mark away within a look defeated the stop.
    #[test]
    fn a_mark_that_is_removed_at_once_stops_the_cell() {
        let (folder, layout, switch, watch) = watched();
        fs::write(folder.path().join("another.file"), "").unwrap();
        for number in 0..50 {
            drop(OwnMark::put(&layout, &format!("stop-{number}"), "ana", "a hand is in the cell").unwrap());
            fs::remove_file(layout.stop_asked()).unwrap();
            wait_for("it stops the cell", || switch.is_halted());
            wait_for("it is let go", || {
                switch.took_asked();
                switch.release()
            });
        }
        drop(watch);
    }

    /// A stop that is taken and settled is one stop, however soon it is settled.
    #[test]
    fn a_mark_that_the_engine_settles_is_no_second_stop() {
        let (_folder, layout, switch, watch) = watched();
        for number in 0..50 {
            let id = format!("stop-{number}");
            let own = OwnMark::put(&layout, &id, "ana", "").unwrap();
            wait_for("it stops the cell", || switch.is_halted());
            settle(&layout, &id);
            switch.took_asked();
            wait_for("the lock is shared", || own.is_shared_by(i32::try_from(std::process::id()).unwrap()));
            assert!(switch.release(), "no second stop waits");
        }
        let until = Instant::now() + 3 * LOOK_EVERY;
        wait_for("some looks later", || Instant::now() > until);
        assert!(!switch.is_halted());
        drop(watch);
    }

    /// Another folder in the place of the store's, with a lock and a mark of its own, passed for it.
    #[test]
    fn an_engine_whose_folder_is_replaced_stops_the_cell() {
        let parent = tempfile::tempdir().unwrap();
        let (store, aside) = (parent.path().join("store"), parent.path().join("aside"));
        fs::create_dir(&store).unwrap();
        let (layout, switch) = (Layout::new(&store), Arc::new(Switch::default()));
        let watch = MarkWatch::start(layout, Arc::clone(&switch)).unwrap();
        fs::rename(&store, &aside).unwrap();
        fs::create_dir(&store).unwrap();
        wait_for("it stops the cell", || switch.is_halted());
        assert!(switch.first_asked().is_some_and(|asked| asked.reason == AWAY));
        drop(watch);
    }
}
