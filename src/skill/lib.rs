//! What a skill is: observation in, command out, and no other power; and the controllers written to it.
//!
//! A [`Skill`] is one run of one task. It holds no handle to the robot, a clock, a file or a source of randomness:
//! time arrives in the observation and the seed at the start. So the same code runs in the sandbox, against a
//! recorder in shadow, in a twin or on the arm, compiled into the engine or confined as a WebAssembly component: this
//! crate depends on the messages alone, and builds for both.

pub mod align;
pub mod grasp;
pub mod motion;
pub mod park;
pub mod phases;
pub mod place;

use holdpoint_body::{CodeFault, Command, Observation};

/// An entry point beside the ordinary tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hook {
    /// Come to a standstill in a safe pose and stay there.
    SafeAbort,
    /// Bring the robot to where the predecessor can take over, then say [`Command::Done`].
    Rollback,
}

/// What a run of confined code has used, and whether it failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConfinementReport {
    /// The most that a tick needed, in the fuel of its confinement; 0 for code that is compiled in.
    pub fuel_tick_max: u64,
    /// The most memory it had, bytes; 0 for code that is compiled in.
    pub memory_bytes: u64,
    /// How its code failed; from then on it asks for nothing.
    pub fault: Option<CodeFault>,
}

/// One run of a skill's code.
pub trait Skill: Send {
    /// One decision, [`holdpoint_body::RATE_HZ`] times a second.
    fn tick(&mut self, seen: &Observation) -> Command;

    /// Turns to a hook; ordinary work ends.
    fn enter(&mut self, hook: Hook);

    /// A second run in the state of this one, hook and all: from here on equal observations give both equal commands.
    /// `None` for a run that cannot be copied; the caller then re-runs the task from the start, which costs time and
    /// gives the same result.
    fn fork(&self) -> Option<Box<dyn Skill>> {
        None
    }

    /// What it has used of its confinement so far. Code that is compiled in is not confined.
    fn confined(&self) -> ConfinementReport {
        ConfinementReport::default()
    }
}
