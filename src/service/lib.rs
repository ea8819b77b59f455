//! Hosts the engine for its front ends, in this process and in others.
//!
//! Owns the start of an engine, its thread and handle, the socket with its seats, and the delivery of events to the socket
//! and to the recordings. Must not decide about versions or write to the record: requests go to the pipeline.

pub mod bootstrap;
pub mod control_socket;
pub mod engine_handle;
pub(crate) mod listeners;
pub mod pump;
pub mod recordings;
