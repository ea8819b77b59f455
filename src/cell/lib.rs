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
mod port;
pub mod referee;
pub mod rng;
pub mod scene;
pub mod spec;
mod state;
pub mod truth;

pub use distribution::Distribution;
pub use episode::EpisodeSetup;
pub use error::CellError;
pub use fault::InjectedFault;
pub use number::Range;
pub use port::{CellFactory, CellSource, FixtureBox, LiveCell, RobotCell, TrialCell, WorkCall};
pub use referee::{Referee, RefereeLimits, RefereeReport};
pub use scene::Scene;
pub use spec::CellSpec;
pub use state::{CellCopy, StateImage};
