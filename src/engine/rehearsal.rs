//! What an experiment may do with a pipeline that a deployment does not: let a drift set in, look at ground truth,
//! and work the live world with or without the monitors.
//!
//! The work itself is the pipeline's own; nothing here decides or shortens anything.

use holdpoint_body::TaskKind;
use holdpoint_sim::SimError;
use holdpoint_sim::distribution::Drift;
use holdpoint_sim::referee::RefereeLimits;

use crate::binding::terms_of;
use crate::fault::Fault;
use crate::pipeline::Pipeline;
use crate::trial::seeds::{Purpose, episode_seed};
use crate::world::listener::Nobody;
use crate::world::live::{SequenceReport, TaskTruth};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

impl Pipeline {
    /// From now on a referee looks on; the live world goes on with this sequence number.
    pub fn begin_rehearsal(&mut self, sequence: u64) {
        self.world.cell.call_referee(RefereeLimits::default());
        self.world.cell.skip_to(sequence);
    }

    /// Sequences that the live world has begun.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.world.cell.sequences()
    }

    /// Lets a drift set in, or ends it.
    ///
    /// # Errors
    /// If the drifted distribution is not valid.
    pub fn set_drift(&mut self, drift: Option<Drift>) -> Result<(), SimError> {
        self.world.cell.set_drift(drift)
    }

    /// One sequence under the monitors, after a look at their deadlines: what a slice of the engine's does.
    ///
    /// # Errors
    /// [`Fault`] of the pipeline's own.
    pub fn work_watched(&mut self) -> Result<SequenceReport, Fault> {
        self.look_at_deadlines()?;
        self.live().sequence(None)
    }

    /// One sequence of the versions that are active now, with nobody who would take one off. Nothing is written.
    pub fn work_unwatched(&mut self) -> SequenceReport {
        let seed = episode_seed(self.trials.seed(), Purpose::Live, self.world.cell.sequences());
        let terms: Vec<(CapabilityId, SkillTerms)> = TaskKind::SEQUENCE
            .into_iter()
            .filter_map(|task| self.record.active_of(&Family::from(task)))
            .map(|active| (active.id(), terms_of(&self.context, &self.dossiers, &self.monitors, &active)))
            .collect();
        let spare = self.context.terms();
        let choose = |capability: &Capability| {
            let id = capability.id();
            let known = terms.iter().find(|(known, _)| *known == id);
            known.map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        self.world.cell.run_sequence(self.record.ledger(), &choose, seed, &mut Nobody, None)
    }

    /// Ground truth since the last call.
    pub fn take_verdicts(&mut self) -> Vec<TaskTruth> {
        self.world.cell.take_verdicts()
    }

    /// The version of a family that is in control.
    #[must_use]
    pub fn in_control(&self, family: &Family) -> Option<CapabilityId> {
        self.record.active_of(family).map(|active| active.id())
    }
}
