//! The replay of a recorded upgrade in the terminal: arm and twin, charts, events, a time bar.
//!
//! Structured like the console: a pure reducer ([`update::update`]), views that only read, and a run loop that alone
//! touches terminal and clock. It shows only recorded data: nothing is interpolated between two frames, and an old
//! frame is marked. Must not reach an engine or a store.

pub mod action;
pub mod charts;
pub mod failures;
pub mod frame;
pub mod jump;
pub mod message;
pub mod model;
pub mod playback;
mod print;
mod run;
pub mod speed;
pub mod time_mark;
pub mod timeline;
pub mod update;
pub mod version_status;
pub mod views;

pub use print::print;
pub use run::{ReplayError, ReplayOptions, run, still};

/// The age of a frame from which the view shows it, ms of virtual time.
pub const FRESH_MS: u64 = 500;
