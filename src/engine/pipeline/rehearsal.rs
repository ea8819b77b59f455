//! What an experiment may do with a manager that a deployment does not: let a drift set in, look at ground truth,
//! and work the live world with or without the monitors.
//!
//! The work itself is the pipeline's own; nothing here decides or shortens anything.

use holdpoint_body::TaskKind;
use holdpoint_sim::SimError;
use holdpoint_sim::distribution::Drift;
use holdpoint_sim::referee::{RefereeLimits, RefereeReport};

use super::live::{Nobody, SequenceReport};
use super::manager::{Fault, UpgradeManager};
use super::seeds::{Purpose, episode_seed};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::Terms;

/// Ground truth of a task: its sequence, the version at work, what the referee saw.
pub type Verdict = (u64, CapabilityId, RefereeReport);

impl UpgradeManager {
    /// From now on a referee looks on; the live world goes on with this sequence number.
    pub fn begin_rehearsal(&mut self, sequence: u64) {
        self.live.call_referee(RefereeLimits::default());
        self.live.skip_to(sequence);
    }

    /// Lets a drift set in, or ends it.
    ///
    /// # Errors
    /// Where the drifted distribution is not valid.
    pub fn set_drift(&mut self, drift: Option<Drift>) -> Result<(), SimError> {
        self.live.set_drift(drift)
    }

    /// One sequence under the monitors, after a look at their deadlines: what a slice of the engine's does.
    ///
    /// # Errors
    /// [`Fault`] of the pipeline's own.
    pub fn work_watched(&mut self) -> Result<SequenceReport, Fault> {
        self.look_at_deadlines()?;
        self.live_sequence(None)
    }

    /// One sequence of the versions that are active now, with nobody who would take one off. Nothing is written.
    pub fn work_unwatched(&mut self) -> SequenceReport {
        let seed = episode_seed(self.seed, Purpose::Live, self.live.sequences());
        let terms: Vec<(CapabilityId, Terms)> = TaskKind::SEQUENCE
            .into_iter()
            .filter_map(|task| self.active_of(&Family::from(task)))
            .map(|active| (active.id(), self.terms_of(&active)))
            .collect();
        let spare = self.terms_of_profile();
        let choose = |capability: &Capability| {
            let id = capability.id();
            let known = terms.iter().find(|(known, _)| *known == id);
            known.map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        self.live.run_sequence(&self.ledger, &choose, seed, &mut Nobody, None)
    }

    /// Ground truth since the last call.
    pub fn take_verdicts(&mut self) -> Vec<Verdict> {
        self.live.take_verdicts()
    }

    /// The version of a family that is in control.
    #[must_use]
    pub fn in_control(&self, family: &Family) -> Option<CapabilityId> {
        self.active_of(family).map(|active| active.id())
    }
}
