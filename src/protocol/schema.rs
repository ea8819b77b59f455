//! The messages of the socket as JSON schemas, for the authors of clients in other languages.

use schemars::{Schema, schema_for};

use super::command::{Command, Reply, Request};
use super::event::Event;
use super::snapshot::Snapshot;
use super::video_frame::VideoFrame;
use super::wire::{ClientMessage, ServerMessage};

/// Names of the published documents, as `holdpoint schema` takes them.
pub const NAMES: [&str; 10] =
    ["call", "answer", "request", "command", "reply", "event", "snapshot", "detail", "picture", "film"];

/// The documents of [`NAMES`] with their schemas.
#[must_use]
pub fn documents() -> [(&'static str, Schema); NAMES.len()] {
    [
        ("call", schema_for!(ClientMessage)),
        ("answer", schema_for!(ServerMessage)),
        ("request", schema_for!(Request)),
        ("command", schema_for!(Command)),
        ("reply", schema_for!(Reply)),
        ("event", schema_for!(Event)),
        ("snapshot", schema_for!(Snapshot)),
        ("detail", schema_for!(super::detail::Detail)),
        ("picture", schema_for!(VideoFrame)),
        ("film", schema_for!(super::film::Film)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documents_have_the_names() {
        assert_eq!(documents().map(|(name, _)| name), NAMES);
    }

    /// A closed set is listed word by word, so that a client can know it.
    #[test]
    fn closed_sets_are_in_the_schemas() {
        let documents = documents();
        let text = |name: &str| {
            let (_, schema) = documents.iter().find(|(known, _)| *known == name).unwrap();
            serde_json::to_string(schema).unwrap()
        };
        for value in ["\"doubt-remains\"", "\"rolled-back\"", "\"unacknowledged\"", "\"sensor_noise\""] {
            assert!(text("event").contains(value), "{value}");
        }
        assert!(text("call").contains("\"acknowledge-alarm\""));
        assert!(text("answer").contains("\"lagged\""));
    }
}
