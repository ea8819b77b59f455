//! Stage 5: the gate, and the people it asks. Activation moves the binding, the pointer and the
//! record in one transaction.

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::gate::{self, GateInput, GateOutcome, GatePassed, GateResult};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::interface::unmet;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::notice::{Notice, RequestVoidCause};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_store::{ActiveCause, AuditBody, Change, EvidenceKind, RequestState};
use holdpoint_wording::command_effect::{VersionEffect, version_effect};

use super::closing::{
    abort_stage, cancel_request, close_rejected, first_reason, reject, report_decision, stage_note,
};
use super::release;
use super::validation::registered;
use crate::decide::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::decide::people::request_display::RequestSources;
use crate::decide::recorder::EngineRecorder;
use crate::decide::store_identity::StoreAgent;
use crate::fault::EngineFault;
use crate::live::monitors::{ActivationMonitor, Monitors};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, made_under};
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::version_origin;
use holdpoint_record::version_table::{TransitionNote, VersionTableError};

/// What the gate reads and moves.
pub struct Activation<'a> {
    /// The terms of the decision.
    pub context: &'a Context,
    pub record: &'a mut EngineRecorder,
    pub evidence_files: &'a mut EvidenceFiles,
    pub approvals: &'a mut Approvals,
    /// The monitors of active versions.
    pub monitors: &'a mut Monitors,
    /// Versions change places between two sequences, never under a moving arm.
    pub sequence_runs: bool,
    /// The cell is stopped: no version takes over before it starts again.
    pub cell_stands: bool,
    /// The agent the store is for, and the one that dispatches.
    pub agent: StoreAgent,
}

impl Activation<'_> {
    /// Stage 5 of a candidate, up to its activation, a refusal or a question to people.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub fn run(&mut self, id: &CapabilityId) -> Result<(), EngineFault> {
        self.record.start_stage(id, Stage::Activation, 1)?;
        let result = gate(self.context, self.record, self.evidence_files, id, None)?;
        self.conclude(id, result, Vec::new())
    }

    fn conclude(
        &mut self,
        id: &CapabilityId,
        result: GateResult,
        approvals: Vec<SignedApproval>,
    ) -> Result<(), EngineFault> {
        let decision = &result.decision;
        let evidence_file = self.evidence_files.edit(id);
        evidence_file.take_gate(decision);
        report_decision(self.context, self.record, evidence_file, id, Stage::Activation, decision);
        let (version, _, _) = self.record.version_table().version(id)?;
        let reason = first_reason(decision);
        match (decision.outcome(), result.passed) {
            (GateOutcome::Pass, Some(passed)) => {
                let body = serde_json::to_string(&result.decision)?;
                let (agent, emergency_until) = (self.agent, None);
                let entry = Admission { passed: &passed, decision: body, agent, emergency_until };
                activate(self.context, self.record, self.monitors, evidence_file, id, entry, &approvals)
            }
            (GateOutcome::AwaitApproval, _) => {
                self.approvals.request_approval(self.context, self.record, self.evidence_files, id)
            }
            (GateOutcome::Hold, _) => {
                evidence_file.held = true;
                abort_stage(self.record, self.evidence_files, id, reason)
            }
            // A pass without its proof is no pass.
            (GateOutcome::Demote | GateOutcome::Pass, _) => {
                let note = stage_note(evidence_file, id, EvidenceKind::Gate, reason, &result.decision)?;
                self.record.transition(&id.family, LifecycleEvent::Demote { version }, note)
            }
            (GateOutcome::Reject, _) => {
                let note = stage_note(evidence_file, id, EvidenceKind::Gate, reason, &result.decision)?;
                reject(self.record, id, note)
            }
        }
    }

    /// Acts on the answers so far. Returns a sentence for the caller.
    pub(crate) fn settle(
        &mut self,
        id: &CapabilityId,
        result: &ApprovalResult,
    ) -> Result<String, EngineFault> {
        let (version, _, _) = self.record.version_table().version(id)?;
        let why = Notice::decided(result.reasons.first());
        let reply = || result.reasons.first().map_or_else(String::new, holdpoint_wording::coded);
        match &result.outcome {
            ApprovalOutcome::Pending { missing } => {
                // The reply also names the reason why an answer does not count.
                let (missing, last) = (*missing, result.reasons.last());
                Ok(version_effect(id, &VersionEffect::AwaitsApproval { missing, last }))
            }
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded if self.sequence_runs => {
                self.approvals.grant_later(id);
                let is_cell_stopped = self.cell_stands;
                Ok(version_effect(id, &VersionEffect::ApprovedForLater { is_cell_stopped }))
            }
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reply()) };
                let event = LifecycleEvent::Approved { version, row_version: prompt.life_row_version };
                let note = closing_note(prompt, RequestState::Granted, why);
                match self.record.transition(&id.family, event, note) {
                    Err(EngineFault::VersionTable(VersionTableError::Refused(refusal))) => {
                        // An answer that came too late puts no version on hold.
                        let problem = refusal.to_string();
                        let text = version_effect(id, &VersionEffect::NotApproved { problem: &problem });
                        self.void(id, Notice::RequestRefused { version: id.clone(), problem })?;
                        return Ok(text);
                    }
                    moved => moved?,
                }
                let Some(prompt) = self.approvals.close(id) else { return Ok(reply()) };
                clear_alarm(self.record, id, prompt.last_voter());
                // A question that an earlier engine asked: what ran then is not running now.
                if self.record.version_table().version(id)?.1.flags.running.is_none() {
                    self.record.start_stage(id, Stage::Activation, 1)?;
                }
                let gate = gate(self.context, self.record, self.evidence_files, id, Some(result))?;
                self.conclude(id, gate, prompt.into_counted(result, self.record.wall_now()))?;
                Ok(version_effect(id, &VersionEffect::Approved))
            }
            ApprovalOutcome::Refused { person } => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reply()) };
                let note = closing_note(prompt, RequestState::Refused, why);
                self.record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
                self.approvals.close(id);
                self.evidence_files.edit(id).reasons.clone_from(&result.reasons);
                clear_alarm(self.record, id, Some(person.clone()));
                close_rejected(self.record, id)?;
                Ok(version_effect(id, &VersionEffect::RejectedBy(person)))
            }
            ApprovalOutcome::TimedOut => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reply()) };
                let note = closing_note(prompt, RequestState::Expired, why);
                self.record.transition(&id.family, LifecycleEvent::ApprovalExpired { version }, note)?;
                self.approvals.close(id);
                let evidence_file = self.evidence_files.edit(id);
                evidence_file.reasons.clone_from(&result.reasons);
                evidence_file.held = true;
                clear_alarm(self.record, id, None);
                if self.record.version_table().version(id)?.1.flags.running.is_some() {
                    abort_stage(self.record, self.evidence_files, id, Notice::ApprovalLapsed)?;
                }
                Ok(version_effect(id, &VersionEffect::ApprovalExpired))
            }
        }
    }

    /// Voids the requests about versions that have changed since; the gate asks again. Returns whether there was one.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn look_at_changed(&mut self) -> Result<bool, EngineFault> {
        let changed = self.approvals.changed(self.record);
        for id in &changed {
            let cause = RequestVoidCause::VersionChanged;
            self.void(id, Notice::RequestVoid { version: id.clone(), cause })?;
        }
        Ok(!changed.is_empty())
    }

    fn void(&mut self, id: &CapabilityId, why: Notice) -> Result<(), EngineFault> {
        cancel_request(self.record, self.evidence_files, self.approvals, id, why)
    }

    /// Acts on requests past their deadline. Returns whether there was one.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub fn look_at_deadlines(&mut self) -> Result<bool, EngineFault> {
        if self.look_at_changed()? {
            return Ok(true);
        }
        let due = self.approvals.due(self.record.wall_now());
        for id in &due {
            match self.approvals.of(id).map(|pending| pending.kind) {
                Some(RequestKind::Release) => {
                    release::lapse(self.record, self.approvals, id)?;
                }
                Some(RequestKind::Activation | RequestKind::Emergency | RequestKind::Review) | None => {
                    self.settle_now(id)?;
                }
            }
        }
        Ok(!due.is_empty())
    }

    /// Activates versions that were approved during a sequence. Returns whether there was one.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub fn take_granted(&mut self) -> Result<bool, EngineFault> {
        let Some(id) = self.approvals.pop_granted() else { return Ok(false) };
        self.settle_now(&id)?;
        Ok(true)
    }

    /// Voids a request if an approver would see another text now. Returns whether it did.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn void_outdated(&mut self, id: &CapabilityId) -> Result<bool, EngineFault> {
        let (context, record, evidence_files) = (self.context, &*self.record, &*self.evidence_files);
        let is_outdated =
            self.approvals.is_outdated(RequestSources { context, record, evidence_files }, id)?;
        if is_outdated {
            let cause = RequestVoidCause::TextChanged;
            self.void(id, Notice::RequestVoid { version: id.clone(), cause })?;
        }
        Ok(is_outdated)
    }

    fn settle_now(&mut self, id: &CapabilityId) -> Result<(), EngineFault> {
        if self.void_outdated(id)? {
            return Ok(());
        }
        let Some(prompt) = self.approvals.of(id) else { return Ok(()) };
        let result = prompt.result(self.context, self.record.wall_now());
        self.settle(id, &result)?;
        Ok(())
    }
}

/// What the gate says of a candidate.
pub(crate) fn gate(
    context: &Context,
    record: &EngineRecorder,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
    approval: Option<&ApprovalResult>,
) -> Result<GateResult, EngineFault> {
    let version_table = record.version_table();
    let candidate = record.capability(id)?;
    let (_, lifecycle, member) = version_table.version(id)?;
    let current = binding(context, version_table, &candidate);
    let assessed =
        evidence_files.of(id).and_then(|evidence_file| Some((evidence_file, evidence_file.kappas.as_ref()?)));
    let Some((evidence_file, kappas)) = assessed else {
        return Err(EngineFault::Impossible(format!("{id} reached the gate without an assessment")));
    };
    let made_under = made_under(context, version_table, &candidate, evidence_file.digest()?);
    // Older stores have the blocks in the evidence file only.
    let blocked_under = lifecycle.closed.union(&evidence_file.closed).copied().collect();
    let input = GateInput {
        kappas,
        shadow: evidence_file.shadow.as_ref(),
        bindings: &evidence_file.bindings,
        current: &current,
        improved: evidence_file.behavior.as_ref().is_some_and(|behavior| behavior.improved),
        approval,
        risk: version_origin::assessed_risk(evidence_file),
        requester: &member.origin.requester,
        provenance: candidate.submission.provenance,
        blocked_under: &blocked_under,
        unmet: &unmet(&candidate.manifest, &registered(version_table)),
        review_open: version_table.family(&id.family)?.state.review.is_some(),
        now: record.wall_now(),
        clock_doubt: record.version_table().wall().clock_mismatch(),
        row_version: member.row_version,
        made_under,
        omitted: context.omitted,
        profile_authorized: context.unauthorized.is_none(),
    };
    Ok(gate::evaluate(&input, &context.table, &context.profile))
}

/// What a version becomes active by.
pub(super) struct Admission<'a> {
    pub(super) passed: &'a GatePassed,
    /// The gate's decision, JSON text.
    pub(super) decision: String,
    /// Whose capability it becomes.
    pub(super) agent: StoreAgent,
    /// Until when one person's emergency approval holds unreviewed; absent in the ordinary way.
    pub(super) emergency_until: Option<WallTime>,
}

/// Moves the binding: gate pass, used approvals, both state changes, pointer and record at once. Refuses under
/// another agent than the store's, by every route.
pub(super) fn activate(
    context: &Context,
    record: &mut EngineRecorder,
    monitors: &mut Monitors,
    evidence_file: &EvidenceFile,
    id: &CapabilityId,
    Admission { passed, decision, agent, emergency_until }: Admission<'_>,
    approvals: &[SignedApproval],
) -> Result<(), EngineFault> {
    agent.check()?;
    if let Some(why) = &context.unauthorized {
        let why = holdpoint_wording::notice_sentence(why);
        return Err(EngineFault::Impossible(format!("{id} passed the gate, and {why}")));
    }
    let (version, _, _) = record.version_table().version(id)?;
    let event = LifecycleEvent::Pass { version, stage: Stage::Activation };
    record.transition(&id.family, event, TransitionNote::because(Notice::GatePassed))?;
    let evidence = evidence_file.digest()?;
    let gate_digest = Digest::of_parts("holdpoint.gate.v1", &[decision.as_bytes(), evidence.bytes()]);
    let replaced = record.active_of(&id.family).map(|active| active.id());
    let mut before = vec![Change::PutEvidence {
        version: id.clone(),
        kind: EvidenceKind::Gate,
        json: decision.clone(),
        digest: gate_digest,
    }];
    for signed in approvals {
        let nonce = signed.approval().nonce.as_str().to_owned();
        before.push(Change::ConsumeApproval {
            nonce,
            evidence_digest: evidence,
            at: Some(record.wall_now()),
        });
    }
    let needed = u32::try_from(approvals.len()).unwrap_or(u32::MAX);
    let note = TransitionNote {
        reason: Notice::GatePassed.into(),
        cause: Some(ActiveCause::Gate { evidence: gate_digest, approvals_needed: needed }),
        before,
        after: Vec::new(),
        audit: vec![AuditBody { kind: RecordKind::Decision, subject: id.to_string(), body: decision }],
    };
    // Without a live monitor no tick runs under a provisional version: it is made first.
    let watched = ActivationMonitor::new(id, Some(evidence_file), context, record.now_tick())?;
    let event = match emergency_until {
        None => LifecycleEvent::Activate { version },
        Some(until) => LifecycleEvent::ActivateUnreviewed { version, until },
    };
    record.transition(&id.family, event, note)?;
    monitors.insert(watched);
    let terms = passed.terms();
    record.tell(EventKind::Activated {
        version: id.clone(),
        replaced,
        modes: terms.modes.iter().copied().collect(),
        conditions: terms.conditions.clone(),
        provisional_episodes: terms.provisional_episodes,
    });
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests;
