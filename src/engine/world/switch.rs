//! How somebody outside stops the arm: from any thread, in the tick in which the body reads it.
//!
//! Two kinds of stop. [`Switch::stop`] ends the sequence that runs, for an operation that follows at once.
//! [`Switch::halt`] is a person's stop of the cell: it latches, the body itself brakes and takes no command while it
//! lasts, and only `Switch::release` ends it. Decides nothing, and waits for nobody.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use holdpoint_protocol::command::Caller;

/// The most stops that wait to be put on record, and the most ids that are known.
const ASKED_MAX: usize = 64;

/// No tick yet.
const NEVER: u64 = u64::MAX;

/// A stop as it was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedStop {
    /// Id of the request, by which one that comes here twice (at the door, and from the engine) is known.
    pub id: String,
    /// The name that was claimed.
    pub by: String,
    /// Why; may be empty.
    pub reason: String,
    /// Whose process asked, as the system has it.
    pub caller: Caller,
}

/// Stops that were asked for.
#[derive(Debug, Default)]
struct StopsAsked {
    /// Not put on record yet, the first one first.
    waiting: VecDeque<AskedStop>,
    /// Ids of the last ones.
    known: VecDeque<String>,
}

/// See the module's head.
#[derive(Debug)]
pub struct Switch {
    /// The sequence at work, from 1; 0 between two.
    working: AtomicU64,
    /// The sequence that is to stop.
    stop: AtomicU64,
    halted: AtomicBool,
    /// Ticks that the body has stepped, all sequences together.
    stepped: AtomicU64,
    /// Of these, those stepped when the halt was asked for.
    asked_at: AtomicU64,
    /// Ticks from the halt to the standing arm.
    stood_after: AtomicU64,
    /// What was asked.
    asked: Mutex<StopsAsked>,
}

/// What reaches into an engine from other threads; it may be there before the engine is.
#[derive(Clone, Debug, Default)]
pub struct Controls {
    /// Stops the arm.
    pub switch: Arc<Switch>,
    /// Set to interrupt running evaluations between episodes.
    pub cancel: Arc<AtomicBool>,
}

impl Default for Switch {
    fn default() -> Self {
        Self {
            working: AtomicU64::new(0),
            stop: AtomicU64::new(0),
            halted: AtomicBool::new(false),
            stepped: AtomicU64::new(0),
            asked_at: AtomicU64::new(0),
            stood_after: AtomicU64::new(NEVER),
            asked: Mutex::default(),
        }
    }
}

impl Switch {
    /// Stops the arm where it works now. A sequence that begins later is not meant.
    pub fn stop(&self) {
        self.stop.store(self.working.load(Ordering::Acquire), Ordering::Release);
    }

    /// A sequence begins; numbers count from 1.
    pub(crate) fn begin(&self, number: u64) {
        self.working.store(number, Ordering::Release);
    }

    /// The sequence is over.
    pub(crate) fn end(&self) {
        self.working.store(0, Ordering::Release);
    }

    /// Whether this sequence is to stop.
    pub(crate) fn stops(&self, number: u64) -> bool {
        self.is_halted() || self.stop.load(Ordering::Acquire) == number
    }

    /// A person stops the cell. Whoever asks while it is stopped is put on record, too: that person may know of
    /// something that the first one did not. Beyond 64 in one turn of the engine the same stop stands for all.
    pub fn halt(&self, asked: AskedStop) {
        // Whoever panicked with the lock held left a whole value; stopping must not fail for that.
        let mut slot = self.asked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let first = !self.is_halted();
        if first {
            self.latch();
        }
        if first || (slot.waiting.len() < ASKED_MAX && !slot.known.contains(&asked.id)) {
            slot.known.push_back(asked.id.clone());
            if slot.known.len() > ASKED_MAX {
                slot.known.pop_front();
            }
            slot.waiting.push_back(asked);
        }
    }

    /// Whether a stop of this id was asked for, as far back as ids are kept.
    pub(crate) fn knows(&self, id: &str) -> bool {
        let slot = self.asked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        slot.known.iter().any(|known| known == id)
    }

    /// The cell is stopped from before: nothing was asked anew.
    pub(crate) fn latch(&self) {
        self.asked_at.store(self.stepped.load(Ordering::Acquire), Ordering::Release);
        self.stood_after.store(NEVER, Ordering::Release);
        self.halted.store(true, Ordering::Release);
    }

    /// Whether the cell is stopped.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.halted.load(Ordering::Acquire)
    }

    /// The arm may work again. Refused, with `false`, while a stop is not on record yet.
    pub(crate) fn release(&self) -> bool {
        let slot = self.asked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if slot.waiting.is_empty() {
            self.halted.store(false, Ordering::Release);
        }
        slot.waiting.is_empty()
    }

    /// A stop that was asked for and is to be put on record.
    pub(crate) fn take_asked(&self) -> Option<AskedStop> {
        self.asked.lock().unwrap_or_else(std::sync::PoisonError::into_inner).waiting.pop_front()
    }

    /// The first stop that is not on record yet, while the cell is stopped by it.
    pub(crate) fn first_asked(&self) -> Option<AskedStop> {
        let slot = self.asked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        slot.waiting.front().cloned()
    }

    /// The body has stepped; `stands` tells since how many ticks every joint stands, while the cell is stopped.
    pub(crate) fn stepped(&self, stands: Option<u64>) {
        let now = self.stepped.fetch_add(1, Ordering::AcqRel) + 1;
        if let Some(since) = stands {
            let after = now.saturating_sub(self.asked_at.load(Ordering::Acquire)).saturating_sub(since);
            // The first standstill is the one that counts.
            let _ = self.stood_after.compare_exchange(NEVER, after, Ordering::AcqRel, Ordering::Acquire);
        }
    }

    /// Ticks from the halt to the standing arm; absent until it stands. An arm that was not at work stands at once.
    pub(crate) fn stood_after(&self, at_work: bool) -> Option<u64> {
        let after = self.stood_after.load(Ordering::Acquire);
        if after != NEVER {
            return Some(after);
        }
        let still = self.stepped.load(Ordering::Acquire) == self.asked_at.load(Ordering::Acquire);
        (!at_work && still).then_some(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(by: &str) -> AskedStop {
        AskedStop { id: by.to_owned(), by: by.to_owned(), reason: String::new(), caller: Caller::Script }
    }

    #[test]
    fn the_switch_stops_the_sequence_at_work_alone() {
        let switch = Switch::default();
        switch.stop();
        assert!(!switch.stops(1));
        switch.begin(1);
        assert!(!switch.stops(1));
        switch.stop();
        assert!(switch.stops(1));
        switch.end();
        switch.begin(2);
        assert!(!switch.stops(2), "a later sequence is not meant");
    }

    #[test]
    fn a_halt_latches_for_every_sequence_until_it_is_released() {
        let switch = Switch::default();
        switch.begin(1);
        switch.stepped(None);
        switch.halt(asked("ana"));
        switch.halt(asked("bo"));
        // The same request, once at the door and once from the engine.
        switch.halt(asked("bo"));
        assert!(switch.is_halted() && switch.stops(1) && switch.stops(2));
        assert!(!switch.release(), "it is not on record yet");
        let on_record: Vec<String> =
            std::iter::from_fn(|| switch.take_asked()).map(|asked| asked.by).collect();
        assert_eq!(on_record, ["ana", "bo"]);
        assert_eq!(switch.stood_after(true), None);
        for _ in 0..30 {
            switch.stepped(None);
        }
        switch.stepped(Some(12));
        switch.stepped(Some(12));
        assert_eq!(switch.stood_after(true), Some(31 - 12));
        assert!(switch.release() && !switch.is_halted());
        // An arm that is not at work stands at once.
        switch.halt(asked("bo"));
        assert_eq!((switch.stood_after(true), switch.stood_after(false)), (None, Some(0)));
    }
}
