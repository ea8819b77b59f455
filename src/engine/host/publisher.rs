//! The engine's side of a host's channels: events that may be lost, answers that may not, the newest snapshot.
//!
//! Never waits for the front end.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, watch};

use super::update::{OUTSTANDING_MAX, Update};
use crate::Engine;
use crate::door::Seats;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::snapshot::Snapshot;

/// Least time between two snapshots, but for those after an answer.
const SNAPSHOT_EVERY: Duration = Duration::from_millis(50);

/// Most time between two snapshots: deadlines are counted down from their time.
const SNAPSHOT_AT_LEAST: Duration = Duration::from_secs(1);

/// The engine's side of the channels.
pub(super) struct Publisher {
    updates: mpsc::Sender<Update>,
    snapshot: watch::Sender<Option<Arc<Snapshot>>>,
    outstanding: Arc<AtomicUsize>,
    answers: VecDeque<(String, Reply)>,
    missed: u64,
    changed: bool,
    published: Option<Instant>,
    /// Who looks at the engine.
    seats: Arc<Seats>,
}

impl Publisher {
    pub(super) fn new(
        updates: mpsc::Sender<Update>,
        snapshot: watch::Sender<Option<Arc<Snapshot>>>,
        outstanding: Arc<AtomicUsize>,
    ) -> Self {
        let answers = VecDeque::new();
        let seats = Arc::default();
        Self { updates, snapshot, outstanding, answers, missed: 0, changed: true, published: None, seats }
    }

    /// There is a book of who looks.
    pub(super) fn seat(&mut self, seats: Arc<Seats>) {
        self.seats = seats;
    }

    /// Who looks at the engine.
    pub(super) fn seats(&self) -> Arc<Seats> {
        Arc::clone(&self.seats)
    }

    /// Something changed, so that a snapshot is due.
    pub(super) const fn note_change(&mut self) {
        self.changed = true;
    }

    /// Tells something that is neither an event nor an answer. Room for it is kept.
    pub(super) fn say(&self, update: Update) {
        // Nobody may be left to be told.
        drop(self.updates.try_send(update));
    }

    /// Tells events; those that do not fit are counted. Room for every answer is kept.
    pub(super) fn tell(&mut self, events: Vec<Event>) {
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
        if self.updates.try_send(Update::Events(events)).is_err() {
            self.missed = self.missed.saturating_add(count);
        }
    }

    fn tell_missed(&mut self) {
        if self.missed > 0
            && self.updates.capacity() > OUTSTANDING_MAX
            && self.updates.try_send(Update::Lagged { missed: self.missed }).is_ok()
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

    /// Sends what waits. An answer that does not fit yet waits here; there are never more than were asked for.
    pub(super) fn flush(&mut self) {
        while let Some((id, reply)) = self.answers.pop_front() {
            match self.updates.try_send(Update::Answer { id, reply }) {
                Ok(()) => {
                    self.outstanding.fetch_sub(1, Ordering::AcqRel);
                }
                Err(mpsc::error::TrySendError::Full(Update::Answer { id, reply })) => {
                    self.answers.push_front((id, reply));
                    break;
                }
                Err(_) => break,
            }
        }
        self.tell_missed();
    }

    /// Publishes a snapshot if something changed, at most some twenty a second and at least one.
    pub(super) fn publish(&mut self, engine: &Engine) {
        self.changed |= self.seats.take_change();
        let due = self.published.is_none_or(|published| published.elapsed() >= SNAPSHOT_EVERY);
        let old = self.published.is_some_and(|published| published.elapsed() >= SNAPSHOT_AT_LEAST);
        if old || (self.changed && due) {
            let mut snapshot = engine.snapshot();
            self.seats.show_in(&mut snapshot);
            self.snapshot.send_replace(Some(Arc::new(snapshot)));
            self.changed = false;
            self.published = Some(Instant::now());
        }
    }

    /// Shows how things stand before there is an engine.
    pub(super) fn show(&mut self, taken: impl FnOnce() -> Snapshot) {
        if self.published.is_none_or(|published| published.elapsed() >= SNAPSHOT_EVERY) {
            let mut snapshot = taken();
            self.seats.show_in(&mut snapshot);
            self.snapshot.send_replace(Some(Arc::new(snapshot)));
            self.published = Some(Instant::now());
        }
    }

    /// What was shown does not hold.
    pub(super) fn withdraw(&self) {
        self.snapshot.send_replace(None);
    }

    /// Nobody looks any more.
    pub(super) fn is_lost(&self) -> bool {
        self.updates.is_closed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::host::UPDATES_MAX;
    use holdpoint_protocol::command::Refusal;
    use holdpoint_protocol::event::EventKind;

    fn publisher() -> (Publisher, mpsc::Receiver<Update>) {
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
    fn a_slow_reader_loses_events_and_no_answer() {
        let (mut publisher, mut receiver) = publisher();
        for seq in 0..1_000 {
            publisher.tell(vec![event(seq)]);
        }
        for id in 0..OUTSTANDING_MAX {
            publisher.answer(id.to_string(), no());
        }
        publisher.tell(vec![event(1_000)]);
        let (mut events, mut answers, mut missed) = (0, 0, 0);
        for _ in 0..2 {
            while let Ok(update) = receiver.try_recv() {
                match update {
                    Update::Events(some) => events += some.len() as u64,
                    Update::Answer { .. } => answers += 1,
                    Update::Lagged { missed: some } => missed += some,
                    Update::Started | Update::Past { .. } | Update::Returned(_) | Update::Ended(_) => {}
                }
            }
            publisher.flush();
        }
        while let Ok(Update::Lagged { missed: some }) = receiver.try_recv() {
            missed += some;
        }
        assert_eq!(answers, OUTSTANDING_MAX);
        assert_eq!(events + missed, 1_001);
        assert!(missed > 0);
        assert_eq!(publisher.outstanding.load(Ordering::Acquire), 0);
    }
}
