//! The one door: commands in, events out, a snapshot for whoever looks.
pub mod clock;
pub mod command;
pub mod event;
pub mod snapshot;
