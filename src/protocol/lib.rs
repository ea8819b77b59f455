//! What is asked of an engine and what it tells: plain serde values, one door for all front ends.
//!
//! Commands go in, events come out, a snapshot says how things stand, a picture what the live cell looks like. The
//! domain's own enums travel as they are. Nothing here acts: the engine checks every command.

mod answer;
pub mod clock;
pub mod command;
pub mod detail;
pub mod event;
pub mod picture;
pub mod sink;
pub mod snapshot;
pub mod wire;
pub mod words;
