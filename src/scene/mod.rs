//! Scenes: what the live cell does while an upgrade is judged, kept in recordings and shown in a rerun viewer.
//!
//! Another reader of events, snapshots and pictures. It runs on a thread of its own behind a bounded queue: what does
//! not fit is dropped and counted, the engine never waits for it, and no decision hangs on it. Recordings are read
//! back as plain values ([`recording::Recording`]), which is what a replay in the terminal works on.
//!
//! Pieces: `tap` is the queue; `desk` sorts what comes to the upgrades it belongs to; a `writer` keeps one upgrade's
//! file and lets `pace` choose the pictures; `drawing` and its parts turn values into rows, `rows` turns rows into
//! chunks; `file` frames chunks; `compact` ends and mends files; `read` turns a file back into values; `server`
//! serves a live viewer; `shelf` knows the files in a folder, `record` what the audit chain says of them, `viewer` the
//! program that shows them. Without the feature `rerun` only the contract is left, and every call says so.

pub mod record;
pub mod recording;
pub mod shelf;
pub mod tap;
pub mod viewer;

mod config;

#[cfg(feature = "rerun")]
mod blueprint;
#[cfg(feature = "rerun")]
mod compact;
#[cfg(feature = "rerun")]
mod desk;
#[cfg(feature = "rerun")]
mod drawing;
#[cfg(feature = "rerun")]
mod file;
#[cfg(feature = "rerun")]
mod limits;
#[cfg(feature = "rerun")]
mod live;
#[cfg(feature = "rerun")]
mod pace;
#[cfg(feature = "rerun")]
mod read;
#[cfg(feature = "rerun")]
mod rows;
#[cfg(feature = "rerun")]
mod server;
#[cfg(feature = "rerun")]
mod sink;
#[cfg(feature = "rerun")]
mod until;
#[cfg(feature = "rerun")]
mod words;
#[cfg(feature = "rerun")]
mod writer;

#[cfg(not(feature = "rerun"))]
mod absent;

#[cfg(not(feature = "rerun"))]
pub use absent::{Scenes, read, until};
pub use config::{Closed, ReadError, Report, SceneConfig, SceneError, file_stem};
#[cfg(feature = "rerun")]
pub use read::read;
#[cfg(feature = "rerun")]
pub use sink::Scenes;
#[cfg(feature = "rerun")]
pub use until::until;

/// Steps of the timeline `tick` in a second: the cell's ticks, of which [`crate::engine::clock::tick_of`] makes
/// virtual time.
pub const TICKS_PER_SECOND: u64 = 240;

/// What is said where scenes were not built in.
#[cfg(not(feature = "rerun"))]
const NOT_BUILT_IN: &str = "this program was built without scenes. Hint: build it with the feature `rerun`";

/// Whether this program can keep and show scenes.
pub const BUILT_IN: bool = cfg!(feature = "rerun");

#[cfg(test)]
mod tests {
    #[test]
    fn a_second_has_the_cells_ticks() {
        assert_eq!(crate::engine::clock::tick_of(1_000), super::TICKS_PER_SECOND);
    }
}
