//! What the engine's thread tells a front end in the same process, and how much of it may wait.

use crate::StartError;
use holdpoint_protocol::command::{Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_registry::StoreError;
use holdpoint_text::Hint as _;

/// The most requests that are on their way or not yet answered.
pub const OUTSTANDING_MAX: usize = 64;

/// The most updates that wait for the front end.
pub const UPDATES_MAX: usize = 256;

/// Why there is no engine: it did not come up, or did not end in good order.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct EndFault {
    /// One sentence, with its hint.
    pub text: String,
    /// Whether another engine holds the store: that one is at work.
    pub in_use: bool,
    /// Whether it ended in good order, by somebody else's hand.
    pub orderly: bool,
    /// Whether the engine itself said why, and not that it was heard no more.
    pub told: bool,
}

impl EndFault {
    /// One that says nothing of another engine.
    #[must_use]
    pub fn of(text: impl Into<String>) -> Self {
        Self { text: text.into(), in_use: false, orderly: false, told: false }
    }

    /// In the engine's own words.
    #[must_use]
    pub fn told(text: impl Into<String>) -> Self {
        Self { told: true, ..Self::of(text) }
    }

    /// Not a fault: an engine that somebody else ended in good order.
    #[must_use]
    pub fn orderly(text: impl Into<String>) -> Self {
        Self { orderly: true, ..Self::of(text) }
    }

    /// There is one at work already.
    #[must_use]
    pub fn in_use(text: impl Into<String>) -> Self {
        Self { in_use: true, ..Self::of(text) }
    }
}

impl From<StartError> for EndFault {
    fn from(error: StartError) -> Self {
        let in_use = matches!(&error, StartError::Store(StoreError::InUse { .. }));
        Self { in_use, ..Self::of(error.sentence()) }
    }
}

/// What the engine's thread tells.
#[derive(Debug)]
pub enum Update {
    /// The engine is up.
    Started,
    /// What happened, in order.
    Events(Vec<Event>),
    /// What happened before this front end came, oldest first, and how many events came before that.
    Past { events: Vec<Event>, earlier: u64 },
    /// The answer to a request.
    Answer { id: String, reply: Reply },
    /// The front end was too slow: so many events were not told.
    Lagged { missed: u64 },
    /// The engine ended before it took this request: nothing came of it here.
    Returned(Box<Request>),
    /// The engine has ended; nothing comes after it.
    Ended(Result<(), EndFault>),
}
