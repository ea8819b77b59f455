//! The pairs of an evaluation: where each begins, and a slice of them.

use super::plan::{EvaluationProgress, NextSlice};
use super::{Evaluation, PairRun};
use crate::fault::TrialFault;
use crate::trial_lab::{PairSpot, TrialLab, TrialSubject};
use holdpoint_governance::evidence::Pair;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::shared_event::SceneKind;

impl Evaluation {
    /// The spots of the next pairs.
    pub(super) fn pair_spots(&self, lab: &TrialLab<'_>, progress: &EvaluationProgress) -> Vec<PairSpot> {
        let seed = |index| lab.seeds.seed(self.plan.pair_seeds, index);
        // The pairs of a second look have an order of their own.
        let (from, plan) = match (self.second_look_from, &self.counted) {
            (Some(from), Some(counted)) => (from, self.plan.with_pairs(self.plan.pairs - counted.pairs)),
            _ => (0, self.plan),
        };
        let places = plan.live_like_places(seed(from));
        // A pair past the budget replaces one without a result.
        let replaces = self.plan.live_like > 0;
        let is_live_like = |index: u64| {
            let place = usize::try_from(index - from).ok().and_then(|place| places.get(place).copied());
            place.unwrap_or(replaces)
        };
        let range = progress.range(&self.plan, NextSlice::Pairs);
        range.map(|index| PairSpot { seed: seed(index), live_like: is_live_like(index) }).collect()
    }

    /// Runs a part of a slice. Returns its pairs once the slice is whole.
    pub(super) fn pair_slice(
        &mut self,
        lab: &TrialLab<'_>,
        candidate: &TrialSubject,
        active: &TrialSubject,
        profile: &Profile,
    ) -> Result<Option<Vec<PairRun>>, TrialFault> {
        let spots = self.pair_spots(lab, &self.progress());
        let open = spots.get(self.part.pairs.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let worked = lab.pairs(candidate, active, next, &mut self.reuse)?;
        self.part.pairs.extend(worked);
        if self.part.pairs.len() < spots.len() {
            return Ok(None);
        }
        let records = std::mem::take(&mut self.part.pairs);
        self.pairs_tried += spots.len() as u64;
        let task = candidate.version.bundle.task();
        let mut runs = Vec::with_capacity(spots.len());
        for (PairSpot { live_like, .. }, (new, old)) in spots.into_iter().zip(records) {
            self.stops.note(SceneKind::Pair, &new, &old, profile);
            let seed = new.seed;
            if let (Some(candidate), Some(active)) = (new.values(), old.values()) {
                self.pairs.push(Pair { seed, active, candidate, live_like });
            }
            let setup = PairSpot { seed, live_like }.setup(lab.cell, &lab.team, task);
            runs.push(PairRun { setup, candidate: new, active: old });
        }
        Ok(Some(runs))
    }
}
