//! The engine's side of a host's channels: events that may be lost, answers that may not, the newest snapshot.
//!
//! Never waits for the front end.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use super::update::{EngineUpdate, OUTSTANDING_MAX};
use crate::control_socket::ConsoleRegistry;
use holdpoint_engine::Engine;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::snapshot::Snapshot;

/// Shortest time between two snapshots, except those after an answer.
const SNAPSHOT_EVERY: Duration = Duration::from_millis(50);

/// Longest time between two snapshots: deadlines count down from their time.
const SNAPSHOT_AT_LEAST: Duration = Duration::from_secs(1);

/// The engine's side of the channels.
pub(super) struct Publisher {
    updates: mpsc::Sender<EngineUpdate>,
    snapshot: watch::Sender<Option<Arc<Snapshot>>>,
    outstanding: Arc<AtomicUsize>,
    answers: VecDeque<(String, Reply)>,
    missed: u64,
    changed: bool,
    published: Option<Instant>,
    consoles: Arc<ConsoleRegistry>,
}

impl Publisher {
    pub(super) fn new(
        updates: mpsc::Sender<EngineUpdate>,
        snapshot: watch::Sender<Option<Arc<Snapshot>>>,
        outstanding: Arc<AtomicUsize>,
    ) -> Self {
        let (answers, consoles) = (VecDeque::new(), Arc::default());
        Self { updates, snapshot, outstanding, answers, missed: 0, changed: true, published: None, consoles }
    }

    pub(super) fn set_consoles(&mut self, seats: Arc<ConsoleRegistry>) {
        self.consoles = seats;
    }

    pub(super) fn seats(&self) -> Arc<ConsoleRegistry> {
        Arc::clone(&self.consoles)
    }

    /// Marks a change, so that a snapshot is due.
    pub(super) const fn note_change(&mut self) {
        self.changed = true;
    }

    /// Sends an update that is neither an event nor an answer, for which there is always room.
    pub(super) fn send_update(&self, update: EngineUpdate) {
        // The receiver may be gone.
        drop(self.updates.try_send(update));
    }

    /// Sends events and counts those that do not fit. There is always room for every answer.
    pub(super) fn send_events(&mut self, events: Vec<Event>) {
        if events.is_empty() {
            return;
        }
        self.changed = true;
        let count = events.len() as u64;
        if self.updates.capacity() <= OUTSTANDING_MAX + 2 {
            self.missed = self.missed.saturating_add(count);
            return;
        }
        self.tell_missed();
        if self.updates.try_send(EngineUpdate::Events(events)).is_err() {
            self.missed = self.missed.saturating_add(count);
        }
    }

    fn tell_missed(&mut self) {
        if self.missed > 0
            && self.updates.capacity() > OUTSTANDING_MAX
            && self.updates.try_send(EngineUpdate::Lagged { missed: self.missed }).is_ok()
        {
            self.missed = 0;
        }
    }

    pub(super) fn answer(&mut self, id: String, reply: Reply) {
        self.changed = true;
        self.published = None;
        self.answers.push_back((id, reply));
        self.flush();
    }

    /// Sends waiting answers. An answer that does not fit waits here; there are at most as many as requests.
    pub(super) fn flush(&mut self) {
        while let Some((id, reply)) = self.answers.pop_front() {
            match self.updates.try_send(EngineUpdate::Answer { id, reply }) {
                Ok(()) => {
                    self.outstanding.fetch_sub(1, Ordering::AcqRel);
                }
                Err(mpsc::error::TrySendError::Full(EngineUpdate::Answer { id, reply })) => {
                    self.answers.push_front((id, reply));
                    break;
                }
                Err(_) => break,
            }
        }
        self.tell_missed();
    }

    /// Publishes a snapshot after a change, at most some twenty per second, and at least one per second.
    pub(super) fn publish(&mut self, engine: &Engine) {
        self.changed |= self.consoles.take_change();
        let due = self.published.is_none_or(|published| published.elapsed() >= SNAPSHOT_EVERY);
        let old = self.published.is_some_and(|published| published.elapsed() >= SNAPSHOT_AT_LEAST);
        if old || (self.changed && due) {
            self.send_snapshot(engine.snapshot());
            self.changed = false;
        }
    }

    /// Shows the state before the engine is up.
    pub(super) fn show(&mut self, taken: impl FnOnce() -> Snapshot) {
        if self.published.is_none_or(|published| published.elapsed() >= SNAPSHOT_EVERY) {
            self.send_snapshot(taken());
        }
    }

    fn send_snapshot(&mut self, mut snapshot: Snapshot) {
        self.consoles.show_in(&mut snapshot);
        self.snapshot.send_replace(Some(Arc::new(snapshot)));
        self.published = Some(Instant::now());
    }

    /// Withdraws the state shown so far.
    pub(super) fn withdraw(&self) {
        self.snapshot.send_replace(None);
    }

    /// Whether no receiver is left.
    pub(super) fn is_lost(&self) -> bool {
        self.updates.is_closed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine_handle::UPDATES_MAX;
    use holdpoint_protocol::command::Refusal;
    use holdpoint_protocol::event::EventKind;

    fn publisher() -> (Publisher, mpsc::Receiver<EngineUpdate>) {
        let (updates, receiver) = mpsc::channel(UPDATES_MAX);
        let outstanding = Arc::new(AtomicUsize::new(OUTSTANDING_MAX));
        let publisher = Publisher::new(updates, watch::channel(None).0, outstanding);
        (publisher, receiver)
    }

    fn no() -> Reply {
        Reply::Refused { code: Refusal::NotNow, text: "test".to_owned(), hint: None }
    }

    fn event(seq: u64) -> Event {
        Event { seq, at_ms: 0, kind: EventKind::Fault { text: "test".to_owned() } }
    }

    #[test]
    fn slow_reader_loses_events_but_no_answer() {
        let (mut publisher, mut receiver) = publisher();
        for seq in 0..1_000 {
            publisher.send_events(vec![event(seq)]);
        }
        for id in 0..OUTSTANDING_MAX {
            publisher.answer(id.to_string(), no());
        }
        publisher.send_events(vec![event(1_000)]);
        let (mut events, mut answers, mut missed) = (0, 0, 0);
        for _ in 0..2 {
            while let Ok(update) = receiver.try_recv() {
                match update {
                    EngineUpdate::Events(some) => events += some.len() as u64,
                    EngineUpdate::Answer { .. } => answers += 1,
                    EngineUpdate::Lagged { missed: some } => missed += some,
                    EngineUpdate::Started
                    | EngineUpdate::Past { .. }
                    | EngineUpdate::Returned(_)
                    | EngineUpdate::Ended(_) => {}
                }
            }
            publisher.flush();
        }
        while let Ok(EngineUpdate::Lagged { missed: some }) = receiver.try_recv() {
            missed += some;
        }
        assert_eq!(answers, OUTSTANDING_MAX);
        assert_eq!(events + missed, 1_001);
        assert!(missed > 0);
        assert_eq!(publisher.outstanding.load(Ordering::Acquire), 0);
    }
}
