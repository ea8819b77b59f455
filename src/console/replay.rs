//! The replay of a recorded upgrade in the terminal: arm and twin, charts, events, a time bar.
//!
//! Built as the console is: a pure reducer ([`update::update`]), views that only read, and a run loop that alone
//! touches the terminal and the clock. What is shown was recorded: between two pictures nothing is made up, and a
//! picture that is old says so. Must not reach an engine or a store: a replay changes nothing and asks nobody.

pub mod action;
pub mod charts;
pub mod frame;
pub mod jump;
pub mod mark;
pub mod model;
pub mod playing;
mod print;
mod run;
pub mod speed;
pub mod standing;
pub mod timeline;
pub mod update;
pub mod views;

pub use print::print;
pub use run::{ReplayError, ReplayOptions, run, still};

/// How old a picture may be before its age is said, ms of virtual time.
pub const FRESH_MS: u64 = 500;
