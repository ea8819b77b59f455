//! The engine's side of the queue: it hands items over and never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::Film;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;

/// The most pending items.
pub const QUEUE_MAX: usize = 8_192;

/// The most video frames among them. The rest of the queue is for items that are rarer and matter more.
pub const FRAMES_WAITING_MAX: usize = 6_144;

/// An item of the queue.
#[derive(Debug)]
pub enum FeedItem {
    /// A frame of the live cell.
    Frame(Box<VideoFrame>),
    /// Events, in order, and the snapshot after them if one of them changes a chart.
    Events(Vec<Event>, Option<Box<Snapshot>>),
    /// A re-run part of a version's evaluation.
    Film(CapabilityId, Box<Film>),
    /// Serve a live viewer at this address from now on.
    Serve(std::net::SocketAddr),
    /// Write pending rows, complete every file, and stop.
    End,
}

/// Items that were dropped because the queue was full.
#[derive(Debug, Default)]
pub struct DropCounts {
    pub frames: AtomicU64,
    pub events: AtomicU64,
}

impl DropCounts {
    /// Video frames and events dropped so far.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        (self.frames.load(Ordering::Relaxed), self.events.load(Ordering::Relaxed))
    }
}

/// Hands items over to the sink. Clones share one queue.
#[derive(Clone, Debug)]
pub struct Feed {
    queue: SyncSender<FeedItem>,
    waiting: Arc<AtomicUsize>,
    dropped: Arc<DropCounts>,
}

#[derive(Debug)]
pub struct FeedReceiver {
    queue: Receiver<FeedItem>,
    waiting: Arc<AtomicUsize>,
    /// The feed's dropped items.
    pub dropped: Arc<DropCounts>,
}

/// A feed and the sink's side of it.
#[must_use]
pub fn queue() -> (Feed, FeedReceiver) {
    let (sender, receiver) = sync_channel(QUEUE_MAX);
    let waiting = Arc::new(AtomicUsize::new(0));
    let dropped = Arc::new(DropCounts::default());
    let feed = Feed { queue: sender, waiting: Arc::clone(&waiting), dropped: Arc::clone(&dropped) };
    (feed, FeedReceiver { queue: receiver, waiting, dropped })
}

impl Feed {
    /// Hands over a video frame; drops it if too many are pending or the sink has ended.
    pub fn video_frame(&self, frame: VideoFrame) {
        let take = |count: usize| (count < FRAMES_WAITING_MAX).then_some(count + 1);
        let room = self.waiting.fetch_update(Ordering::AcqRel, Ordering::Acquire, take).is_ok();
        if room && self.queue.try_send(FeedItem::Frame(Box::new(frame))).is_ok() {
            return;
        }
        if room {
            self.waiting.fetch_sub(1, Ordering::AcqRel);
        }
        self.dropped.frames.fetch_add(1, Ordering::Relaxed);
    }

    /// Hands over events, with the snapshot if one of them changes a chart. `snapshot` is called at most once.
    pub fn events(&self, events: &[Event], snapshot: impl FnOnce() -> Snapshot) {
        if events.is_empty() {
            return;
        }
        let shown = events.iter().any(|event| changes_a_chart(&event.kind)).then(|| Box::new(snapshot()));
        if self.queue.try_send(FeedItem::Events(events.to_vec(), shown)).is_err() {
            self.dropped.events.fetch_add(events.len() as u64, Ordering::Relaxed);
        }
    }

    /// Hands over a part of an evaluation; drops it if the queue is full, and counts each of its video frames.
    pub fn film(&self, version: &CapabilityId, film: &Film) {
        let item = FeedItem::Film(version.clone(), Box::new(film.clone()));
        if self.queue.try_send(item).is_err() {
            let frames = film.candidate.frames.len().max(film.active.frames.len());
            self.dropped.frames.fetch_add(frames as u64, Ordering::Relaxed);
        }
    }

    /// Requests a live viewer's address. Returns whether the queue took the request.
    #[must_use]
    pub fn serve(&self, address: std::net::SocketAddr) -> bool {
        self.queue.try_send(FeedItem::Serve(address)).is_ok()
    }

    /// Ends the sink after the pending items. Returns whether the queue took the request; the caller asks a full queue
    /// again.
    #[must_use]
    pub fn end(&self) -> bool {
        self.queue.try_send(FeedItem::End).is_ok()
    }

    /// Video frames and events dropped so far.
    #[must_use]
    pub fn dropped(&self) -> (u64, u64) {
        self.dropped.counts()
    }
}

impl FeedReceiver {
    /// The next item; `None` after `patience` without one.
    ///
    /// # Errors
    /// If every feed is gone.
    pub fn next(&self, patience: std::time::Duration) -> Result<Option<FeedItem>, FeedsClosed> {
        match self.queue.recv_timeout(patience) {
            Ok(item) => {
                if matches!(item, FeedItem::Frame(_)) {
                    self.waiting.fetch_sub(1, Ordering::AcqRel);
                }
                Ok(Some(item))
            }
            Err(std::sync::mpsc::RecvTimeoutError::Timeout) => Ok(None),
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => Err(FeedsClosed),
        }
    }
}

/// Every feed is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("every feed is gone")]
pub struct FeedsClosed;

/// Whether a snapshot after the event shows another chart than one before it.
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
