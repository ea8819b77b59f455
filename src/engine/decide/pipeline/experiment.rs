//! What an experiment may do with a pipeline that a deployment may not: let a drift set in without a record, blind the
//! monitors, look at ground truth, and work the live world with or without the monitors.
//!
//! An experiment uses its pipeline up, so a running engine has none of this but a look at ground truth. The work itself is
//! the pipeline's own; nothing here decides or shortens anything.

use holdpoint_body::disturbance::Drift;
use holdpoint_cell::{CellError, RefereeLimits};

use super::Pipeline;
use crate::Engine;
use crate::fault::EngineFault;
use crate::live::listener::NoListener;
use crate::live::monitors::terms_of;
use crate::live::station::{SequenceReport, TaskTruth};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::monitor::Rate;
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::seeds::{SeedPurpose, episode_seed};

/// A pipeline in the hands of an experiment.
pub struct ExperimentPipeline(Pipeline);

impl Pipeline {
    /// From now on it serves an experiment and nothing else: a referee looks on, and the live world goes on with this
    /// sequence number.
    #[must_use]
    pub fn rehearse(mut self, sequence: u64) -> ExperimentPipeline {
        self.world.cell.call_referee(RefereeLimits::default());
        self.world.cell.skip_to(sequence);
        ExperimentPipeline(self)
    }
}

impl Engine {
    /// From now on a referee looks on in the live cell, for the report of an experiment.
    pub fn call_referee(&mut self) {
        self.pipeline.world.cell.call_referee(RefereeLimits::default());
    }

    /// Ground truth of live tasks since the last call; empty if no referee looks on.
    pub fn take_verdicts(&mut self) -> Vec<TaskTruth> {
        self.pipeline.world.cell.take_verdicts()
    }
}

impl ExperimentPipeline {
    /// Lets a drift set in, or ends it. Nothing of it is written.
    ///
    /// # Errors
    /// If the drifted distribution is not valid.
    pub fn set_drift(&mut self, drift: Option<Drift>) -> Result<(), CellError> {
        self.0.world.cell.set_drift(drift)
    }

    /// The monitors of the versions that are watched now see nothing of these rates.
    pub fn blind(&mut self, rates: &[Rate]) {
        for watched in self.0.monitors.iter_mut() {
            watched.monitor.disable_rates(rates);
        }
        self.0.live_harm.set_blind(rates.contains(&Rate::Harm));
    }

    /// One sequence under the monitors, after a look at their deadlines: what a slice of the engine's does.
    ///
    /// # Errors
    /// [`EngineFault`] of the pipeline's own.
    pub fn run_monitored(&mut self) -> Result<SequenceReport, EngineFault> {
        self.0.look_at_deadlines()?;
        self.0.live().sequence(None)
    }

    /// Runs one sequence with the active versions, without monitors. Writes nothing.
    pub fn run_unmonitored(&mut self) -> SequenceReport {
        let Pipeline { context, record, evidence_files, monitors, world, .. } = &mut self.0;
        let run_seed = record.seeds().of_run().unwrap_or_default();
        let seed = episode_seed(run_seed, SeedPurpose::Live, world.cell.sequences());
        let terms: Vec<(CapabilityId, SkillTerms)> = world
            .cell
            .tasks()
            .iter()
            .filter_map(|task| record.active_of(&Family::from(*task)))
            .map(|active| {
                (active.id(), terms_of(context, record.version_table(), evidence_files, monitors, &active))
            })
            .collect();
        let spare = context.terms();
        let choose = |capability: &Capability| {
            let id = capability.id();
            let known = terms.iter().find(|(known, _)| *known == id);
            known.map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        world.cell.run_sequence(record.version_table(), &choose, seed, &mut NoListener, None)
    }

    /// Ground truth since the last call.
    pub fn take_verdicts(&mut self) -> Vec<TaskTruth> {
        self.0.world.cell.take_verdicts()
    }

    /// Events since the last call, in order.
    pub fn drain_events(&mut self) -> Vec<EventKind> {
        self.0.drain_events()
    }
}
