//! Scenes: what the live cell does while an upgrade is judged, kept in recordings and shown in a rerun viewer.
//!
//! Another reader of events, snapshots and pictures. It runs on a thread of its own behind a bounded queue: what does
//! not fit is dropped and counted, the engine never waits for it, and no decision hangs on it. Recordings are read
//! back as plain values ([`recording::Recording`]), which is what a replay in the terminal works on.

pub mod record;
pub mod recording;
pub mod shelf;
pub mod tap;
pub mod viewer;
