//! Scenes: the live cell during an upgrade, kept in recordings and shown in a rerun viewer.
//!
//! Reads events, snapshots and video frames on its own thread behind a bounded queue. Items that do not fit are dropped
//! and counted; the engine never waits, and no decision depends on this crate. Recordings are read back as plain values
//! ([`holdpoint_recordings::recording::Recording`]) for replay in the terminal.
//!
//! Modules: `feed` is the queue; `router` assigns its items to upgrades; a `writer` keeps one upgrade's file and lets
//! `frame_sampling` select the frames; `drawing` turns values into rows and `rows` turns rows into chunks; `file`
//! frames chunks; `compact` completes and repairs files; `reader` turns a file back into values; `server` serves a live
//! viewer.

mod blueprint;
mod compact;
mod config;
mod decoder_guard;
mod drawing;
pub mod feed;
mod file;
pub mod film_file;
mod frame_sampling;
mod labels;
mod limits;
mod live_view;
mod reader;
mod router;
mod rows;
mod server;
mod sink;
mod size_check;
mod truncated_copy;
mod writer;

pub use config::{ReadError, SceneConfig, SceneError};
pub use reader::read;
pub use sink::SceneSink;
pub use truncated_copy::until;
