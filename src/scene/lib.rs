//! Scenes: what the live cell does while an upgrade is judged, kept in recordings and shown in a rerun viewer.
//!
//! Another reader of events, snapshots and pictures. It runs on a thread of its own behind a bounded queue: what does
//! not fit is dropped and counted, the engine never waits for it, and no decision hangs on it. Recordings are read
//! back as plain values ([`holdpoint_recordings::recording::Recording`]), which is what a replay in the terminal works
//! on.
//!
//! Pieces: `feed` is the queue; `router` sorts what comes to the upgrades it belongs to; a `writer` keeps one upgrade's
//! file and lets `pace` choose the pictures; `drawing` and its parts turn values into rows, `rows` turns rows into
//! chunks; `file` frames chunks; `compact` ends and mends files; `read` turns a file back into values; `server`
//! serves a live viewer.

mod blueprint;
mod compact;
mod config;
mod credible;
mod drawing;
pub mod feed;
mod file;
pub mod film;
mod guarded;
mod limits;
mod live;
mod pace;
mod read;
mod router;
mod rows;
mod server;
mod sink;
mod until;
mod words;
mod writer;

pub use config::{ReadError, SceneConfig, SceneError};
pub use read::read;
pub use sink::Scenes;
pub use until::until;
