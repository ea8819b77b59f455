//! The concern that a version may be activated with, and the evidence that settles it.
//!
//! Inconclusive behavior, and recovery that is fragile or worse than that of the rollback target, advance under restrictions.
//! The concern stays until new evidence settles it (design rules 3.6, 3.8). A version whose live behavior shifts is a concern
//! as well.

use holdpoint_body::disturbance::Drift;
use holdpoint_governance::behavior::{BehaviorAssessment, SequenceEvidence};
use holdpoint_governance::cached_result::CachedResultUse;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::distribution_shift::{is_cleared, re_evaluation_reasons};
use holdpoint_governance::evidence::{AnchorEvidence, PairedEvidence, RecoveryEvidence};
use holdpoint_governance::explanation::Consequence;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::outcome::{Assessment, BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::recovery::RecoveryAssessment;
use holdpoint_store::{Change, EvidenceKind};
use serde::{Deserialize, Serialize};

/// The evidence on a concern: the raw values and the assessments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Confirmation {
    pub pairs: PairedEvidence,
    pub drills: RecoveryEvidence,
    /// Episodes of the family's anchor on the seeds of the pairs; absent if there is no other anchor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<AnchorEvidence>,
    /// Whole sequences, if pairs and drills rejected nothing; absent in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// The assessment of `kappa_B` from the pairs.
    pub behavior: BehaviorAssessment,
    /// The assessment of `kappa_R` from the drills.
    pub recovery: RecoveryAssessment,
    /// The use of cached results.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept: Option<CachedResultUse>,
}

impl Confirmation {
    /// Whether the concern is settled.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        let (behavior, recovery) = (&self.behavior.assessment, &self.recovery.assessment);
        behavior.outcome == BehaviorOutcome::Compatible
            && recovery.outcome == RecoveryOutcome::Compatible
            && !is_inconclusive(behavior, recovery)
    }
}

/// The re-evaluation of a version beside the active one, or its rollback target, in the live cell's conditions: the raw values
/// and the assessment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReEvaluationEvidence {
    /// The drift in force in the live cell at the time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<Drift>,
    pub pairs: PairedEvidence,
    /// Whole sequences, if the pairs rejected nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// The assessment.
    pub behavior: BehaviorAssessment,
    /// The use of cached results.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept: Option<CachedResultUse>,
}

/// A shift of an active version against its shadow. Recorded as evidence when it is found, and again after the re-evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VersionConcern {
    /// The reasons.
    pub reasons: Vec<Reason>,
    /// The re-evaluation; absent until it is complete.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub again: Option<ReEvaluationEvidence>,
}

impl VersionConcern {
    /// What an explanation states of it: the reasons, or the result of the re-evaluation.
    #[must_use]
    pub fn consequence(&self) -> Consequence {
        match &self.again {
            None => Consequence::ConcernFound(self.reasons.clone()),
            Some(again) => Consequence::ReEvaluated {
                drift: again.drift,
                reasons: re_evaluation_reasons(&again.behavior, again.pairs.pairs.len(), Dimension::Monitor),
            },
        }
    }

    /// The digest of its record.
    ///
    /// # Errors
    /// Never for values that passed the edge: they are finite.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.suspicion.v1", self)
    }

    /// The change that records it as evidence on a version.
    ///
    /// # Errors
    /// As [`Self::digest`].
    pub fn evidence(&self, id: &CapabilityId) -> Result<Change, serde_json::Error> {
        let (json, digest) = (serde_json::to_string(self)?, self.digest()?);
        Ok(Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Monitor, json, digest })
    }

    /// Whether no evidence has cleared the version yet.
    #[must_use]
    pub fn is_open(&self) -> bool {
        !self.again.as_ref().is_some_and(|again| is_cleared(&again.behavior))
    }
}

/// Whether an advancing assessment leaves a concern: inconclusive behavior, recovery under a restriction, or a kind of drill
/// with a lower pass rate than the active version's.
fn is_inconclusive(behavior: &Assessment<BehaviorOutcome>, recovery: &Assessment<RecoveryOutcome>) -> bool {
    let leans = |reason: &Reason| {
        matches!(reason.code, ReasonCode::RecoveryEstablishedWorse | ReasonCode::RecoveryLeaning)
    };
    behavior.outcome == BehaviorOutcome::Suspicious
        || matches!(recovery.outcome, RecoveryOutcome::Fragile | RecoveryOutcome::Conditional)
        || recovery.reasons.iter().any(leans)
}

/// Whether assessments leave a concern that `confirmation` has not settled.
#[must_use]
pub fn is_open(kappas: Option<&Kappas>, confirmation: Option<&Confirmation>) -> bool {
    kappas.is_some_and(|kappas| is_inconclusive(&kappas.behavior, &kappas.recovery))
        && !confirmation.is_some_and(Confirmation::is_settled)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::finding::Finding;
    use holdpoint_governance::outcome::Basis;

    fn assessment<O>(outcome: O, codes: &[ReasonCode]) -> Assessment<O> {
        let reason = |code: &ReasonCode| Reason::coded(*code, Dimension::Recovery, Finding::RecoveryReady);
        Assessment {
            outcome,
            kappa: None,
            basis: Basis::Measured,
            reasons: codes.iter().map(reason).collect(),
            conditions: Vec::new(),
        }
    }

    #[test]
    fn inconclusive_results_leave_a_concern() {
        use BehaviorOutcome::{Compatible as Good, Suspicious};
        use RecoveryOutcome::{Compatible, Conditional, Fragile};
        for (behavior, recovery, codes, doubtful) in [
            (Good, Compatible, [ReasonCode::RecoveryCompatible].as_slice(), false),
            (Suspicious, Compatible, &[], true),
            (Good, Conditional, &[], true),
            (Good, Fragile, &[], true),
            (Good, Compatible, &[ReasonCode::RecoveryCompatible, ReasonCode::RecoveryLeaning], true),
            (Good, Compatible, &[ReasonCode::RecoveryEstablishedWorse], true),
        ] {
            let found = is_inconclusive(&assessment(behavior, &[]), &assessment(recovery, codes));
            assert_eq!(found, doubtful, "{behavior:?} {recovery:?} {codes:?}");
        }
    }
}
