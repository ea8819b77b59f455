//! The updates from the engine's thread to a front end in the same process, and their limits.

use std::fmt;
use std::path::Path;

use crate::bootstrap::BootstrapError;
use crate::control_socket::ControlSocketError;
use holdpoint_cell::CellError;
use holdpoint_engine::StartError;
use holdpoint_protocol::command::{Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_store::StoreError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint as _, Problem};

/// The most requests that are unanswered.
pub const OUTSTANDING_MAX: usize = 64;

/// The most updates that wait for the front end.
pub const UPDATES_MAX: usize = 256;

/// Why there is no engine: it did not come up, or did not end cleanly.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EngineEndError {
    /// One sentence.
    pub text: String,
    /// What helps; absent if unknown, or if the sentence says it.
    pub hint: Option<String>,
    /// Whether another engine has the store.
    pub in_use: bool,
    /// Whether another process prevented the start for now.
    pub busy: bool,
    /// Whether it ended cleanly, at the request of another client.
    pub orderly: bool,
    /// Whether the engine itself gave the reason, rather than a lost connection.
    pub from_engine: bool,
    /// What the error is, for programs, if its type said so.
    pub details: Option<ErrorDetails>,
}

impl EngineEndError {
    /// An end that does not concern another engine.
    #[must_use]
    pub fn of(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            hint: None,
            in_use: false,
            busy: false,
            orderly: false,
            from_engine: false,
            details: None,
        }
    }

    pub fn reported(text: impl Into<String>) -> Self {
        Self { from_engine: true, ..Self::of(text) }
    }

    /// There is no cell: the file of the robot or the site is at fault, if one is named.
    #[must_use]
    pub fn without_cell(robot: Option<&Path>, error: &CellError) -> Self {
        let details = match robot {
            Some(file) => ErrorDetails::of_path(ErrorReason::BadFile, file),
            None => ErrorReason::Internal.into(),
        };
        Self::of(error.to_string()).with_details(details)
    }

    /// With what the error is, for programs.
    #[must_use]
    pub fn with_details(self, details: impl Into<ErrorDetails>) -> Self {
        Self { details: Some(details.into()), ..self }
    }

    /// Not a fault: another client ended the engine cleanly.
    #[must_use]
    pub fn orderly(text: impl Into<String>) -> Self {
        Self { orderly: true, ..Self::of(text) }
    }

    /// Another engine already has the store.
    #[must_use]
    pub fn in_use(text: impl Into<String>) -> Self {
        Self { in_use: true, ..Self::of(text) }.with_details(ErrorReason::StoreInUse)
    }
}

impl fmt::Display for EngineEndError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&Problem::from((self.text.clone(), self.hint.clone())).sentence())
    }
}

impl std::error::Error for EngineEndError {}

impl From<StartError> for EngineEndError {
    fn from(error: StartError) -> Self {
        let in_use = matches!(&error, StartError::Store(StoreError::InUse { .. }));
        let hint = error.hint().map(std::borrow::Cow::into_owned);
        Self { in_use, hint, details: error.details(), ..Self::of(error.to_string()) }
    }
}

impl From<BootstrapError> for EngineEndError {
    fn from(error: BootstrapError) -> Self {
        match error {
            BootstrapError::Start(error) => error.into(),
            BootstrapError::Socket(_) | BootstrapError::Thread(_) => {
                let busy = matches!(&error, BootstrapError::Socket(ControlSocketError::Locked { .. }));
                let hint = error.hint().map(std::borrow::Cow::into_owned);
                Self { busy, hint, details: error.details(), ..Self::of(error.to_string()) }
            }
        }
    }
}

/// An update from the engine's thread.
#[derive(Debug)]
pub enum EngineUpdate {
    /// The engine is up.
    Started,
    /// Events, in order.
    Events(Vec<Event>),
    /// Events from before this front end, oldest first, and the number of events before those.
    Past { events: Vec<Event>, earlier: u64 },
    /// The answer to a request.
    Answer { id: String, reply: Reply },
    /// The front end was too slow: this number of events was dropped.
    Lagged { missed: u64 },
    /// The engine ended before it took this request, which had no effect.
    Returned(Box<Request>),
    /// The engine has ended; the last update.
    Ended(Result<(), EngineEndError>),
}
