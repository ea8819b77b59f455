//! The border between whatever decides and a robot: plain messages, five calls, and the robot's geometry.
//!
//! Governance and the runtime know a robot by this crate alone. The simulated cell implements [`Body`]; a bridge to a
//! real robot or to a hard real-time substrate stands behind the same five calls.

#![warn(missing_docs)]

pub mod chain;
pub mod clearance;
mod command_check;
pub mod disturbance;
mod further_object;
pub mod geometry;
pub mod ik;
mod messages;
pub mod number;
pub mod shape;
mod standstill;
pub mod task;
pub mod zone;

pub use command_check::check_command;
pub use further_object::{FURTHER_OBJECTS_MAX, FurtherObject, FurtherProblem, FurtherShape};
pub use geometry::Geometry;
pub use messages::*;
pub use shape::Shape;
pub use standstill::Standstill;
pub use task::TaskKind;
pub use zone::Zone;

use serde::{Deserialize, Serialize};

/// Why a body could not carry out a tick. Never a failure of the skill.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum BodyError {
    /// A command that cannot be carried out: not a number, or zero or less for a value that must be above zero.
    #[error("command refused: {0}")]
    Command(String),
    /// The body's state stopped being finite or left the cell.
    #[error("the world diverged at tick {tick}: {what}")]
    Diverged {
        /// Tick of the body at which it was noticed.
        tick: u64,
        /// The quantity that is not usable.
        what: String,
    },
    /// The body failed in another way.
    #[error("{0}")]
    Failed(String),
    /// The body does not answer any more, or has stopped by itself: a person has to look.
    #[error("{0}")]
    Lost(String),
}

/// A robot as the runtime governs it: one observation, one command, one tick.
///
/// All numbers are SI, poses in the world frame (z up, the robot's base at the origin); a tick is
/// [`TICK_SECS`].
pub trait Body {
    /// What a skill may see now. `last` is what became of its previous command.
    fn observe(&mut self, last: GuardVerdict) -> Observation;
    /// What the watcher and the monitor may see now.
    fn telemetry(&self) -> Telemetry;
    /// Sends one command and lets one tick pass.
    ///
    /// # Errors
    /// [`BodyError::Command`] for a command that cannot be carried out; the other kinds if the body has failed (for
    /// a simulator: a state that is not finite).
    fn step(&mut self, command: &Command) -> Result<(), BodyError>;
    /// From outside the skill: stop, or take commands again.
    fn interrupt(&mut self, interrupt: Interrupt);
    /// Whether the work was done, by inspection after the task.
    fn inspect(&self) -> bool;
}

impl<B: Body + ?Sized> Body for Box<B> {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        (**self).observe(last)
    }
    fn telemetry(&self) -> Telemetry {
        (**self).telemetry()
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        (**self).step(command)
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        (**self).interrupt(interrupt);
    }
    fn inspect(&self) -> bool {
        (**self).inspect()
    }
}
