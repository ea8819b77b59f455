//! What a skill is to the runtime: observation in, command out, and no other power.
//!
//! A [`SkillBundle`] is an executable that has been loaded but runs nowhere: it has a digest and
//! tells what its code really offers. A [`Skill`] is one run of it. Neither holds a handle to the
//! robot, a clock, a file or a source of randomness: time arrives in the observation and the seed
//! at the start, so the same bundle can run in the sandbox, against a recorder in shadow, in a
//! twin world or on the arm, and a bundle in another form (a process, a WebAssembly component)
//! can stand behind the same two traits.

pub mod altered;
pub mod native;

use holdpoint_body::{Command, Observation, TaskKind};

use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;

/// An entry point beside the ordinary tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hook {
    /// Come to a standstill in a safe pose and stay there.
    SafeAbort,
    /// Bring the robot to where the predecessor can take over, then say [`Command::Done`].
    Rollback,
}

pub trait SkillBundle: Send + Sync {
    /// SHA-256 over what determines the behaviour.
    fn digest(&self) -> Digest;

    /// What the code really offers and needs; never built from the manifest.
    fn interface(&self) -> Interface;

    /// The primitive the code performs.
    fn task(&self) -> TaskKind;

    /// Begins a run. Equal seeds and equal observations give equal commands. The seed tells nothing of the episode.
    fn start(&self, seed: u64) -> Box<dyn Skill>;
}

/// One run of a bundle.
pub trait Skill: Send {
    /// One decision, [`holdpoint_body::RATE_HZ`] times a second.
    fn tick(&mut self, seen: &Observation) -> Command;

    /// Turns to a hook; ordinary work ends.
    fn enter(&mut self, hook: Hook);

    /// A second run in the state of this one, hook and all: from here on equal observations give both equal
    /// commands. `None` for a run that cannot be copied; whoever wants its state a second time then works
    /// it again from the start, which costs time and changes nothing.
    fn fork(&self) -> Option<Box<dyn Skill>> {
        None
    }
}
