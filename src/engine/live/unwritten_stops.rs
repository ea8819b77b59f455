//! Stops in force that could not be written to the store.

use std::time::Instant;

use holdpoint_protocol::command::StopPersistence;

/// See the module comment.
#[derive(Default)]
pub(crate) struct UnwrittenStops {
    /// The bodies of their records.
    pub(crate) bodies: Vec<String>,
    pub(crate) tried: Option<Instant>,
    /// Whether the first of them is stored beside the record.
    pub(crate) is_marked: bool,
}

impl UnwrittenStops {
    /// Where the stop of the cell is stored.
    pub(crate) const fn stop_storage(&self) -> StopPersistence {
        match (self.bodies.is_empty(), self.is_marked) {
            (true, _) => StopPersistence::OnRecord,
            (false, true) => StopPersistence::InMark,
            (false, false) => StopPersistence::InMemory,
        }
    }
}
