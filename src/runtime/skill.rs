//! What a skill is to the runtime: an executable that has been loaded but runs nowhere.
//!
//! A [`SkillBundle`] has a digest and tells what its code really offers; a [`Skill`] is one run of it. Controllers that
//! are compiled in, what is altered around them, and components in WebAssembly stand behind the same two traits.

pub mod altered;
pub mod component;
pub mod native;
pub mod provided;

use holdpoint_body::{BodyError, CodeFault, Command, Observation, TaskKind};

pub use holdpoint_component::{Component, SkillContract};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;
pub use holdpoint_skill::{ConfinementReport, Hook, Skill};

pub trait SkillBundle: Send + Sync {
    /// SHA-256 over what determines the behavior.
    fn digest(&self) -> Digest;

    /// The interface that the code itself states; never built from the manifest.
    fn interface(&self) -> Interface;

    /// The primitive the code performs.
    fn task(&self) -> TaskKind;

    /// The component that it is; `None` for code that is compiled in.
    fn component(&self) -> Option<&Component> {
        None
    }

    /// Whether another file was in the place of its compiled form. That file was not loaded.
    fn refused_form(&self) -> bool {
        false
    }

    /// Begins a run. Equal seeds and equal observations give equal commands. The seed tells nothing of the episode.
    fn start(&self, seed: u64) -> Box<dyn Skill>;
}

/// The command of a skill for this tick.
///
/// # Errors
/// If the machine stalled while its confined code computed: the episode says nothing of the version then.
pub fn next_command(skill: &mut dyn Skill, seen: &Observation) -> Result<Command, BodyError> {
    let command = skill.tick(seen);
    if skill.confined().fault.is_some_and(CodeFault::is_infrastructure) {
        return Err(BodyError::Failed("the machine stalled while the skill computed".to_owned()));
    }
    Ok(command)
}
