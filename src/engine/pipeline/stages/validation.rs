//! Stage 2: static compatibility. Interface, policy and the static part of recovery; behaviour as a
//! flagged estimate. Stops at the first incompatible of interface and policy.

use std::collections::BTreeSet;

use holdpoint_body::FailureSignal;

use crate::pipeline::ledger::Note;
use crate::pipeline::manager::{Fault, UpgradeManager};
use holdpoint_governance::behavior;
use holdpoint_governance::composition::{Kappas, PsiContext, psi};
use holdpoint_governance::decision::{Decision, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::interface::{self, InterfaceInput, Registered};
use holdpoint_governance::lifecycle::{Event, Stage, State};
use holdpoint_governance::outcome::{Recommendation, StageOutcome};
use holdpoint_governance::policy::{self, PolicyInput};
use holdpoint_governance::recovery::{self, StaticInput};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{AuditBody, Change};
use holdpoint_runtime::capability::Capability;

impl UpgradeManager {
    /// Stage 2 of a candidate, whole: it takes well under a millisecond.
    pub(in crate::pipeline) fn validate(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        self.start_stage(id, Stage::Validation, 1)?;
        let candidate = self.capability(id)?;
        let kappas = self.assess_static(&candidate);
        let under = self.made_under(&candidate, candidate.digest());
        let decision = psi(&kappas, PsiContext { has_approver: self.profile.has_approver() }, under);
        let dossier = self.dossier(id);
        dossier.conditions = kappas.conditions();
        dossier.reasons = decision.reasons().to_vec();
        dossier.kappas = Some(kappas);
        self.decided(id, Stage::Validation, &decision)?;
        let (version, _, _) = self.ledger.version(id)?;
        let reason = first_reason(&decision);
        let note = self.stage_note(id, EvidenceKind::Compat, reason, &decision)?;
        if *decision.outcome() == Recommendation::Reject {
            self.transition(&id.family, Event::Reject { version }, note)?;
            return self.rejected(id);
        }
        self.transition(&id.family, Event::Pass { version, stage: Stage::Validation }, note)?;
        Ok(())
    }

    /// The four assessments as far as they go without running anything.
    pub(in crate::pipeline) fn assess_static(&self, candidate: &Capability) -> Kappas {
        let active = self.active_of(&candidate.id().family);
        let exports = candidate.bundle.interface();
        let registered = self.registered();
        let interface = interface::assess(
            &InterfaceInput {
                candidate: &candidate.manifest,
                exports: Some(&exports),
                active: active.as_ref().map(|active| &*active.manifest),
                registered: &registered,
            },
            &self.profile.thresholds,
        );
        let policy = policy::assess(
            &PolicyInput {
                permissions: &candidate.manifest.permissions,
                environments: &candidate.manifest.deployment.environments,
                exports: Some(&exports),
                active: active.as_ref().map(|active| &active.manifest.permissions),
            },
            &self.table,
            &self.profile,
        );
        let declared = candidate.submission.declared_traces.as_ref();
        let parent = active.as_ref().and_then(|active| active.submission.declared_traces.as_ref());
        let behavior = match (declared, parent) {
            (Some(candidate), Some(active)) => behavior::estimate(candidate, active, &self.profile),
            _ => behavior::nothing("not measured yet: the sandbox is to come"),
        };
        let watched: BTreeSet<FailureSignal> = FailureSignal::ALL.into_iter().collect();
        // The active version was loaded from the store, its digest compared with the recorded one.
        let fallback = candidate.manifest.recovery.fallback.as_ref();
        let recovery = recovery::static_part(&StaticInput {
            manifest: &candidate.manifest,
            exports: Some(&exports),
            predecessor_loads: Some(active.is_some()),
            predecessor_digest_true: Some(active.is_some()),
            fallback_resolves: fallback
                .map(|binding| self.ledger.resolve(&binding.family, &binding.version).is_some()),
            watcher_knows: &watched,
        });
        Kappas {
            interface: interface.assessment,
            policy: policy.assessment,
            behavior: behavior.assessment,
            recovery,
        }
    }

    /// Versions a dependency may resolve to: neither rejected nor rolled back.
    fn registered(&self) -> Vec<Registered> {
        let mut known = Vec::new();
        for (_, entry) in self.ledger.families() {
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                if version.state.is_terminal() {
                    continue;
                }
                known.push(Registered {
                    id: member.capability.id(),
                    active: version.state == State::Active,
                    dependencies: member.capability.manifest.deployment.dependencies.clone(),
                });
            }
        }
        known
    }

    /// Tells a decision.
    #[allow(clippy::unnecessary_wraps, reason = "its callers end with it")]
    pub(in crate::pipeline) fn decided<O: Copy + Into<StageOutcome>>(
        &mut self,
        id: &CapabilityId,
        stage: Stage,
        decision: &Decision<O>,
    ) -> Result<(), Fault> {
        let profile = self.profile.clone();
        let dossier = self.dossier(id);
        dossier.progress = None;
        let event = EventKind::Decided {
            version: id.clone(),
            stage,
            outcome: (*decision.outcome()).into(),
            dimensions: dossier.dimensions(&profile),
            composite: dossier.composite(&profile),
            reasons: decision.reasons().to_vec(),
            conditions: dossier.conditions.clone(),
        };
        self.emit(event);
        Ok(())
    }

    /// The note of a stage's end: the evidence so far and the decision, written with the state change.
    pub(in crate::pipeline) fn stage_note<O: serde::Serialize>(
        &mut self,
        id: &CapabilityId,
        kind: EvidenceKind,
        reason: String,
        decision: &Decision<O>,
    ) -> Result<Note, Fault> {
        let scores = self.scores(id);
        let dossier = self.dossier(id);
        let json = serde_json::to_string(dossier)?;
        let digest = dossier.digest()?;
        let evidence = Change::PutEvidence { version: id.clone(), kind, json, digest };
        let body = serde_json::to_string(decision)?;
        let record = AuditBody {
            kind: holdpoint_governance::record::RecordKind::Decision,
            subject: id.to_string(),
            body,
        };
        Ok(Note {
            reason,
            cause: None,
            before: vec![evidence, scores],
            after: Vec::new(),
            audit: vec![record],
        })
    }

    fn scores(&self, id: &CapabilityId) -> Change {
        let kappas = self.dossiers.get(id).and_then(|dossier| dossier.kappas.as_ref());
        let signature = self.dossiers.get(id).and_then(|dossier| dossier.behavior.as_ref()?.candidate);
        let kappas = kappas.map_or([None; 4], |kappas| {
            [kappas.interface.kappa, kappas.policy.kappa, kappas.behavior.kappa, kappas.recovery.kappa]
                .map(|kappa| kappa.map(holdpoint_governance::decision::Kappa::get))
        });
        Change::SetScores {
            version: id.clone(),
            kappas,
            signature: signature.and_then(|signature| serde_json::to_string(&signature).ok()),
        }
    }

    /// After a rejection: the alarm and the closed record.
    pub(in crate::pipeline) fn rejected(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let priority = self.profile.alarms.rejected;
        self.raise(&format!("rejected:{id}"), "rejected", priority, false, &format!("{id} was rejected"));
        self.alarm_event(&holdpoint_governance::alarms::AlarmEvent::Clear { key: format!("rejected:{id}") });
        self.close_audit(id, holdpoint_governance::record::UpgradeEnd::Rejected)
    }
}

/// The deciding reason as a sentence with its name.
pub(in crate::pipeline) fn first_reason<O>(decision: &Decision<O>) -> String {
    let said = |reason: &holdpoint_governance::decision::Reason| format!("{}: {}", reason.code, reason.text);
    // What only reports an improvement or a compatibility is no reason for a rejection, but better than none.
    let telling = decision
        .reasons()
        .iter()
        .find(|reason| !matches!(reason.code, ReasonCode::BehaviorImproved | ReasonCode::CompositionNoData));
    telling.or_else(|| decision.reasons().first()).map_or_else(|| "no reason was given".to_owned(), said)
}
