//! A component as a loaded executable.
//!
//! Nothing of it is trusted: how it is confined is the business of `holdpoint_component`, what it asks for that of the guard.

use holdpoint_body::TaskKind;
pub use holdpoint_component::keep_compiled_in;
use holdpoint_component::{CodeOrigin, Component};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;

use super::{Skill, SkillBundle};

/// A bundle that brings its own code.
#[derive(Clone, Debug)]
pub struct ComponentBundle(pub Component);

impl SkillBundle for ComponentBundle {
    fn digest(&self) -> Digest {
        self.0.digest()
    }

    fn interface(&self) -> Interface {
        self.0.interface().clone()
    }

    fn task(&self) -> TaskKind {
        self.0.task()
    }

    fn component(&self) -> Option<&Component> {
        Some(&self.0)
    }

    fn refused_form(&self) -> bool {
        self.0.origin() == CodeOrigin::Refused
    }

    fn start(&self, seed: u64) -> Box<dyn Skill> {
        self.0.start(seed)
    }
}
