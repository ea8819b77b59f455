//! Everything measured in one comparison, assessed together: the order in which its parts count.

use crate::behavior::{self, BehaviorAssessment, SequenceEvidence};
use crate::early_stop::EarlyStopReason;
use crate::evidence::{AnchorEvidence, EvidenceBinding, PairedEvidence, RecoveryEvidence};
use crate::outcome::{BehaviorOutcome, RecoveryOutcome};
use crate::profile::Profile;
use crate::recovery::{self, RecoveryAssessment};
use crate::tries::CountedTry;

/// The measurements of one comparison.
#[derive(Clone, Copy, Debug)]
pub struct ComparisonEvidence<'a> {
    /// Episodes with the active version, or the one compared with.
    pub pairs: &'a PairedEvidence,
    /// Drills of both.
    pub drills: &'a RecoveryEvidence,
    /// Whether failed stops and rollbacks are settled by more drills, as the sandbox does.
    pub is_settling: bool,
    /// Whether a third of the pairs has to be live-like, as in sandbox and confirmation.
    pub has_live_like: bool,
    /// Whether the family has another anchor, so that a version which nothing rejects has to be compared with it.
    pub has_anchor: bool,
    /// Episodes of the anchor; absent if there is no other anchor, or they were not run.
    pub anchor: Option<&'a AnchorEvidence>,
    /// Whole sequences; absent if none were begun.
    pub sequences: Option<&'a SequenceEvidence>,
    /// The try that it counts as, whose pairs are its budget; absent outside the sandbox, and in evidence of older builds.
    pub counted: Option<&'a CountedTry>,
}

impl ComparisonEvidence<'_> {
    /// Behavior and recovery; `current` is what evidence has to be bound to now. The anchor, the settling of drills and the sequences count only for a version that the
    /// parts before them do not reject.
    #[must_use]
    pub fn assess(
        &self,
        current: &EvidenceBinding,
        ended: EarlyStopReason,
        profile: &Profile,
    ) -> (BehaviorAssessment, RecoveryAssessment) {
        let Self { pairs, drills, is_settling, has_live_like, has_anchor, anchor, sequences, counted } =
            *self;
        let budget =
            counted.map_or(profile.evaluation.sandbox_pairs, |counted| counted.look(pairs.pairs.len()));
        let profile = &profile.with_sandbox_pairs(budget);
        let mut behavior = behavior::assess_early_stop(pairs, current, profile, ended);
        if has_live_like {
            behavior::apply_live_like(&mut behavior, pairs, profile);
        }
        let mut recovery = recovery::assess_drills(drills, current, profile, ended);
        let is_rejected = recovery.assessment.outcome == RecoveryOutcome::Incompatible;
        match anchor {
            Some(anchor) => behavior::apply_anchor(&mut behavior, pairs, anchor, profile),
            None if has_anchor && !is_rejected => behavior::require_anchor(&mut behavior),
            None => {}
        }
        let is_open =
            matches!(behavior.assessment.outcome, BehaviorOutcome::Compatible | BehaviorOutcome::Suspicious);
        if is_settling && is_open {
            recovery::apply_settling(&mut recovery, drills, &profile.recovery);
        }
        behavior::apply_sequences(&mut behavior, sequences, profile);
        if let Some(counted) = counted {
            behavior::apply_try(&mut behavior, &pairs.pairs, counted, profile);
        }
        (behavior, recovery)
    }
}
