//! The border between the engine and a robot cell: the ports of a live cell and of a trial cell, and plain data.
//!
//! The engine knows a cell by this crate alone. It has descriptions, sampled episodes, frames, faults and reports. It
//! computes no physics and decides nothing.

#![warn(missing_docs)]

pub mod distribution;
pub mod envelope;
pub mod episode;
mod error;
pub mod fault;
pub mod film;
pub mod number;
pub mod referee;
pub mod rng;
pub mod scene;
pub mod truth;

pub use distribution::Distribution;
pub use episode::EpisodeSetup;
pub use error::CellError;
pub use fault::InjectedFault;
pub use number::Range;
pub use referee::{RefereeLimits, RefereeReport};
pub use scene::Scene;
