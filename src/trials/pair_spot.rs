//! An episode that both versions of a comparison run: of the sandbox's distribution, or from a live start.
//!
//! Says what determines it and runs it. Which spots there are, the plan of an evaluation says.

use holdpoint_body::TaskKind;
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::task::TaskRecord;

use super::episodes::{alone, pair};
use super::live_start::{self, alone_from_live_start, pair_from_live_start};
use super::sequences::TrialTeam;
use super::trial_subject::TrialSubject;
use super::worker::Worker;
use crate::cell::{Cell, Conditions};

/// See the module's head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PairSpot {
    /// The seed; of a live start, the first one that is tried.
    pub seed: u64,
    /// It begins and is sampled as in the live cell.
    pub live_like: bool,
}

impl PairSpot {
    /// An episode of the sandbox's distribution.
    #[must_use]
    pub const fn in_sandbox(seed: u64) -> Self {
        Self { seed, live_like: false }
    }

    /// What determines the episode of a version.
    pub(super) fn scenario(self, cell: &Cell, team: &TrialTeam, subject: &TrialSubject) -> Digest {
        if self.live_like {
            live_start::key(cell, team, subject, self.seed)
        } else {
            subject.key(cell, Conditions::Sandbox, self.seed)
        }
    }

    /// Everything that is drawn for the episode, if its seed is the one that the record has.
    #[must_use]
    pub fn setup(self, cell: &Cell, team: &TrialTeam, task: TaskKind) -> EpisodeSetup {
        if self.live_like {
            live_start::setup_of(cell, team, task, self.seed)
        } else {
            EpisodeSetup::sample(task, &cell.scene, cell.distribution(Conditions::Sandbox), self.seed)
        }
    }

    /// The episode of one version.
    #[must_use]
    pub fn run(
        self,
        worker: &mut Worker,
        cell: &Cell,
        team: &TrialTeam,
        subject: &TrialSubject,
    ) -> TaskRecord {
        if self.live_like {
            alone_from_live_start(worker, cell, team, subject, self.seed)
        } else {
            alone(worker, subject.trial(cell, Conditions::Sandbox, self.seed))
        }
    }

    /// The episode of both versions.
    #[must_use]
    pub fn run_both(
        self,
        worker: &mut Worker,
        cell: &Cell,
        team: &TrialTeam,
        both: [&TrialSubject; 2],
    ) -> [TaskRecord; 2] {
        if self.live_like {
            pair_from_live_start(worker, cell, team, both, self.seed)
        } else {
            pair(worker, both.map(|subject| subject.trial(cell, Conditions::Sandbox, self.seed)))
        }
    }
}
