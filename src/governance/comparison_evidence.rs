//! Everything measured in one comparison, assessed together: the order in which its parts count.

use crate::behavior::{self, BehaviorAssessment, SequenceEvidence};
use crate::early_stop::EarlyStopReason;
use crate::evidence::{AnchorEvidence, EvidenceBinding, PairedEvidence, RecoveryEvidence};
use crate::outcome::BehaviorOutcome;
use crate::profile::Profile;
use crate::recovery::{self, RecoveryAssessment};

/// The measurements of one comparison.
#[derive(Clone, Copy, Debug)]
pub struct ComparisonEvidence<'a> {
    /// Episodes with the active version, or the one compared with.
    pub pairs: &'a PairedEvidence,
    /// Drills of both.
    pub drills: &'a RecoveryEvidence,
    /// Whether failed stops and rollbacks are settled by more drills, as the sandbox does.
    pub is_settling: bool,
    /// Episodes of the family's anchor; absent if there is no other anchor, or they were not run.
    pub anchor: Option<&'a AnchorEvidence>,
    /// Whole sequences; absent if none were begun.
    pub sequences: Option<&'a SequenceEvidence>,
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
        let Self { pairs, drills, is_settling, anchor, sequences } = *self;
        let mut behavior = behavior::assess_early_stop(pairs, current, profile, ended);
        behavior::apply_anchor(&mut behavior, pairs, anchor, profile);
        let mut recovery = recovery::assess_drills(drills, current, profile, ended);
        let is_open =
            matches!(behavior.assessment.outcome, BehaviorOutcome::Compatible | BehaviorOutcome::Suspicious);
        if is_settling && is_open {
            recovery::apply_settling(&mut recovery, drills);
        }
        behavior::apply_sequences(&mut behavior, sequences, profile);
        (behavior, recovery)
    }
}
