//! What stages 6 and 7 work on: the live cell under watch, and the record of it.

use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

use crate::binding::terms_of;
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::monitors::Monitors;
use crate::record::Record;
use crate::stages::resume::Resumption;
use crate::world::LiveWorld;

/// Everything that a stage may touch that moves the arm: neither prompts nor evaluations.
pub struct Live<'a> {
    /// What is judged under.
    pub context: &'a Context,
    /// Seed of the run.
    pub seed: u64,
    pub record: &'a mut Record,
    pub dossiers: &'a mut Dossiers,
    pub monitors: &'a mut Monitors,
    /// Arm, agent and world.
    pub world: &'a mut LiveWorld,
    /// Predecessors whose first tasks are looked at.
    pub resumptions: &'a mut Vec<Resumption>,
}

impl Live<'_> {
    /// What a version runs under now.
    #[must_use]
    pub fn terms_of(&self, version: &Capability) -> SkillTerms {
        terms_of(self.context, self.dossiers, self.monitors, version)
    }
}
