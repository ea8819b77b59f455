//! The end of the provisional window of a version that was let in with a doubt.
//!
//! Suspicious behaviour, and recovery that is fragile or worse than the predecessor's, advance under
//! restrictions; the live window alone is far too short to settle such a doubt. So it is settled before the
//! version is confirmed: the whole sandbox budget once more, against the predecessor, on seeds nobody has seen.
//! What comes out compatible is confirmed; what does not is demoted. Uncertain means hold (design rules 3.6,
//! 3.8).

use serde::{Deserialize, Serialize};

use crate::pipeline::cell::Conditions;
use crate::pipeline::evaluation::{Evaluation, Plan};
use crate::pipeline::manager::{Fault, UpgradeManager, Work};
use holdpoint_governance::behavior::BehaviorAssessment;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::evidence::{Binding, PairedEvidence, RecoveryEvidence};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, Stage};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::{Assessment, BehaviorOutcome, RecoveryOutcome};
use holdpoint_governance::recovery::RecoveryAssessment;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Change;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

/// What settled a doubt: the raw values and what the rules made of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Confirmation {
    /// The fresh pairs.
    pub pairs: PairedEvidence,
    /// The fresh drills.
    pub drills: RecoveryEvidence,
    /// `kappa_B` of them.
    pub behavior: BehaviorAssessment,
    /// `kappa_R` of them.
    pub recovery: RecoveryAssessment,
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

/// A confirmation under way.
pub struct ConfirmationRun {
    id: CapabilityId,
    predecessor: Capability,
    evaluation: Evaluation,
}

impl ConfirmationRun {
    pub(in crate::pipeline) fn is_of(&self, id: &CapabilityId) -> bool {
        self.id == *id
    }

    /// Whether nothing is left but to conclude it.
    pub(in crate::pipeline) const fn is_over(&self) -> bool {
        self.evaluation.ended().is_some()
    }
}

impl UpgradeManager {
    /// Whether a version was let in with a doubt that nothing has settled yet.
    pub(in crate::pipeline) fn has_open_doubt(&self, id: &CapabilityId) -> bool {
        let Some(dossier) = self.dossiers.get(id) else { return false };
        let doubted =
            dossier.kappas.as_ref().is_some_and(|kappas| is_doubtful(&kappas.behavior, &kappas.recovery));
        doubted && !dossier.confirmation.as_ref().is_some_and(Confirmation::is_settled)
    }

    /// The first version whose window is over and whose doubt is open.
    pub(in crate::pipeline) fn next_confirmation(&self) -> Option<CapabilityId> {
        let over = |id: &&CapabilityId| {
            self.watches.get(&id.family).is_some_and(|watch| {
                watch.id == **id && watch.monitor.is_confirmed() && !watch.restricted && !watch.confirmed
            })
        };
        let ids: Vec<&CapabilityId> = self.watches.values().map(|watch| &watch.id).collect();
        ids.into_iter().filter(over).find(|id| self.has_open_doubt(id)).cloned()
    }

    pub(in crate::pipeline) fn begin_confirmation(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let (_, standing, _) = self.ledger.version(id)?;
        let predecessor = standing.predecessor.and_then(|predecessor| {
            let entry = self.ledger.family(&id.family).ok()?;
            Some(entry.members.get(usize::from(predecessor.0))?.capability.clone())
        });
        let Some(predecessor) = predecessor else {
            let trigger = "its doubt cannot be settled: there is no predecessor to compare it with";
            let trigger = self.trigger(TriggerKind::OpenDoubt, trigger);
            return self.roll_back(id, trigger, None, Leave::Demoted);
        };
        let candidate = self.capability(id)?;
        let binding = Binding { active: Some(predecessor.digest()), ..self.binding(&candidate) };
        let evaluation = Evaluation::new(Plan::confirmation(&self.profile), binding, Vec::new());
        let budget = Plan::confirmation(&self.profile).budget();
        self.progress(id, Stage::Sandbox, "confirmation", 0, budget);
        let run = ConfirmationRun { id: id.clone(), predecessor, evaluation };
        self.work = Some(Work::Confirmation(Box::new(run)));
        Ok(())
    }

    pub(in crate::pipeline) fn confirmation_slice(
        &mut self,
        mut run: Box<ConfirmationRun>,
    ) -> Result<(), Fault> {
        let id = run.id.clone();
        // The monitor may have taken it off meanwhile, or people have.
        let watched = self.watches.get(&id.family).is_some_and(|watch| watch.id == id);
        if !watched {
            return Ok(());
        }
        if run.evaluation.ended().is_some() {
            return self.conclude_confirmation(&id, &run.evaluation);
        }
        let candidate = self.capability(&id)?;
        let parties = (self.party(&candidate), self.party(&run.predecessor));
        let step = run.evaluation.step(&self.lab(), &parties.0, &parties.1, &self.profile)?;
        let Some(slice) = step else {
            self.work = Some(Work::Confirmation(run));
            return Ok(());
        };
        let fresh: Vec<TaskRecord> = slice.records.into_iter().map(|(new, _)| new).collect();
        if !fresh.is_empty() {
            self.keep_trace(&id, "confirmation", Conditions::Sandbox, &fresh)?;
        }
        self.live_due_for(fresh.len() as u64);
        let budget = Plan::confirmation(&self.profile).budget();
        let what = format!("confirmation, {}", slice.what);
        self.progress(&id, Stage::Sandbox, &what, slice.done, budget);
        self.work = Some(Work::Confirmation(run));
        Ok(())
    }

    fn conclude_confirmation(&mut self, id: &CapabilityId, evaluation: &Evaluation) -> Result<(), Fault> {
        let (pairs, drills) = (evaluation.paired(), evaluation.rehearsed());
        let (behavior, recovery) = evaluation.assess(&self.profile);
        let confirmation = Confirmation { pairs, drills, behavior, recovery };
        let json = serde_json::to_string(&confirmation)?;
        let digest = holdpoint_governance::ids::Digest::of_json("holdpoint.confirmation.v1", &confirmation)?;
        let mut changes = self.ledger.store().seal_telemetry()?;
        changes.push(Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Monitor, json, digest });
        let at_ms = self.clock.now_ms();
        self.ledger.write(changes, Vec::new(), at_ms)?;
        let assessments =
            [&confirmation.behavior.assessment.reasons, &confirmation.recovery.assessment.reasons];
        let reasons: Vec<_> = assessments.into_iter().flatten().cloned().collect();
        let settled = confirmation.is_settled();
        let dossier = self.dossier(id);
        dossier.progress = None;
        dossier.confirmation = Some(confirmation);
        let decision = if settled { MonitorOutcome::Settled } else { MonitorOutcome::DoubtRemains };
        self.emit(EventKind::Monitor { version: id.clone(), decision, reasons: reasons.clone() });
        if settled {
            return self.maybe_confirm(id);
        }
        self.dossier(id).reasons = reasons;
        let text = "the doubt it was let in with remains on fresh evidence";
        let trigger = self.trigger(TriggerKind::OpenDoubt, text);
        self.roll_back(id, trigger, None, Leave::Demoted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::decision::Dimension;
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
