//! What the engine's thread tells a front end in the same process, and how much of it may wait.

use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::Event;

/// The most requests that are on their way or not yet answered.
pub const OUTSTANDING_MAX: usize = 64;

/// The most updates that wait for the front end.
pub const UPDATES_MAX: usize = 256;

/// What the engine's thread tells.
#[derive(Debug)]
pub enum Update {
    /// The engine is up.
    Started,
    /// What happened, in order.
    Events(Vec<Event>),
    /// The answer to a request.
    Answer { id: String, reply: Reply },
    /// The front end was too slow: so many events were not told.
    Lagged { missed: u64 },
    /// The engine has ended; nothing comes after it.
    Ended(Result<(), String>),
}
