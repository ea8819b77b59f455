//! What goes over the socket: one JSON document a line, each side's lines of bounded length.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::command::{Reply, Request};
use crate::event::Event;

/// Raised when either side's documents change; both sides must have the same.
pub const PROTOCOL: u32 = 3;

/// The longest line a client may send, bytes.
pub const CALL_BYTES_MAX: usize = 1024 * 1024;

/// The longest line an engine sends, bytes.
pub const ANSWER_BYTES_MAX: usize = 16 * 1024 * 1024;

/// The longest id of a command, bytes.
pub const ID_BYTES_MAX: usize = 128;

/// What a client sends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "call", deny_unknown_fields)]
pub enum Call {
    /// One request; answered by one [`Answer::Reply`].
    Ask {
        /// What is asked.
        request: Box<Request>,
    },
    /// From now on this connection only tells events.
    Subscribe {},
}

/// What the engine's side sends.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "answer", deny_unknown_fields)]
pub enum Answer {
    /// The first line of every connection.
    Hello {
        /// The protocol.
        protocol: u32,
        /// The program's version.
        version: String,
        /// The engine's process.
        process: u32,
    },
    /// The engine's reply.
    Reply {
        /// What it said.
        reply: Box<Reply>,
    },
    /// Events after this are all told, but for those a [`Answer::Lagged`] counts.
    Subscribed,
    /// Something happened.
    Event {
        /// What.
        event: Box<Event>,
    },
    /// The subscriber was too slow: the oldest events were dropped.
    Lagged {
        /// How many.
        missed: u64,
    },
    /// The connection is closed: what was sent is not allowed, or there are too many connections.
    Closed {
        /// Why.
        text: String,
    },
}

/// A document with its line break.
///
/// # Errors
/// Where the value has no JSON form.
pub fn line<T: Serialize>(value: &T) -> Result<String, serde_json::Error> {
    let mut line = serde_json::to_string(value)?;
    line.push('\n');
    Ok(line)
}
