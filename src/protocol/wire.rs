//! The messages of the socket: one JSON document per line, of bounded length.

use std::net::SocketAddr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::command::{Reply, Request};
use crate::console_presence::ConsolePresence;
use crate::event::Event;
use crate::snapshot::Snapshot;
use crate::video_frame::VideoFrame;

/// Raised when either side's documents change; both sides must have the same. A new command with its reply does not raise it:
/// an engine that does not know a command refuses it and names those it knows.
pub const PROTOCOL: u32 = 16;

/// The longest line a client may send, bytes: enough for the largest component in a package's JSON.
pub const CALL_BYTES_MAX: usize = 4 * 1024 * 1024;

/// The longest line an engine sends, bytes.
pub const ANSWER_BYTES_MAX: usize = 16 * 1024 * 1024;

/// The longest id of a command, bytes.
pub const ID_BYTES_MAX: usize = 128;

/// A message from a client, one JSON document per line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "call", deny_unknown_fields)]
pub enum ClientMessage {
    /// One request, answered by one [`ServerMessage::Reply`].
    Ask {
        /// The command, with the id that makes a retry harmless.
        request: Box<Request>,
    },
    /// From now on this connection only carries events.
    Subscribe {},
    /// From now on this connection carries events and the newest snapshot and video frame, and accepts only
    /// [`ClientMessage::Sit`]. Other calls need another connection.
    Attach {
        /// The attaching console.
        sitting: ConsolePresence,
    },
    /// Keep the engine running without an attached console, answered by one [`ServerMessage::Kept`].
    Keep {},
    /// Serve the live scene to viewers, answered by one [`ServerMessage::Scene`].
    Scene {
        /// At this address and port.
        address: SocketAddr,
    },
    /// An attached console shows another view.
    Sit {
        /// What the console now states.
        sitting: ConsolePresence,
    },
}

/// A message from the engine, one JSON document per line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "answer", deny_unknown_fields)]
pub enum ServerMessage {
    /// The first line of every connection.
    Hello {
        /// The engine's [`PROTOCOL`]; a client with another one must disconnect.
        protocol: u32,
        /// Version of the program the engine is part of.
        version: String,
        /// Process id of the engine.
        process: u32,
    },
    /// The answer to one [`ClientMessage::Ask`], in the order of the calls.
    Reply {
        /// The engine's reply.
        reply: Box<Reply>,
    },
    /// Every event after this is sent, except those that an [`ServerMessage::Lagged`] counts.
    Subscribed,
    /// The console is attached: a snapshot comes next, and a new one after each change. Only the newest snapshot and
    /// video frame are sent; a slow reader misses those between.
    Attached {
        /// The number of the attached console.
        seat: u64,
    },
    /// Past events for a console that has just attached: the newest, oldest first. Comes before all others.
    Past {
        /// The last events of this session, without progress; of consecutive sequences only the last.
        events: Vec<Event>,
        /// Number of earlier ones, which only the record has.
        earlier: u64,
    },
    /// The engine ends cleanly: the last line to an attached console.
    Ended {
        /// The person or cause that ended it, in words.
        by: String,
    },
    /// The current state, for attached consoles.
    Snapshot {
        /// All of it.
        snapshot: Box<Snapshot>,
    },
    /// The newest video frame of the live cell, for attached consoles.
    Picture {
        /// The newest one.
        picture: Box<VideoFrame>,
    },
    /// One event of the engine, for a subscriber.
    Event {
        /// What happened, with its number and time.
        event: Box<Event>,
    },
    /// The subscriber was too slow: the oldest events were dropped.
    Lagged {
        /// How many events this subscriber does not get.
        missed: u64,
    },
    /// The engine continues without an attached console.
    Kept,
    /// Whether a program draws the live scene; an event reports the result.
    Scene {
        /// Whether a listener received the request.
        served: bool,
    },
    /// The connection is closed: what was sent is not allowed, or there are too many connections.
    Closed {
        /// Why the connection is closed, one sentence.
        text: String,
    },
}

/// A document with its line break.
///
/// # Errors
/// A value without a JSON form; none of the documents here is one.
pub fn line<T: Serialize>(value: &T) -> Result<String, serde_json::Error> {
    let mut line = serde_json::to_string(value)?;
    line.push('\n');
    Ok(line)
}
