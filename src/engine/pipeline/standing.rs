//! How the manager stands, for whoever looks: nothing here changes anything.

use super::dossier::Dossier;
use super::ledger::Ledger;
use super::manager::UpgradeManager;
use super::portrait;
use holdpoint_body::rehearsal::{Drift, LiveFault};
use holdpoint_governance::alarms::AlarmBook;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::profile::Profile;
use holdpoint_protocol::picture::Scenery;

impl UpgradeManager {
    /// The profile.
    #[must_use]
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The robot's name.
    #[must_use]
    pub fn robot(&self) -> &str {
        &self.cell.model.name
    }

    /// The run's seed.
    #[must_use]
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// Digest of profile and policies.
    #[must_use]
    pub const fn context_digest(&self) -> Digest {
        self.context_digest
    }

    /// Hash of the agent's identity.
    #[must_use]
    pub const fn agent_hash(&self) -> Digest {
        self.live.agent_hash()
    }

    /// A candidate's evidence.
    #[must_use]
    pub fn dossier_of(&self, id: &CapabilityId) -> Option<&Dossier> {
        self.dossiers.get(id)
    }

    /// The alarms.
    #[must_use]
    pub const fn alarm_book(&self) -> &AlarmBook {
        &self.alarms
    }

    /// Success of the last live sequences, and the tasks of the last one.
    #[must_use]
    pub fn recent_work(&self) -> (Vec<bool>, &[holdpoint_protocol::event::TaskSummary]) {
        (self.recent.iter().copied().collect(), &self.last_tasks)
    }

    /// Live sequences worked.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.live.sequences()
    }

    /// The drift that has set in.
    #[must_use]
    pub const fn present_drift(&self) -> Option<Drift> {
        self.live.drift().copied()
    }

    /// What is broken in the live world.
    #[must_use]
    pub const fn present_fault(&self) -> Option<LiveFault> {
        self.live.fault()
    }

    /// What stands round the robot.
    #[must_use]
    pub fn scenery(&self) -> Scenery {
        portrait::scenery(&self.cell.scene)
    }

    /// Simulated seconds in a second; absent for as fast as it computes.
    #[must_use]
    pub const fn pace(&self) -> Option<f64> {
        self.pace
    }

    /// Episodes of a family's provisional window: worked and needed.
    #[must_use]
    pub fn provisional(&self, family: &Family) -> Option<(u32, u32)> {
        let watch = self.watches.get(family).filter(|watch| !watch.confirmed)?;
        Some((watch.episodes, self.profile.activation.provisional_episodes))
    }

    /// The ledger, to look at.
    #[must_use]
    pub const fn ledger(&self) -> &Ledger {
        &self.ledger
    }
}
