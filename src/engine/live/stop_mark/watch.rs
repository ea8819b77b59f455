//! The engine's watch for marks: a dedicated thread sees a mark, stops the arm, and answers by the mark's lock.

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

use holdpoint_store::Layout;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, WatchFlags};
use rustix::io::Errno;

use super::{StopMarkFile, bring_forward, is_there, look};
use crate::live::stop_switch::{StopRequest, StopSwitch};
use holdpoint_record::caller;
use holdpoint_wording::program::engine::{FOLDER_AWAY, MARK_REMOVED};

/// Interval between checks of the folder.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How many checks without a mark pass between two searches for one that waits.
const BEHIND_EVERY: u32 = 25;

/// How long an incomplete mark may still be being written, in checks of [`WRITTEN_LOOK`].
const WRITTEN_LOOKS: u32 = 10;

/// Time between two checks of an incomplete mark.
const WRITTEN_LOOK: Duration = Duration::from_millis(2);

/// How long the lock of a mark is shared: its maker checks for that at once.
const ANSWER_KEPT: Duration = Duration::from_secs(10);

/// The most marks whose lock is shared at a time.
const ANSWERS_MAX: usize = 8;

/// The author of a stop if no other is known.
const BY_ITSELF: &str = "the engine";

/// Buffer for the kernel's notices of new files in the folder, bytes: some 60 names at a time.
const MADE_BYTES: usize = 4096;

/// Watches the folder for a mark, on a dedicated thread, until it is dropped.
#[derive(Debug)]
pub struct StopMarkWatch {
    /// Dropping it ends the thread.
    end: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl StopMarkWatch {
    /// Watches the folder of a store.
    ///
    /// # Errors
    /// If the system gives no thread, or the folder is not there.
    pub fn start(layout: Layout, switch: Arc<StopSwitch>) -> io::Result<Self> {
        let (end, ended) = sync_channel(0);
        let folder = StopMarkFolder::of(&layout)?;
        let watch = move || watch(&layout, &folder, &switch, &ended);
        let thread = std::thread::Builder::new().name("stop-watch".to_owned()).spawn(watch)?;
        Ok(Self { end: Some(end), thread: Some(thread) })
    }
}

impl Drop for StopMarkWatch {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// The folder in which marks are created.
struct StopMarkFolder {
    path: PathBuf,
    /// Device and inode, which identify the folder under any name.
    is: (u64, u64),
    /// The kernel's notices of new files; absent if the system provides none. Then only checks find marks.
    notices: Option<OwnedFd>,
}

impl StopMarkFolder {
    fn of(layout: &Layout) -> io::Result<Self> {
        // A relative path would move with the working folder.
        let path = std::path::absolute(layout.folder())?;
        let found = fs::metadata(&path)?;
        let notices = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK).ok();
        let made = WatchFlags::CREATE | WatchFlags::MOVED_TO | WatchFlags::ONLYDIR;
        let notices = notices.filter(|notices| inotify::add_watch(notices, &path, made).is_ok());
        Ok(Self { path, is: (found.dev(), found.ino()), notices })
    }

    /// Waits for a new file, or for [`LOOK_EVERY`].
    fn wait(&self) {
        let at_most = Timespec { tv_sec: 0, tv_nsec: i64::from(LOOK_EVERY.subsec_nanos()) };
        let Some(notices) = &self.notices else { return std::thread::sleep(LOOK_EVERY) };
        if poll(&mut [PollFd::new(notices, PollFlags::IN)], Some(&at_most)).is_err() {
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// The number of marks created since the last call, including removed ones.
    fn marks_made(&self, layout: &Layout) -> u64 {
        let Some(notices) = &self.notices else { return 0 };
        let mark = layout.stop_request();
        let is_mark =
            |name: &CStr| mark.file_name().is_some_and(|mark| mark.as_encoded_bytes() == name.to_bytes());
        let mut room = [MaybeUninit::uninit(); MADE_BYTES];
        let mut events = inotify::Reader::new(notices, &mut room);
        let mut made = 0;
        loop {
            match events.next() {
                // After an overflow the kernel does not report the names.
                Ok(event) => {
                    let is_lost = event.events().contains(ReadFlags::QUEUE_OVERFLOW);
                    made += u64::from(is_lost || event.file_name().is_some_and(is_mark));
                }
                Err(Errno::INTR) => {}
                Err(_) => return made,
            }
        }
    }

    /// Whether its name leads to another folder, so that a stop by that name does not reach this engine.
    fn is_away(&self) -> bool {
        !fs::metadata(&self.path).is_ok_and(|found| (found.dev(), found.ino()) == self.is)
    }
}

/// Compares the marks that were seen with those that the kernel reported.
#[derive(Default)]
struct StopMarkTracker {
    /// Device and inode of the last one.
    last: Option<(u64, u64)>,
    /// The number of marks seen that the kernel has not reported yet.
    untold: u64,
}

impl StopMarkTracker {
    /// Whether a mark was created and removed without being seen. `made` were reported, and then `found` was there.
    fn has_missed(&mut self, made: u64, found: Option<(u64, u64)>) -> bool {
        let mut missed = made.saturating_sub(self.untold);
        self.untold = self.untold.saturating_sub(made);
        let Some(found) = found else {
            // A file system gives the next mark the same inode.
            self.last = None;
            return missed > 0;
        };
        let is_new = self.last.replace(found) != Some(found);
        if missed > 0 {
            missed -= 1;
        } else {
            self.untold += u64::from(is_new);
        }
        missed > 0
    }
}

fn watch(layout: &Layout, folder: &StopMarkFolder, switch: &StopSwitch, ended: &Receiver<()>) {
    let mut answers: VecDeque<(Instant, File)> = VecDeque::new();
    let mut seen = StopMarkTracker { last: look(layout).map(|found| found.is), untold: 0 };
    let mut own_stops = 0_u64;
    let mut checks = 0;
    while ended.try_recv() == Err(TryRecvError::Empty) {
        if !switch.is_halted() {
            // They belong to a stop that is over.
            answers.clear();
        }
        while answers.front().is_some_and(|(since, _)| since.elapsed() > ANSWER_KEPT) {
            answers.pop_front();
        }
        let made = folder.marks_made(layout);
        let found = complete(layout);
        let is_missed = seen.has_missed(made, found.as_ref().map(|found| found.is));
        let why = if is_missed { Some(MARK_REMOVED) } else { folder.is_away().then_some(FOLDER_AWAY) };
        if let Some(why) = why.filter(|_| !switch.is_halted()) {
            own_stops += 1;
            let (id, reason) = (format!("watch-{own_stops}"), why.to_owned());
            switch.halt(StopRequest { id, by: BY_ITSELF.to_owned(), reason, caller: caller::own() });
        }
        if let Some(found) = found {
            take(layout, switch, found, &mut answers);
        } else {
            if checks == 0 {
                bring_forward(layout);
            }
            checks = (checks + 1) % BEHIND_EVERY;
        }
        folder.wait();
    }
}

/// Stops the cell by a mark, and shares its lock.
fn take(layout: &Layout, switch: &StopSwitch, found: StopMarkFile, answers: &mut VecDeque<(Instant, File)>) {
    let StopMarkFile { request, file, .. } = found;
    // A stop over the socket with the same id is the same stop. A mark that returns after the start is another one.
    if !switch.knows(&request.id) || (!switch.is_halted() && is_there(layout)) {
        switch.halt(request);
    }
    let is_new = |file: &File| !answers.iter().any(|(_, other)| is_same(other, file));
    let Some(file) = file.filter(is_new) else { return };
    // It means that the cell is stopped, and nothing else.
    if switch.is_halted() && file.try_lock_shared().is_ok() {
        if answers.len() >= ANSWERS_MAX {
            answers.pop_front();
        }
        answers.push_back((Instant::now(), file));
    }
}

/// As [`look`], once it is complete.
fn complete(layout: &Layout) -> Option<StopMarkFile> {
    let mut found = look(layout)?;
    for _ in 0..WRITTEN_LOOKS {
        if found.clear || found.file.is_none() {
            break;
        }
        std::thread::sleep(WRITTEN_LOOK);
        // A mark removed meanwhile still requested a stop.
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
    use crate::live::stop_mark::{OwnStopMark, requested_at, settle};

    /// A folder, and an engine's watch over it.
    fn watched() -> (tempfile::TempDir, Layout, Arc<StopSwitch>, StopMarkWatch) {
        let folder = tempfile::tempdir().unwrap();
        let (layout, switch) = (Layout::new(folder.path()), Arc::new(StopSwitch::default()));
        let watch = StopMarkWatch::start(layout.clone(), Arc::clone(&switch)).unwrap();
        (folder, layout, switch, watch)
    }

    fn wait_for(what: &str, is_so: impl Fn() -> bool) {
        let until = Instant::now() + Duration::from_mins(1);
        while !is_so() {
            assert!(Instant::now() < until, "{what}");
            std::thread::yield_now();
        }
    }

    /// A mark linked again after `go` counted as a stop that the engine had taken, and the arm kept moving.
    #[test]
    fn a_mark_restored_after_a_start_stops_the_cell_again() {
        let (folder, layout, switch, watch) = watched();
        let own = OwnStopMark::put(&layout, "a", "ana", "a hand is in the cell").unwrap();
        wait_for("the mark stops the cell", || switch.is_halted());
        let link = folder.path().join("kept");
        fs::hard_link(layout.stop_request(), &link).unwrap();
        settle(&layout, "a");
        assert!(!is_there(&layout), "it is on record");
        assert!(switch.first_stop().is_some_and(|request| request.id == "a"));
        wait_for("it is let go", || {
            switch.pop_stop();
            switch.release()
        });
        fs::hard_link(&link, layout.stop_request()).unwrap();
        wait_for("the same mark stops it again", || switch.is_halted());
        assert!(switch.first_stop().is_some(), "and is asked for");
        drop((watch, own));
    }

    /// Of two stops of an engine that did not answer, the second one was lost.
    #[test]
    fn a_mark_behind_another_one_is_taken_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let (layout, switch) = (Layout::new(folder.path()), Arc::new(StopSwitch::default()));
        let first = OwnStopMark::put(&layout, "a", "ana", "").unwrap();
        assert!(OwnStopMark::put(&layout, "b", "bo", "").is_err());
        let second = OwnStopMark::put_behind(&layout, "b", "bo", "a person is inside").unwrap();
        let watch = StopMarkWatch::start(layout.clone(), Arc::clone(&switch)).unwrap();
        let takes = |id: &str| switch.first_stop().is_some_and(|request| request.id == id);
        wait_for("the first one is taken", || takes("a"));
        settle(&layout, "a");
        assert!(!requested_at(&layout).is_empty(), "the second one waits");
        switch.pop_stop();
        wait_for("the second one is taken", || takes("b"));
        assert!(switch.first_stop().is_some_and(|request| request.by == "bo"));
        settle(&layout, "b");
        assert!(requested_at(&layout).is_empty());
        drop((watch, first, second));
    }

    /// A folder could not be linked in the place of the mark, and all behind it waited for ever. A mark was lost if another
    /// process of the same number had one there.
    #[test]
    fn everything_that_waits_behind_a_mark_has_its_turn() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        let old = folder.path().join("stop.asked.old");
        fs::create_dir(&old).unwrap();
        assert_eq!(requested_at(&layout), [old], "the path of what is there");
        let _waiting = ["bo", "cy"].map(|by| OwnStopMark::put_behind(&layout, by, by, "").unwrap());
        let again = OwnStopMark::put_behind(&layout, "again", "cy", "").unwrap_err();
        assert_eq!(again.kind(), io::ErrorKind::AlreadyExists);
        let mut taken: Vec<String> = Vec::new();
        for _ in 0..3 {
            bring_forward(&layout);
            let StopRequest { id, by, .. } = look(&layout).unwrap().request;
            taken.push(by);
            settle(&layout, &id);
        }
        taken.sort();
        assert_eq!(taken, ["", "bo", "cy"]);
        assert!(requested_at(&layout).is_empty());
    }

    /// A lock shared for ten seconds counted as the confirmation of a later stop.
    #[test]
    fn lock_is_not_shared_for_an_ended_stop() {
        let (_folder, layout, switch, watch) = watched();
        let own = OwnStopMark::put(&layout, "a", "ana", "").unwrap();
        let shares = || own.is_shared_by(i32::try_from(std::process::id()).unwrap());
        wait_for("the lock is shared", shares);
        settle(&layout, "a");
        switch.pop_stop();
        assert!(switch.release());
        wait_for("it is shared no more", || !shares());
        drop(watch);
    }

    /// A program that removed the mark between two checks defeated the stop.
    #[test]
    fn a_mark_that_is_removed_at_once_stops_the_cell() {
        let (folder, layout, switch, watch) = watched();
        fs::write(folder.path().join("another.file"), "").unwrap();
        for number in 0..50 {
            drop(
                OwnStopMark::put(&layout, &format!("stop-{number}"), "ana", "a hand is in the cell").unwrap(),
            );
            fs::remove_file(layout.stop_request()).unwrap();
            wait_for("it stops the cell", || switch.is_halted());
            wait_for("it is let go", || {
                switch.pop_stop();
                switch.release()
            });
        }
        drop(watch);
    }

    /// The second mark with an inode counted as one that was removed unseen.
    #[test]
    fn mark_with_the_inode_of_the_last_one_is_a_new_mark() {
        let mut seen = StopMarkTracker::default();
        let reported = [(0, true), (1, false), (0, true), (1, false)];
        let missed = reported.map(|(made, is_there)| seen.has_missed(made, is_there.then_some((1, 7))));
        assert_eq!(missed, [false; 4]);
        assert!(seen.has_missed(1, None), "a mark that nothing has seen");
    }

    /// A stop that is taken and settled is one stop, however soon it is settled.
    #[test]
    fn settled_stop_mark_is_no_second_stop() {
        let (_folder, layout, switch, watch) = watched();
        for number in 0..50 {
            let id = format!("stop-{number}");
            let own = OwnStopMark::put(&layout, &id, "ana", "").unwrap();
            wait_for("it stops the cell", || switch.is_halted());
            settle(&layout, &id);
            switch.pop_stop();
            wait_for("the lock is shared", || own.is_shared_by(i32::try_from(std::process::id()).unwrap()));
            assert!(switch.release(), "no second stop waits");
        }
        let until = Instant::now() + 3 * LOOK_EVERY;
        wait_for("some looks later", || Instant::now() > until);
        assert!(!switch.is_halted());
        drop(watch);
    }

    /// Another folder in place of the store's, with its own lock and mark, was accepted.
    #[test]
    fn an_engine_whose_folder_is_replaced_stops_the_cell() {
        let parent = tempfile::tempdir().unwrap();
        let (store, aside) = (parent.path().join("store"), parent.path().join("aside"));
        fs::create_dir(&store).unwrap();
        let (layout, switch) = (Layout::new(&store), Arc::new(StopSwitch::default()));
        let watch = StopMarkWatch::start(layout, Arc::clone(&switch)).unwrap();
        fs::rename(&store, &aside).unwrap();
        fs::create_dir(&store).unwrap();
        wait_for("it stops the cell", || switch.is_halted());
        assert!(switch.first_stop().is_some_and(|request| request.reason == FOLDER_AWAY));
        drop(watch);
    }
}
