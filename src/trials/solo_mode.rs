//! The modes of the sandbox in which a candidate runs alone: without perturbations, and under stress.
//!
//! Owns their conditions and seeds, and which of their episodes the active version runs too. Judges nothing.

use std::ops::Range;

use holdpoint_governance::evidence::{SandboxMode, SoloEpisode};
use holdpoint_governance::profile::Profile;
use holdpoint_governance::shared_event::SceneKind;
use holdpoint_runtime::task::TaskRecord;

use crate::cell::Conditions;
use crate::fault::TrialFault;
use crate::scene_stops::SceneStops;
use crate::seeds::SeedPurpose;
use crate::stress;
use crate::trial_lab::TrialLab;
use crate::trial_subject::TrialSubject;

/// A mode in which the candidate runs alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SoloMode {
    Canonical,
    /// The sandbox's perturbations under stress.
    Adversarial,
}

impl SoloMode {
    /// The mode in the evidence.
    #[must_use]
    pub const fn mode(self) -> SandboxMode {
        match self {
            Self::Canonical => SandboxMode::Canonical,
            Self::Adversarial => SandboxMode::Adversarial,
        }
    }

    /// The distribution of its episodes.
    #[must_use]
    pub const fn conditions(self) -> Conditions {
        match self {
            Self::Canonical => Conditions::Canonical,
            Self::Adversarial => Conditions::Sandbox,
        }
    }

    /// Runs the candidate's episodes at these places. Where it is stopped or unsafe, the active version runs too, and `stops`
    /// takes in both. Returns the candidate's records, and how many episodes were unsafe for the candidate alone.
    ///
    /// # Errors
    /// If a worker failed or the run was interrupted; the results then permit no conclusion.
    pub fn run(
        self,
        lab: &TrialLab<'_>,
        (candidate, active): (&TrialSubject, &TrialSubject),
        places: Range<u64>,
        profile: &Profile,
        stops: &mut SceneStops,
    ) -> Result<(Vec<TaskRecord>, u32), TrialFault> {
        let (purpose, scene) = match self {
            Self::Canonical => (SeedPurpose::Canonical, SceneKind::Canonical),
            Self::Adversarial => (SeedPurpose::Adversarial, SceneKind::Adversarial),
        };
        let (task, share) = (candidate.version.bundle.task(), profile.evaluation.stress_tightened_share);
        let stress_at =
            |place| (self == Self::Adversarial).then(|| stress::of_episode(place, task, lab.cell, share));
        let work = |subject: &TrialSubject, places: Range<u64>| {
            let terms = subject.terms.clone();
            let terms = match stress_at(places.start) {
                Some(stress) => terms.stressed(stress),
                None => terms,
            };
            lab.episodes(&subject.version, &terms, self.conditions(), purpose, places)
        };
        let mut records = Vec::new();
        match self {
            Self::Canonical => records = work(candidate, places.clone())?,
            Self::Adversarial => {
                for place in places.clone() {
                    records.extend(work(candidate, place..place + 1)?);
                }
            }
        }
        let mut unsafe_alone = 0;
        for (place, record) in places.zip(&records) {
            let is_unsafe =
                |of: &TaskRecord| stress_at(place).is_some_and(|stress| stress::is_unsafe(&stress, of));
            if record.hard_stop.is_some() || is_unsafe(record) {
                for other in work(active, place..place + 1)? {
                    stops.note(scene, record, &other, profile);
                    unsafe_alone += u32::from(is_unsafe(record) && !is_unsafe(&other));
                }
            }
        }
        Ok((records, unsafe_alone))
    }

    /// All records of the mode as the evidence has them; an episode without a result is left out.
    pub fn episodes(self, records: &[TaskRecord]) -> impl Iterator<Item = SoloEpisode> {
        let mode = self.mode();
        (0..).zip(records).filter_map(move |(place, record)| {
            let values = record.values()?;
            Some(SoloEpisode { mode, place, seed: record.seed, values, hard_stop: record.hard_stop })
        })
    }
}
