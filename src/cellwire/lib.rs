//! A robot cell in another process: the calls of its ports over a Unix socket or loopback TCP.
//!
//! [`server`] offers the cells of a factory, and [`client`] is a factory whose cells are at an endpoint. [`messages`] has
//! what passes between them, [`framing`] how, and [`refusal`] why a call has no effect. The page `cell-protocol` of the
//! guide specifies all of it, and [`check`](mod@check) holds a cell to it. This crate computes no physics and decides nothing.

#![warn(missing_docs)]

pub mod check;
pub mod client;
pub mod endpoint;
pub mod framing;
pub mod messages;
pub mod refusal;
pub mod server;

#[cfg(test)]
mod fake_cell;
#[cfg(test)]
mod tests;

pub use client::{Deadlines, WireFactory};
pub use endpoint::{Endpoint, EndpointError};
pub use framing::WireError;
pub use server::{CellServer, ServerOptions};
