//! The host's loop: takes requests of the front end and the socket between slices, and sends events to both.
//!
//! A panic in a step halts the engine; the loop continues.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use super::publisher::Publisher;
use super::update::OUTSTANDING_MAX;
use crate::pump::{Pump, TurnStep};
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_wording::program::engine as sentences;

/// How long an idle engine waits for a request before it checks its clock, its socket and the live cell.
const PAUSE_MAX: Duration = Duration::from_millis(15);

/// How long it waits while the arm is stopping.
const PAUSE_STOPPING: Duration = Duration::from_millis(2);

/// The loop's state.
pub(super) struct EngineLoop<'a> {
    pump: Pump,
    incoming: &'a Receiver<Request>,
    /// Waiting requests; initially those from before the engine was up.
    first: VecDeque<Request>,
    /// Requests that are answered after the running sequence.
    waiting: Vec<String>,
    test_panic: TestPanic,
}

impl<'a> EngineLoop<'a> {
    pub(super) fn new(pump: Pump, incoming: &'a Receiver<Request>, first: VecDeque<Request>) -> Self {
        Self { pump, incoming, first, waiting: Vec::new(), test_panic: TestPanic::new() }
    }

    /// Runs until the engine has ended.
    pub(super) fn run(&mut self, publisher: &mut Publisher) {
        let mut next = None;
        loop {
            let lost = self.requests(next.take(), publisher);
            if (lost || publisher.is_lost()) && !self.pump.engine().has_ended() {
                publisher.seats().note_ending(|| sentences::ENDED_BY_LOSS.to_owned());
                guarded(&mut self.pump, "an end", |pump| {
                    pump.submit(Request::unsigned("front-end-lost".to_owned(), Command::Shutdown));
                });
                if !self.pump.engine().has_ended() {
                    // Even the end failed: the data on disk is complete, and the engine begins nothing more.
                    return;
                }
            }
            if let Some(alone) =
                publisher.seats().unattended_for().filter(|_| !self.pump.engine().has_ended())
            {
                let secs = alone.as_secs();
                publisher.seats().note_ending(|| sentences::ended_alone(secs));
                guarded(&mut self.pump, "an end", |pump| {
                    pump.submit(Request::unsigned("nobody-sits".to_owned(), Command::Shutdown));
                });
            }
            let progress = self.turn(publisher);
            self.answer_waiting(publisher);
            publisher.flush();
            if progress == SliceOutcome::Ran {
                publisher.note_change();
            }
            guarded(&mut self.pump, "a snapshot", |pump| publisher.publish(pump.engine()));
            if self.pump.engine().has_ended() {
                self.end_scenes(publisher);
                return;
            }
            if progress != SliceOutcome::Ran {
                next = self.wait();
            }
        }
    }

    /// One turn of the pump, with each step guarded.
    fn turn(&mut self, publisher: &mut Publisher) -> SliceOutcome {
        let test_panic = &mut self.test_panic;
        let (progress, events) = self.pump.guarded_turn(|pump, step, work| {
            guarded(pump, name(step), |pump| {
                if step == TurnStep::Slice {
                    test_panic.at_slice();
                }
                work(pump);
            });
        });
        self.send_events(events, publisher);
        progress
    }

    /// Sends events to the front end.
    fn send_events(&mut self, events: Vec<Event>, publisher: &mut Publisher) {
        self.test_panic.note(&events);
        publisher.send_events(events);
    }

    /// Ends the recordings, which are then on record.
    fn end_scenes(&mut self, publisher: &mut Publisher) {
        let mut events = Vec::new();
        guarded(&mut self.pump, "the scenes", |pump| events = pump.finish());
        publisher.send_events(events);
        let rest = self.pump.deliver_events();
        self.send_events(rest, publisher);
        publisher.flush();
    }

    /// Carries out waiting requests. Returns whether the front end is gone.
    fn requests(&mut self, first: Option<Request>, publisher: &mut Publisher) -> bool {
        self.first.extend(first);
        for _ in 0..OUTSTANDING_MAX {
            while self.first.len() < OUTSTANDING_MAX {
                match self.incoming.try_recv() {
                    Ok(request) => self.first.push_back(request),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) if self.first.is_empty() => return true,
                    Err(TryRecvError::Disconnected) => break,
                }
            }
            // Requests that take authority away come first.
            let brake = self.first.iter().position(|request| request.command.takes_authority_away());
            let Some(request) = self.first.remove(brake.unwrap_or(0)) else { break };
            let id = request.id.clone();
            if matches!(request.command, Command::Shutdown) {
                let consoles = publisher.seats();
                consoles.note_ending(|| {
                    let who = consoles.named(std::process::id());
                    who.unwrap_or_else(|| sentences::ENDED_BY_STARTER.to_owned())
                });
            }
            let mut reply = None;
            let mut done = false;
            guarded(&mut self.pump, "a request", |pump| {
                reply = pump.offer(request);
                done = true;
            });
            match reply {
                Some(reply) => publisher.answer(id, reply),
                None if done => self.waiting.push(id),
                None => publisher.answer(id, failed()),
            }
        }
        false
    }

    fn answer_waiting(&mut self, publisher: &mut Publisher) {
        for id in std::mem::take(&mut self.waiting) {
            match self.pump.engine().answer_of(&id) {
                Some(reply) => publisher.answer(id, reply),
                None => self.waiting.push(id),
            }
        }
    }

    /// Waits for a request, but not for long.
    fn wait(&self) -> Option<Request> {
        let pause = if self.waiting.is_empty() { PAUSE_MAX } else { PAUSE_STOPPING };
        // The loop itself detects a lost front end.
        self.incoming.recv_timeout(pause).ok()
    }
}

/// Runs a step; a panic in it halts the engine, and the loop continues.
fn guarded(pump: &mut Pump, what: &str, work: impl FnOnce(&mut Pump)) {
    let done = catch_unwind(AssertUnwindSafe(|| work(pump)));
    if let Err(panic) = done {
        let text = format!("the engine failed in {what}: {}", panic_message(&*panic));
        // A halt raises an alarm; if even that fails, the alarm is at least in the book, or the fault is published.
        drop(catch_unwind(AssertUnwindSafe(|| pump.fail(&text))));
    }
}

/// The name of a failed step.
const fn name(step: TurnStep) -> &'static str {
    match step {
        TurnStep::Requests => "a request",
        TurnStep::Slice => "a slice",
        TurnStep::Settling => "the scenes",
    }
}

fn failed() -> Reply {
    Reply::Refused {
        code: holdpoint_protocol::command::Refusal::Holding,
        text: "the engine failed on it and is halted".to_owned(),
        hint: Some("end the engine, look at `holdpoint audit verify`, and start it again".to_owned()),
    }
}

pub(super) fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    holdpoint_text::Untrusted::new(text.unwrap_or_else(|| "no message".to_owned())).line().into_string()
}

/// A deliberate panic, for tests: `HOLDPOINT_TEST_PANIC=engine` fails the first slice after a registration, once.
struct TestPanic {
    armed: bool,
    due: bool,
}

impl TestPanic {
    fn new() -> Self {
        let enabled = std::env::var_os("HOLDPOINT_TEST_PANIC").is_some_and(|value| value == "engine");
        Self { armed: cfg!(debug_assertions) && enabled, due: false }
    }

    fn note(&mut self, events: &[Event]) {
        let registered = |event: &Event| {
            // The start registers the baselines, which do not count.
            matches!(&event.kind, EventKind::Registered { parent: Some(_), .. })
        };
        self.due |= self.armed && events.iter().any(registered);
    }

    fn at_slice(&mut self) {
        if self.due {
            (self.armed, self.due) = (false, false);
            fall_over();
        }
    }
}

#[cfg(debug_assertions)]
#[allow(clippy::panic, reason = "a panic is what is tried")]
fn fall_over() {
    std::panic::panic_any("a panic on purpose");
}

#[cfg(not(debug_assertions))]
const fn fall_over() {}
