//! Scenes: what the live cell does while an upgrade is judged, kept in recordings and shown in a rerun viewer.
//!
//! Another reader of events, snapshots and pictures. It runs on a thread of its own behind a bounded queue: what does
//! not fit is dropped and counted, the engine never waits for it, and no decision hangs on it. Recordings are read
//! back as plain values ([`recording::Recording`]), which is what a replay in the terminal works on.

pub mod record;
pub mod recording;
pub mod shelf;
pub mod tap;
pub mod viewer;

/// Steps of the timeline `tick` in a second.
pub const TICKS_PER_SECOND: u64 = 240;

/// SHIM until the reader is there.
///
/// # Errors
/// Always.
pub fn read(_path: &std::path::Path) -> Result<recording::Recording, ReadError> {
    Err(ReadError)
}

/// SHIM until the reader is there.
///
/// # Errors
/// Always.
pub fn until(_path: &std::path::Path, _tick: u64, _out: &std::path::Path) -> Result<(), ReadError> {
    Err(ReadError)
}

/// SHIM.
#[derive(Debug, thiserror::Error)]
#[error("this program was built without scenes. Hint: build it with the feature `rerun`")]
pub struct ReadError;
