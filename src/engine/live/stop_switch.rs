//! Stops the arm from outside: from any thread, in the tick in which the body reads the switch.
//!
//! Three kinds of stop. [`StopSwitch::stop`] ends the sequence that runs, for an operation that follows at once.
//! `StopSwitch::brake` permits no motion while a request waits that takes authority from a running version.
//! [`StopSwitch::halt`] is a person's stop of the cell: it latches, and the body itself brakes and takes no command
//! until `StopSwitch::release`. Decides nothing and never waits.

use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Caller, Request};

/// The most stops that wait to be put on record, and the most ids that are known.
const STOPS_MAX: usize = 64;

/// No tick yet.
const NEVER: u64 = u64::MAX;

/// A stop as it was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopRequest {
    /// Id of the request, which identifies one that arrives twice (at the socket, and from the engine).
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
struct StopQueue {
    /// Not put on record yet, the first one first.
    waiting: VecDeque<StopRequest>,
    /// Ids of the last ones.
    known: VecDeque<String>,
}

/// See the module's head.
#[derive(Debug)]
pub struct StopSwitch {
    /// The sequence at work, from 1; 0 between two.
    working: AtomicU64,
    /// The sequence that is to stop.
    stop: AtomicU64,
    halted: AtomicBool,
    /// Ticks that the body has stepped, all sequences together.
    stepped: AtomicU64,
    /// Of these, those stepped when the halt was asked for.
    halted_at: AtomicU64,
    /// Ticks from the halt to the standing arm.
    stood_after: AtomicU64,
    /// What was asked.
    queue: Mutex<StopQueue>,
    /// Requests that take authority away and that the engine has not taken yet.
    brakes: AtomicUsize,
    braking: Mutex<BrakeState>,
}

/// Who may be braked, and for which requests the arm is.
#[derive(Debug, Default)]
struct BrakeState {
    /// The versions of the newest sequence, and whether each is the last of its family.
    at_work: Vec<(CapabilityId, bool)>,
    /// Ids of requests.
    waiting: BTreeSet<String>,
    /// Time of the newest stop of the arm: by a request that takes authority away, or by a person's stop.
    last_stop: Option<Instant>,
}

/// What reaches into an engine from other threads; it may be there before the engine is.
#[derive(Clone, Debug, Default)]
pub struct Controls {
    /// Stops the arm.
    pub switch: Arc<StopSwitch>,
    /// Set to interrupt running evaluations between episodes.
    pub cancel: Arc<AtomicBool>,
}

impl Default for StopSwitch {
    fn default() -> Self {
        Self {
            working: AtomicU64::new(0),
            stop: AtomicU64::new(0),
            halted: AtomicBool::new(false),
            stepped: AtomicU64::new(0),
            halted_at: AtomicU64::new(0),
            stood_after: AtomicU64::new(NEVER),
            queue: Mutex::default(),
            brakes: AtomicUsize::new(0),
            braking: Mutex::default(),
        }
    }
}

impl StopSwitch {
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
        self.is_halted()
            || self.brakes.load(Ordering::Acquire) > 0
            || self.stop.load(Ordering::Acquire) == number
    }

    /// Time of the newest stop of the arm, by a request that takes authority away or by a person's stop.
    #[must_use]
    pub fn braked_at(&self) -> Option<Instant> {
        self.braking().last_stop
    }

    /// Whether a sequence is being worked.
    #[must_use]
    pub fn is_at_work(&self) -> bool {
        self.working.load(Ordering::Acquire) != 0
    }

    /// Whether no sequence may run: the present one stops, and so would one that begins now.
    #[must_use]
    pub fn lets_nothing_work(&self) -> bool {
        self.stops(self.working.load(Ordering::Acquire))
    }

    /// Which versions work from now on, and whether each is the last of its family.
    pub(crate) fn work_under(&self, at_work: Vec<(CapabilityId, bool)>) {
        self.braking().at_work = at_work;
    }

    /// A request is about to wait for the engine. If it takes authority from a version at work, that version works no
    /// more from now on, whatever the engine is doing: until [`Self::taken`].
    pub fn brake(&self, request: &Request) {
        let Some(version) = request.command.takes_from() else { return };
        let mut braking = self.braking();
        let needs_confirmation = request.command.needs_last_confirmation();
        let meant = |(id, last): &(CapabilityId, bool)| id == version && !(needs_confirmation && *last);
        if braking.at_work.iter().any(meant) {
            braking.last_stop = Some(Instant::now());
            braking.waiting.insert(request.id.clone());
            self.brakes.store(braking.waiting.len(), Ordering::Release);
        }
    }

    /// The engine has taken a request, and stopped the arm itself if it has to stand for it.
    pub fn taken(&self, id: &str) {
        let mut braking = self.braking();
        braking.waiting.remove(id);
        self.brakes.store(braking.waiting.len(), Ordering::Release);
    }

    fn braking(&self) -> std::sync::MutexGuard<'_, BrakeState> {
        self.braking.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// A person stops the cell. Requests while it is stopped are recorded too: their senders may know of another
    /// cause. Beyond 64 requests in one turn of the engine, one record covers the rest.
    pub fn halt(&self, request: StopRequest) {
        // A thread that panicked with the lock held left a whole value; stopping must not fail for that.
        let mut queue = self.queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let first = !self.is_halted();
        if first {
            self.latch();
            self.braking().last_stop = Some(Instant::now());
        }
        if first || (queue.waiting.len() < STOPS_MAX && !queue.known.contains(&request.id)) {
            queue.known.push_back(request.id.clone());
            if queue.known.len() > STOPS_MAX {
                queue.known.pop_front();
            }
            queue.waiting.push_back(request);
        }
    }

    /// Whether a stop of this id was asked for, as far back as ids are kept.
    pub(crate) fn knows(&self, id: &str) -> bool {
        let queue = self.queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        queue.known.iter().any(|known| known == id)
    }

    /// The cell was stopped before: there is no new request.
    pub(crate) fn latch(&self) {
        self.halted_at.store(self.stepped.load(Ordering::Acquire), Ordering::Release);
        self.stood_after.store(NEVER, Ordering::Release);
        self.halted.store(true, Ordering::Release);
    }

    /// Whether the cell is stopped.
    #[must_use]
    pub fn is_halted(&self) -> bool {
        self.halted.load(Ordering::Acquire)
    }

    /// Lets the arm run again. Refused, with `false`, while a stop is not recorded yet.
    pub(crate) fn release(&self) -> bool {
        let queue = self.queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if queue.waiting.is_empty() {
            self.halted.store(false, Ordering::Release);
        }
        queue.waiting.is_empty()
    }

    /// The first stop that is not on record yet.
    #[must_use]
    pub fn first_stop(&self) -> Option<StopRequest> {
        let queue = self.queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        queue.waiting.front().cloned()
    }

    /// The first stop is on record, or kept beside it.
    pub(crate) fn pop_stop(&self) {
        self.queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner).waiting.pop_front();
    }

    /// The body has stepped; `stands` is the number of ticks at standstill, while the cell is stopped.
    pub(crate) fn stepped(&self, stands: Option<u64>) {
        let now = self.stepped.fetch_add(1, Ordering::AcqRel) + 1;
        if let Some(since) = stands {
            let after = now.saturating_sub(self.halted_at.load(Ordering::Acquire)).saturating_sub(since);
            // The first standstill is the one that counts.
            let _ = self.stood_after.compare_exchange(NEVER, after, Ordering::AcqRel, Ordering::Acquire);
        }
    }

    /// Ticks from the halt to the standing arm; absent until it stands. An arm that was not at work stands at once.
    pub(crate) fn ticks_to_standstill(&self, at_work: bool) -> Option<u64> {
        let after = self.stood_after.load(Ordering::Acquire);
        if after != NEVER {
            return Some(after);
        }
        (!at_work && !self.has_stepped_since_halt()).then_some(0)
    }

    /// Whether the body has stepped since the stop of the cell; false for a cell that is not stopped.
    pub(crate) fn has_stepped_since_halt(&self) -> bool {
        let since = self.halted_at.load(Ordering::Acquire);
        self.is_halted() && self.stepped.load(Ordering::Acquire) != since
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::command::{Command, Operation};

    fn stop_request(by: &str) -> StopRequest {
        StopRequest { id: by.to_owned(), by: by.to_owned(), reason: String::new(), caller: Caller::Script }
    }

    #[test]
    fn stop_switch_stops_only_the_running_sequence() {
        let switch = StopSwitch::default();
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
    fn nothing_runs_while_a_request_that_takes_authority_waits() {
        let switch = StopSwitch::default();
        let (last, other) = ("grasp@1.0.0", "align@1.1.0");
        switch.work_under(vec![(last.parse().unwrap(), true), (other.parse().unwrap(), false)]);
        switch.begin(1);
        let operation = |version: &str| Operation {
            version: version.parse().unwrap(),
            by: "ana".to_owned(),
            reason: "a test".to_owned(),
        };
        let brake = |id: &str, command: Command| switch.brake(&Request::unsigned(id.to_owned(), command));
        brake("1", Command::Rollback(operation("align@1.0.0")));
        brake("2", Command::Pause(operation(other)));
        // No version would take over: the console asks back, and the arm continues.
        brake("3", Command::Rollback(operation(last)));
        assert!(!switch.lets_nothing_work());
        brake("4", Command::Vacate(operation(last)));
        brake("5", Command::Reject(operation(other)));
        assert!(switch.stops(1) && switch.stops(2), "nor does a sequence that begins meanwhile");
        switch.taken("4");
        switch.taken("4");
        assert!(switch.lets_nothing_work());
        switch.taken("5");
        assert!(!switch.stops(1) && !switch.stops(2) && switch.is_at_work());
    }

    #[test]
    fn a_halt_latches_for_every_sequence_until_it_is_released() {
        let switch = StopSwitch::default();
        switch.begin(1);
        switch.stepped(None);
        switch.halt(stop_request("ana"));
        switch.halt(stop_request("bo"));
        // The same request, once at the socket and once from the engine.
        switch.halt(stop_request("bo"));
        assert!(switch.is_halted() && switch.stops(1) && switch.stops(2));
        assert!(!switch.release(), "it is not on record yet");
        let take = || switch.first_stop().inspect(|_| switch.pop_stop());
        let on_record: Vec<String> = std::iter::from_fn(take).map(|request| request.by).collect();
        assert_eq!(on_record, ["ana", "bo"]);
        assert_eq!(switch.ticks_to_standstill(true), None);
        assert!(!switch.has_stepped_since_halt());
        for _ in 0..30 {
            switch.stepped(None);
        }
        switch.stepped(Some(12));
        switch.stepped(Some(12));
        assert_eq!(switch.ticks_to_standstill(true), Some(31 - 12));
        assert!(switch.has_stepped_since_halt());
        assert!(switch.release() && !switch.is_halted() && !switch.has_stepped_since_halt());
        // An arm that is not at work stands at once.
        switch.halt(stop_request("bo"));
        assert_eq!((switch.ticks_to_standstill(true), switch.ticks_to_standstill(false)), (None, Some(0)));
    }
}
