//! The engine's side of the queue: hands over and never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::Film;
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::snapshot::Snapshot;

/// The most items that wait.
pub const QUEUE_MAX: usize = 8_192;

/// The most pictures among them: room for what is rarer and says more is kept.
pub const PICTURES_WAITING_MAX: usize = 6_144;

/// What is handed over.
#[derive(Debug)]
pub enum Item {
    /// A moment of the live cell.
    Picture(Box<Picture>),
    /// Things that happened, in order, and how things stood after them if one of them changes a chart.
    Events(Vec<Event>, Option<Box<Snapshot>>),
    /// A piece of a version's evaluation, worked again.
    Film(CapabilityId, Box<Film>),
    /// Serve a live viewer at this address from now on.
    Serve(std::net::SocketAddr),
    /// Write what waits, end every file in good order, and stop.
    End,
}

/// What was dropped because the queue was full.
#[derive(Debug, Default)]
pub struct Dropped {
    pub pictures: AtomicU64,
    pub events: AtomicU64,
}

impl Dropped {
    /// Pictures and events that were dropped so far.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        (self.pictures.load(Ordering::Relaxed), self.events.load(Ordering::Relaxed))
    }
}

/// Hands over to the sink. Clones share one queue.
#[derive(Clone, Debug)]
pub struct Feed {
    queue: SyncSender<Item>,
    waiting: Arc<AtomicUsize>,
    dropped: Arc<Dropped>,
}

#[derive(Debug)]
pub struct Drain {
    queue: Receiver<Item>,
    waiting: Arc<AtomicUsize>,
    /// What the feed dropped.
    pub dropped: Arc<Dropped>,
}

/// A feed and the sink's side of it.
#[must_use]
pub fn queue() -> (Feed, Drain) {
    let (sender, receiver) = sync_channel(QUEUE_MAX);
    let waiting = Arc::new(AtomicUsize::new(0));
    let dropped = Arc::new(Dropped::default());
    let feed = Feed { queue: sender, waiting: Arc::clone(&waiting), dropped: Arc::clone(&dropped) };
    (feed, Drain { queue: receiver, waiting, dropped })
}

impl Feed {
    /// A picture; dropped if too many wait, or if the sink has ended.
    pub fn picture(&self, picture: Picture) {
        let take = |count: usize| (count < PICTURES_WAITING_MAX).then_some(count + 1);
        let room = self.waiting.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).is_ok();
        if room && self.queue.try_send(Item::Picture(Box::new(picture))).is_ok() {
            return;
        }
        if room {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
        self.dropped.pictures.fetch_add(1, Ordering::Relaxed);
    }

    /// Events, with how things stand if one of them changes a chart. `snapshot` is called at most once.
    pub fn events(&self, events: &[Event], snapshot: impl FnOnce() -> Snapshot) {
        if events.is_empty() {
            return;
        }
        let shown = events.iter().any(|event| changes_a_chart(&event.kind)).then(|| Box::new(snapshot()));
        if self.queue.try_send(Item::Events(events.to_vec(), shown)).is_err() {
            self.dropped.events.fetch_add(events.len() as u64, Ordering::Relaxed);
        }
    }

    /// A piece of an evaluation; dropped if the queue is full, as so many pictures.
    pub fn film(&self, version: &CapabilityId, film: &Film) {
        let item = Item::Film(version.clone(), Box::new(film.clone()));
        if self.queue.try_send(item).is_err() {
            let pictures = film.candidate.frames.len().max(film.active.frames.len());
            self.dropped.pictures.fetch_add(pictures as u64, Ordering::Relaxed);
        }
    }

    /// Asks for a live viewer's address. Tells whether that was taken.
    #[must_use]
    pub fn serve(&self, address: std::net::SocketAddr) -> bool {
        self.queue.try_send(Item::Serve(address)).is_ok()
    }

    /// Ends the sink after what waits. Tells whether that was taken; a full queue is asked again.
    #[must_use]
    pub fn end(&self) -> bool {
        self.queue.try_send(Item::End).is_ok()
    }

    /// Pictures and events that were dropped so far.
    #[must_use]
    pub fn dropped(&self) -> (u64, u64) {
        self.dropped.counts()
    }
}

impl Drain {
    /// The next item; `None` after `patience` without one.
    ///
    /// # Errors
    /// If every feed is gone.
    pub fn next(&self, patience: std::time::Duration) -> Result<Option<Item>, Gone> {
        match self.queue.recv_timeout(patience) {
            Ok(item) => {
                if matches!(item, Item::Picture(_)) {
                    self.waiting.fetch_sub(1, Ordering::AcqRel);
                }
                Ok(Some(item))
            }
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => Ok(None),
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => Err(Gone),
        }
    }
}

/// Every feed is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("nobody hands anything over any more")]
pub struct Gone;

/// Whether a snapshot after it shows another chart than one before it.
const fn changes_a_chart(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::Progress { .. }
            | EventKind::Decided { .. }
            | EventKind::Sequence { .. }
            | EventKind::Monitor { .. }
            | EventKind::StageStarted { .. }
            | EventKind::Registered { .. }
            | EventKind::EngineStarted { .. }
    )
}
