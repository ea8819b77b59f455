//! The doubt that a version may be let in with, and what settles it.
//!
//! Suspicious behaviour, and recovery that is fragile or worse than the predecessor's, advance under restrictions; the
//! doubt stays on the version until fresh evidence settles it (design rules 3.6, 3.8). A version that is not in the live
//! world what it was before is in doubt as well, from then on.

use holdpoint_governance::behavior::{BehaviorAssessment, SequenceEvidence};
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{PairedEvidence, RecoveryEvidence};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::kept::KeptUse;
use holdpoint_governance::outcome::{Assessment, BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::recovery::RecoveryAssessment;
use holdpoint_governance::shift::{is_cleared, worked_again};
use holdpoint_registry::Change;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_sim::distribution::Drift;
use serde::{Deserialize, Serialize};

/// What settled a doubt: the raw values and what the rules made of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Confirmation {
    pub pairs: PairedEvidence,
    pub drills: RecoveryEvidence,
    /// Whole sequences, if pairs and drills rejected nothing; absent in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// What the pairs say of `kappa_B`.
    pub behavior: BehaviorAssessment,
    /// What the drills say of `kappa_R`.
    pub recovery: RecoveryAssessment,
    /// What of it was kept from before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept: Option<KeptUse>,
}

impl Confirmation {
    /// Whether nothing of the doubt is left.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        let (behavior, recovery) = (&self.behavior.assessment, &self.recovery.assessment);
        behavior.outcome == BehaviorOutcome::Compatible
            && recovery.outcome == RecoveryOutcome::Compatible
            && !is_doubtful(behavior, recovery)
    }
}

/// A version worked again beside the active one, or its predecessor, in the live world's conditions: the raw values and what
/// the rules made of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkedAgain {
    /// What had set in in the live world then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<Drift>,
    pub pairs: PairedEvidence,
    /// Whole sequences, if the pairs rejected nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub handovers: Option<SequenceEvidence>,
    /// What they say.
    pub behavior: BehaviorAssessment,
    /// What of it was kept from before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept: Option<KeptUse>,
}

/// An active version that is not what its shadow showed. On record as evidence when it is found, and again when it was worked
/// again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suspicion {
    /// In what it is not.
    pub reasons: Vec<Reason>,
    /// What working it again came to; absent until that is done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub again: Option<WorkedAgain>,
}

impl Suspicion {
    /// What is told of it: in what the version is suspicious, or what working it again came to.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        match &self.again {
            None => self.reasons.iter().map(|reason| format!("suspicious: {}", reason.text)).collect(),
            Some(again) => {
                let (code, dimension) = (ReasonCode::MonitorWorkedAgain, Dimension::Monitor);
                let found = worked_again(&again.behavior, again.pairs.pairs.len(), code, dimension);
                let under = again.drift.as_ref().map(|drift| format!("with the drift {drift} in force"));
                under.into_iter().chain(found.into_iter().map(|reason| reason.text)).collect()
            }
        }
    }

    /// The digest that it is on record with.
    ///
    /// # Errors
    /// Never for values that passed the edge: they are finite.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.suspicion.v1", self)
    }

    /// It, as evidence on a version.
    ///
    /// # Errors
    /// As [`Self::digest`].
    pub fn evidence(&self, id: &CapabilityId) -> Result<Change, serde_json::Error> {
        let (json, digest) = (serde_json::to_string(self)?, self.digest()?);
        Ok(Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Monitor, json, digest })
    }

    /// Whether nothing has cleared the version yet.
    #[must_use]
    pub fn is_open(&self) -> bool {
        !self.again.as_ref().is_some_and(|again| is_cleared(&again.behavior))
    }
}

/// Whether an assessment that advances leaves a doubt: suspicious behaviour, recovery under a restriction, or one
/// kind of drill that passes less often than the active version's.
fn is_doubtful(behavior: &Assessment<BehaviorOutcome>, recovery: &Assessment<RecoveryOutcome>) -> bool {
    let leans = |reason: &Reason| {
        matches!(reason.code, ReasonCode::RecoveryEstablishedWorse | ReasonCode::RecoveryLeaning)
    };
    behavior.outcome == BehaviorOutcome::Suspicious
        || matches!(recovery.outcome, RecoveryOutcome::Fragile | RecoveryOutcome::Conditional)
        || recovery.reasons.iter().any(leans)
}

/// Whether assessments leave a doubt that `confirmation` has not settled.
#[must_use]
pub fn is_open(kappas: Option<&Kappas>, confirmation: Option<&Confirmation>) -> bool {
    kappas.is_some_and(|kappas| is_doubtful(&kappas.behavior, &kappas.recovery))
        && !confirmation.is_some_and(Confirmation::is_settled)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::outcome::Basis;

    fn assessment<O>(outcome: O, codes: &[ReasonCode]) -> Assessment<O> {
        let reason = |code: &ReasonCode| Reason::new(*code, Dimension::Recovery, "as tested");
        Assessment {
            outcome,
            kappa: None,
            basis: Basis::Measured,
            reasons: codes.iter().map(reason).collect(),
            conditions: Vec::new(),
        }
    }

    #[test]
    fn what_leaves_a_doubt() {
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
            let found = is_doubtful(&assessment(behavior, &[]), &assessment(recovery, codes));
            assert_eq!(found, doubtful, "{behavior:?} {recovery:?} {codes:?}");
        }
    }
}
