//! The engine as a service in real time: requests between slices, events to whoever listens, an orderly end.
//!
//! Owns the loop and nothing else. On a signal to end the slice that runs is finished and nothing more is begun,
//! approved or activated; a second signal interrupts the slice.

use std::ops::ControlFlow;
use std::time::Duration;

use super::Engine;
use super::door::{Door, DoorError, Signals};
use crate::pipeline::Progress;
use holdpoint_protocol::command::{Command, Request};
use holdpoint_protocol::event::Event;

/// The longest pause of an idle engine before it looks at its clock again.
const PAUSE_MAX: Duration = Duration::from_millis(500);

/// How the loop ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Served<T> {
    /// The engine was asked to end, by a request or a signal.
    Asked,
    /// Whoever is told the events had enough.
    Enough(T),
}

/// Opens the door of a running engine; signals to end are taken from here on.
///
/// # Errors
/// [`DoorError`].
pub fn open(engine: &Engine) -> Result<Door, DoorError> {
    Door::open(engine.layout(), engine.cancel(), Signals::Taken)
}

/// Runs an engine until it is asked to end or `each` has had enough. `each` sees the engine after every slice,
/// with the events of that slice; deadlines are those of the engine's own clock, so it must follow real time.
pub fn serve<T>(
    engine: &mut Engine,
    door: &mut Door,
    mut each: impl FnMut(&mut Engine, &[Event]) -> ControlFlow<T>,
) -> Served<T> {
    loop {
        step_requests(engine, door);
        let progress = engine.advance();
        let events = engine.drain_events();
        door.publish(&events);
        if let ControlFlow::Break(enough) = each(engine, &events) {
            return Served::Enough(enough);
        }
        if engine.has_ended() {
            return Served::Asked;
        }
        if let Progress::Idle { next_ms } = progress {
            let now_ms = engine.now_ms();
            let until_due = next_ms.map(|at_ms| Duration::from_millis(at_ms.saturating_sub(now_ms)));
            door.wait(until_due.unwrap_or(PAUSE_MAX).min(PAUSE_MAX));
        }
    }
}

/// What waits at the door, and what signals ask for. A loop of its own calls this between slices.
pub fn step_requests(engine: &mut Engine, door: &mut Door) {
    door.poll(engine);
    if door.endings_asked() > 0 && !engine.has_ended() {
        engine.submit(Request { id: "signal-to-end".to_owned(), command: Command::Shutdown });
    }
}
