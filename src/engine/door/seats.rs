//! Who looks at the engine: a book that every console signs by sitting down and leaves by going. Grants nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use holdpoint_protocol::seat::{SeatView, Sitting};
use holdpoint_protocol::snapshot::Snapshot;

/// The seats there are.
#[derive(Debug, Default)]
pub struct Seats(Mutex<Book>);

#[derive(Debug, Default)]
struct Book {
    next: u64,
    taken: BTreeMap<u64, SeatView>,
    changed: bool,
    /// Who ends the engine, in words, once somebody does.
    ending: Option<String>,
    /// Why the engine did not come up, once that is known.
    failure: Option<String>,
    /// For how long the engine works with nobody; absent if it does so for ever.
    alone_max: Option<Duration>,
    /// Since when nobody sits; absent while somebody does.
    alone_since: Option<Instant>,
}

/// A seat that is taken as long as this lives.
#[derive(Debug)]
pub struct Seat {
    seats: Arc<Seats>,
    number: u64,
}

impl Seats {
    fn book(&self) -> MutexGuard<'_, Book> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Somebody sits down.
    #[must_use]
    pub fn sit(self: &Arc<Self>, process: Option<u32>, sitting: Sitting) -> Seat {
        let mut book = self.book();
        book.next += 1;
        let number = book.next;
        book.taken.insert(number, SeatView { seat: number, process, sitting, not_reading: false });
        book.changed = true;
        book.alone_since = None;
        drop(book);
        Seat { seats: Arc::clone(self), number }
    }

    /// Everybody who sits, in the order of sitting down.
    #[must_use]
    pub fn views(&self) -> Vec<SeatView> {
        self.book().taken.values().cloned().collect()
    }

    /// Somebody ends the engine: what whoever sits here is told at its end. The first one counts.
    pub fn note_ending(&self, by: impl FnOnce() -> String) {
        if self.ending().is_none() {
            // It may look into this book.
            let by = by();
            self.book().ending.get_or_insert(by);
        }
    }

    /// Who ends the engine; absent as long as nobody does.
    #[must_use]
    pub fn ending(&self) -> Option<String> {
        self.book().ending.clone()
    }

    /// The engine does not come up, which whoever sits here is told.
    pub fn note_failure(&self, why: String) {
        self.book().failure.get_or_insert(why);
    }

    /// Why the engine did not come up; absent as long as it may.
    #[must_use]
    pub fn failure(&self) -> Option<String> {
        self.book().failure.clone()
    }

    /// From now on the engine ends once nobody has sat at it for so long.
    pub fn end_alone_after(&self, alone_max: Duration) {
        let mut book = self.book();
        book.alone_max = Some(alone_max);
        book.alone_since = book.taken.is_empty().then(Instant::now);
    }

    /// The engine goes on with nobody.
    pub fn keep(&self) {
        let mut book = self.book();
        book.alone_max = None;
        book.changed = true;
    }

    /// For how long nobody has sat at it, once that is too long.
    #[must_use]
    pub fn left_alone(&self) -> Option<Duration> {
        let book = self.book();
        let alone = book.alone_since?.elapsed();
        book.alone_max.is_some_and(|alone_max| alone >= alone_max).then_some(alone)
    }

    /// Puts into a snapshot what this book knows.
    pub fn show_in(&self, snapshot: &mut Snapshot) {
        let book = self.book();
        snapshot.seats = book.taken.values().cloned().collect();
        snapshot.ends_alone_s = book.alone_max.map(|alone_max| alone_max.as_secs());
    }

    /// Who sits in a process, in words.
    #[must_use]
    pub fn named(&self, process: u32) -> Option<String> {
        let book = self.book();
        let seat = book.taken.values().find(|one| one.process == Some(process))?;
        Some(seat.sitting.who.clone().unwrap_or_else(|| format!("seat {}", seat.seat)))
    }

    /// Whether something changed since this was asked last.
    pub(crate) fn take_change(&self) -> bool {
        std::mem::take(&mut self.book().changed)
    }
}

impl Seat {
    /// Its number.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Whether whoever sits there takes what is shown.
    pub fn reads(&self, reads: bool) {
        let mut book = self.seats.book();
        let Some(view) = book.taken.get_mut(&self.number) else { return };
        if view.not_reading == reads {
            view.not_reading = !reads;
            book.changed = true;
        }
    }

    /// Whoever sits there has something else before them.
    pub fn say(&self, sitting: Sitting) {
        let mut book = self.seats.book();
        let Some(view) = book.taken.get_mut(&self.number) else { return };
        if view.sitting != sitting {
            view.sitting = sitting;
            book.changed = true;
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut book = self.seats.book();
        book.taken.remove(&self.number);
        book.changed = true;
        if book.taken.is_empty() {
            book.alone_since = Some(Instant::now());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_goes_is_off_the_book_and_no_number_comes_twice() {
        let seats = Arc::new(Seats::default());
        let sitting = |view: &str| Sitting { view: view.to_owned(), ..Sitting::default() };
        let (ana, bert) = (seats.sit(Some(1), sitting("overview")), seats.sit(None, sitting("audit")));
        assert!(seats.take_change() && !seats.take_change());
        ana.say(sitting("overview"));
        assert!(!seats.take_change(), "nothing new was said");
        bert.say(sitting("approvals"));
        assert!(seats.take_change());
        let views = |seats: &Seats| -> Vec<(u64, String)> {
            seats.views().into_iter().map(|one| (one.seat, one.sitting.view)).collect()
        };
        assert_eq!(views(&seats), [(1, "overview".to_owned()), (2, "approvals".to_owned())]);
        drop(ana);
        let carl = seats.sit(Some(3), sitting("robot"));
        assert_eq!((carl.number(), views(&seats).len()), (3, 2));
    }

    #[test]
    fn an_engine_that_nobody_sits_at_any_more_is_left_alone() {
        let seats = Arc::new(Seats::default());
        assert_eq!(seats.left_alone(), None, "one that goes on by itself never is");
        seats.end_alone_after(Duration::ZERO);
        assert!(seats.left_alone().is_some(), "nobody has come yet");
        let ana = seats.sit(None, Sitting::default());
        assert_eq!(seats.left_alone(), None);
        drop(ana);
        assert!(seats.left_alone().is_some());
        seats.end_alone_after(Duration::from_hours(1));
        assert_eq!(seats.left_alone(), None, "somebody may come back");
        seats.end_alone_after(Duration::ZERO);
        seats.keep();
        assert_eq!(seats.left_alone(), None, "somebody said that it goes on");
    }
}
