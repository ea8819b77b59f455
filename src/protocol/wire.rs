//! What goes over the socket: one JSON document a line, each side's lines of bounded length.

use std::net::SocketAddr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::command::{Reply, Request};
use crate::event::Event;
use crate::picture::Picture;
use crate::seat::Sitting;
use crate::snapshot::Snapshot;

/// Raised when either side's documents change; both sides must have the same.
pub const PROTOCOL: u32 = 9;

/// The longest line a client may send, bytes: the largest component has room in it, in the letters of a package's JSON.
pub const CALL_BYTES_MAX: usize = 4 * 1024 * 1024;

/// The longest line an engine sends, bytes.
pub const ANSWER_BYTES_MAX: usize = 16 * 1024 * 1024;

/// The longest id of a command, bytes.
pub const ID_BYTES_MAX: usize = 128;

/// What a client sends, one JSON document a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "call", deny_unknown_fields)]
pub enum Call {
    /// One request, answered by one [`Answer::Reply`].
    Ask {
        /// The command, with the id that makes a retry harmless.
        request: Box<Request>,
    },
    /// From now on this connection only carries events.
    Subscribe {},
    /// From now on this connection carries events, the newest snapshot and the newest picture, and takes nothing but
    /// [`Call::Sit`]. Whatever is asked goes over another one.
    Attach {
        /// Who sits down.
        sitting: Sitting,
    },
    /// The engine is to go on when nobody sits at it any more, answered by one [`Answer::Kept`].
    Keep {},
    /// The live scene is to be served to viewers, answered by one [`Answer::Scene`].
    Scene {
        /// At this address and port.
        address: SocketAddr,
    },
    /// Somebody who is attached has something else before them.
    Sit {
        /// What they say of themselves now.
        sitting: Sitting,
    },
}

/// What the engine's side sends, one JSON document a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "answer", deny_unknown_fields)]
pub enum Answer {
    /// The first line of every connection.
    Hello {
        /// The engine's [`PROTOCOL`]; a client with another one has to leave.
        protocol: u32,
        /// Version of the program the engine is part of.
        version: String,
        /// Process id of the engine.
        process: u32,
    },
    /// The answer to one [`Call::Ask`], in the order of the calls.
    Reply {
        /// What the engine answered.
        reply: Box<Reply>,
    },
    /// Every event after this is sent, except those that an [`Answer::Lagged`] counts.
    Subscribed,
    /// The connection is a seat now: a snapshot comes next, and a new one whenever something changed. Of snapshots and
    /// pictures the newest one alone is sent; a slow reader misses those between.
    Attached {
        /// The number of the seat.
        seat: u64,
    },
    /// What happened before, for whoever has just attached: the newest events, oldest first. Comes before all others.
    Past {
        /// The last of this engine's life, without progress; of sequences one after the other the last alone.
        events: Vec<Event>,
        /// How many of such came before them, and are on record alone.
        earlier: u64,
    },
    /// The engine ends in good order, for whoever is attached: the last line.
    Ended {
        /// Who ended it, in words.
        by: String,
    },
    /// How things stand, for whoever is attached.
    Snapshot {
        /// All of it.
        snapshot: Box<Snapshot>,
    },
    /// What the live cell looks like, for whoever is attached.
    Picture {
        /// The newest one.
        picture: Box<Picture>,
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
    /// The engine goes on when nobody sits at it any more.
    Kept,
    /// Whether there is somebody who draws the live scene; what came of it is told as an event.
    Scene {
        /// Whether it was handed on.
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
