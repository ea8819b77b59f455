//! The work that only versions cost which pairs and drills do not reject: when it begins, the anchor's episodes, and the second
//! look of a try.

use super::Evaluation;
use super::plan::NextSlice;
use crate::fault::TrialFault;
use crate::trial_lab::{PairSpot, TrialLab, TrialSubject};
use holdpoint_governance::behavior::{BehaviorAssessment, SequenceEvidence};
use holdpoint_governance::composition::recovery_is_reviewable;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{AnchorEpisode, AnchorEvidence};
use holdpoint_governance::outcome::{BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::profile::Profile;
use holdpoint_governance::recovery::RecoveryAssessment;

impl Evaluation {
    /// Begins what is for versions only that nothing so far rejects: the anchor's episodes, the settling of drills, and
    /// sequences, which are not run with an empty place in the team.
    pub(super) fn begin_late(
        &mut self,
        lab: &TrialLab<'_>,
        candidate: &TrialSubject,
        active: &TrialSubject,
        profile: &Profile,
    ) {
        let Some(next) = self.next_turn().filter(|next| next.is_late()) else { return };
        if self.is_begun(next) {
            return;
        }
        if self.is_lost(profile) {
            self.ended = Some(EarlyStopReason::Full);
            return;
        }
        self.is_late = true;
        self.is_settling |= matches!(next, NextSlice::Settling(_));
        if next == NextSlice::Sequences {
            self.sequences = Some(SequenceEvidence {
                task: candidate.version.bundle.task(),
                sequence: lab.cell.spec.tasks.clone(),
                beside: lab.team.members().iter().map(|party| party.version.id()).collect(),
                wanted: self.plan.sequences,
                pairs: Vec::new(),
            });
            if lab.team.lineup_with(&lab.cell.spec.tasks, active).is_none() {
                self.plan.sequences = 0;
                self.update_end_reason(profile);
            }
        }
    }

    fn is_begun(&self, next: NextSlice) -> bool {
        match next {
            NextSlice::Anchor => self.is_late,
            NextSlice::Sequences => self.sequences.is_some(),
            NextSlice::Pairs | NextSlice::Drills(_) | NextSlice::Settling(_) => self.is_settling,
        }
    }

    /// Begins the second look of a try whose first one leaves the margin open, and nothing else. Returns whether it begins.
    pub(super) fn begin_second_look(&mut self, profile: &Profile) -> bool {
        let Some(pairs) = self.second_look() else { return false };
        let (behavior, recovery) = self.assess(profile);
        let begins = is_try_open(&behavior) && !is_rejected(&recovery, profile);
        if begins {
            self.second_look_from = Some(self.pairs_tried);
            self.plan = self.plan.with_pairs(pairs);
            // The anchor runs the new seeds only if the new pairs reject nothing either.
            self.is_late = false;
        }
        begins
    }

    /// The pairs of the try's second look; `None` if there is none, or it has begun.
    fn second_look(&self) -> Option<u32> {
        let counted = self.counted.as_ref().filter(|_| self.second_look_from.is_none())?;
        Some(counted.second_look()).filter(|pairs| *pairs > self.plan.pairs)
    }

    /// Whether the version is rejected without any further work. A second look may still close an open try: it comes after
    /// the rest, for versions that pass that. A try that the second look leaves open may still be worse than the anchor.
    fn is_lost(&self, profile: &Profile) -> bool {
        // Episodes of the anchor for a part of the pairs are no comparison yet.
        let is_anchored = self.anchored == self.pairs.len() as u64;
        let (behavior, recovery) = self.assess_with(self.anchor().filter(|_| is_anchored), false, profile);
        let is_open =
            matches!(behavior.assessment.outcome, BehaviorOutcome::Compatible | BehaviorOutcome::Suspicious)
                || is_try_open(&behavior)
                    && (self.second_look().is_some() || self.second_look_from.is_some());
        !is_open || is_rejected(&recovery, profile)
    }

    /// Episodes of the anchor on the seeds of the pairs. Returns whether the slice is whole.
    pub(super) fn anchor_slice(&mut self, lab: &TrialLab<'_>) -> Result<bool, TrialFault> {
        let Some(anchor) = &lab.anchor else {
            return Err(TrialFault::Impossible("a comparison with an anchor has none".to_owned()));
        };
        let range = self.progress().range(&self.plan, NextSlice::Anchor);
        let of_range = range.clone().filter_map(|place| self.pairs.get(usize::try_from(place).ok()?));
        let spots: Vec<PairSpot> =
            of_range.map(|pair| PairSpot { seed: pair.seed, live_like: pair.live_like }).collect();
        let open = spots.get(self.part.anchor.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let records = lab.anchor_episodes(anchor, next, &mut self.reuse)?;
        self.part.anchor.extend(records);
        if self.part.anchor.len() < spots.len() {
            return Ok(false);
        }
        self.anchored = range.end;
        let version = anchor.version.id();
        let evidence = self.anchor.get_or_insert(AnchorEvidence { version, episodes: Vec::new() });
        for record in std::mem::take(&mut self.part.anchor) {
            if let Some(values) = record.values() {
                evidence.episodes.push(AnchorEpisode { seed: record.seed, values });
            }
        }
        Ok(true)
    }
}

/// Whether nothing but the margin of its try holds a version.
fn is_try_open(behavior: &BehaviorAssessment) -> bool {
    behavior.assessment.reasons.iter().any(|reason| reason.code == ReasonCode::BehaviorTryOpen)
}

/// Whether recovery rejects a version, and no person may accept that.
fn is_rejected(recovery: &RecoveryAssessment, profile: &Profile) -> bool {
    recovery.assessment.outcome == RecoveryOutcome::Incompatible
        && !(profile.has_approver() && recovery_is_reviewable(&recovery.assessment))
}

#[cfg(test)]
mod tests;
