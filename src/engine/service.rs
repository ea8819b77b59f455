//! Hosts the engine for its front ends, in this process and in others.
//!
//! Owns the start of an engine, its thread and handle, the socket with its seats, the delivery of events to the socket and
//! to the recordings, the stop mark, and the clock file. Must not decide about versions or write to the record: requests
//! go to the pipeline.

pub mod bootstrap;
pub mod caller;
pub mod control_socket;
pub mod engine_handle;
pub(crate) mod listeners;
pub(crate) mod persisted_clock;
pub mod pump;
pub mod recordings;
pub(crate) mod stop_mark;
