//! Stage 5: the gate, and the people it asks. Activation moves the binding, the pointer and the
//! record in one transaction.

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::gate::{self, GateInput, GateOutcome, GatePassed, GateResult};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::interface::unmet;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::snapshot::Purpose;
use holdpoint_registry::names::{EvidenceKind, RequestState};
use holdpoint_registry::{ActiveCause, AuditBody, Change};

use super::closing::{abort_stage, decided, first_reason, rejected, stage_note, void_question};
use super::release;
use super::validation::registered;
use crate::binding::{binding, made_under};
use crate::bound::BoundAgent;
use crate::context::Context;
use crate::dossier::{Dossier, Dossiers};
use crate::fault::Fault;
use crate::ledger::{LedgerError, Note};
use crate::monitors::{Monitors, Watched};
use crate::origin;
use crate::people::approvals::{Approvals, PendingQuestion, clear_alarm, closing_note};
use crate::record::Record;

/// What the gate reads and moves.
pub struct Activation<'a> {
    /// What is judged under.
    pub context: &'a Context,
    pub record: &'a mut Record,
    pub dossiers: &'a mut Dossiers,
    pub approvals: &'a mut Approvals,
    /// Who is watched from an activation on.
    pub monitors: &'a mut Monitors,
    /// Versions change places between two sequences, never under a moving arm.
    pub sequence_runs: bool,
    /// The cell is stopped: nothing takes over before it works again.
    pub cell_stands: bool,
    /// The agent the store is for, and the one that dispatches.
    pub agent: BoundAgent,
}

impl Activation<'_> {
    /// Stage 5 of a candidate, up to its activation, a refusal or a question to people.
    ///
    /// # Errors
    /// If what it comes to cannot be written.
    pub fn run(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        self.record.start_stage(id, Stage::Activation, 1)?;
        let result = gate(self.context, self.record, self.dossiers, id, None)?;
        self.conclude(id, result, Vec::new())
    }

    fn conclude(
        &mut self,
        id: &CapabilityId,
        result: GateResult,
        approvals: Vec<SignedApproval>,
    ) -> Result<(), Fault> {
        let decision = &result.decision;
        let dossier = self.dossiers.edit(id);
        dossier.take_gate(decision);
        decided(self.context, self.record, dossier, id, Stage::Activation, decision);
        let (version, _, _) = self.record.ledger().version(id)?;
        let reason = first_reason(decision);
        match (decision.outcome(), result.passed) {
            (GateOutcome::Pass, Some(passed)) => {
                let body = serde_json::to_string(&result.decision)?;
                let (agent, emergency_until) = (self.agent, None);
                let entry = Admission { passed: &passed, decision: body, agent, emergency_until };
                activate(self.context, self.record, self.monitors, dossier, id, entry, &approvals)
            }
            (GateOutcome::AwaitApproval, _) => {
                self.approvals.ask(self.context, self.record, self.dossiers, id)
            }
            (GateOutcome::Hold, _) => {
                dossier.held = true;
                abort_stage(self.record, self.dossiers, id, &reason)
            }
            // A pass without its proof is no pass.
            (GateOutcome::Demote | GateOutcome::Pass, _) => {
                let note = stage_note(dossier, id, EvidenceKind::Gate, reason, &result.decision)?;
                self.record.transition(&id.family, LifecycleEvent::Demote { version }, note)?;
                Ok(())
            }
            (GateOutcome::Reject, _) => {
                let note = stage_note(dossier, id, EvidenceKind::Gate, reason, &result.decision)?;
                self.record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
                rejected(self.context, self.record, id)
            }
        }
    }

    /// Acts on what asking came to so far. Returns a sentence for the one who asked or answered.
    pub(crate) fn settle(&mut self, id: &CapabilityId, result: &ApprovalResult) -> Result<String, Fault> {
        let (version, _, _) = self.record.ledger().version(id)?;
        let reason = result
            .reasons
            .first()
            .map_or_else(String::new, |reason| format!("{}: {}", reason.code, reason.text));
        match &result.outcome {
            ApprovalOutcome::Pending { missing } => {
                // An answer that does not count is said, not swallowed.
                let last = result.reasons.last().map_or_else(String::new, |reason| reason.text.clone());
                Ok(format!("{id} waits for {missing} more; {last}"))
            }
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded if self.sequence_runs => {
                self.approvals.grant_later(id);
                let when = if self.cell_stands {
                    "at once when the cell works again (`go`)"
                } else {
                    "when the sequence that runs is over"
                };
                Ok(format!("{id} is approved and takes over {when}"))
            }
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reason) };
                let event = LifecycleEvent::Approved { version, row_version: prompt.life_row_version() };
                let note = closing_note(self.context, id, prompt, RequestState::Granted, &reason);
                match self.record.transition(&id.family, event, note) {
                    Err(Fault::Ledger(LedgerError::Refused(refusal))) => {
                        // Nothing is held for an answer that came too late.
                        self.void(id, &refusal.to_string())?;
                        return Ok(format!("{id} is not approved ({refusal}); people are asked anew"));
                    }
                    moved => moved.map(|_| ())?,
                }
                let Some(prompt) = self.approvals.close(id) else { return Ok(reason) };
                clear_alarm(self.record, id, prompt.last_voter());
                // A question that an earlier engine asked: what ran then is not running now.
                if self.record.ledger().version(id)?.1.flags.running.is_none() {
                    self.record.start_stage(id, Stage::Activation, 1)?;
                }
                let gate = gate(self.context, self.record, self.dossiers, id, Some(result))?;
                self.conclude(id, gate, prompt.into_counted(result, self.record.wall_now()))?;
                Ok(format!("{id} is approved"))
            }
            ApprovalOutcome::Refused { person } => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reason) };
                let note = closing_note(self.context, id, prompt, RequestState::Refused, &reason);
                self.record.transition(&id.family, LifecycleEvent::Reject { version }, note)?;
                self.approvals.close(id);
                self.dossiers.edit(id).reasons.clone_from(&result.reasons);
                clear_alarm(self.record, id, Some(person.clone()));
                rejected(self.context, self.record, id)?;
                Ok(format!("{id} is rejected: {person} refused"))
            }
            ApprovalOutcome::TimedOut => {
                let Some(prompt) = self.approvals.of(id) else { return Ok(reason) };
                let note = closing_note(self.context, id, prompt, RequestState::Expired, &reason);
                self.record.transition(&id.family, LifecycleEvent::ApprovalExpired { version }, note)?;
                self.approvals.close(id);
                let dossier = self.dossiers.edit(id);
                dossier.reasons.clone_from(&result.reasons);
                dossier.held = true;
                clear_alarm(self.record, id, None);
                if self.record.ledger().version(id)?.1.flags.running.is_some() {
                    let why = "too few people answered in time; the version is held";
                    abort_stage(self.record, self.dossiers, id, why)?;
                }
                Ok(format!("{id} is held: too few people answered in time"))
            }
        }
    }

    /// Questions about versions that have changed since are void, and asked anew by the gate. Tells whether there was
    /// one.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn look_at_changed(&mut self) -> Result<bool, Fault> {
        let changed = self.approvals.changed(self.record);
        for id in &changed {
            self.void(id, "it has changed since")?;
        }
        Ok(!changed.is_empty())
    }

    fn void(&mut self, id: &CapabilityId, why: &str) -> Result<(), Fault> {
        void_question(self.context, self.record, self.dossiers, self.approvals, id, why)
    }

    /// Acts on questions whose time is over. Tells whether there was one.
    ///
    /// # Errors
    /// If what it comes to cannot be written.
    pub fn look_at_deadlines(&mut self) -> Result<bool, Fault> {
        if self.look_at_changed()? {
            return Ok(true);
        }
        let due = self.approvals.due(self.record.wall_now());
        for id in &due {
            match self.approvals.of(id).map(PendingQuestion::purpose) {
                Some(Purpose::Release) => {
                    release::lapse(self.context, self.record, self.approvals, id)?;
                }
                Some(Purpose::Activation | Purpose::Emergency | Purpose::Review) | None => {
                    self.settle_now(id)?;
                }
            }
        }
        Ok(!due.is_empty())
    }

    /// Versions that were approved while a sequence ran take over. Tells whether there was one.
    ///
    /// # Errors
    /// If what it comes to cannot be written.
    pub fn take_granted(&mut self) -> Result<bool, Fault> {
        let Some(id) = self.approvals.pop_granted() else { return Ok(false) };
        self.settle_now(&id)?;
        Ok(true)
    }

    /// A question is void if somebody who answered it would be shown something else now. Tells whether it was.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn void_outdated(&mut self, id: &CapabilityId) -> Result<bool, Fault> {
        let is_outdated = self.approvals.is_outdated(self.context, self.record, self.dossiers, id)?;
        if is_outdated {
            self.void(id, "what people were shown has changed since")?;
        }
        Ok(is_outdated)
    }

    fn settle_now(&mut self, id: &CapabilityId) -> Result<(), Fault> {
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
    record: &Record,
    dossiers: &Dossiers,
    id: &CapabilityId,
    approval: Option<&ApprovalResult>,
) -> Result<GateResult, Fault> {
    let ledger = record.ledger();
    let candidate = record.capability(id)?;
    let (_, standing, member) = ledger.version(id)?;
    let current = binding(context, ledger, &candidate);
    let assessed = dossiers.of(id).and_then(|dossier| Some((dossier, dossier.kappas.as_ref()?)));
    let Some((dossier, kappas)) = assessed else {
        return Err(Fault::Impossible(format!("{id} reached the gate without an assessment")));
    };
    let made_under = made_under(context, ledger, &candidate, dossier.digest()?);
    // Stores made before the lifecycle kept it have it in the dossier.
    let closed = standing.closed.union(&dossier.closed).copied().collect();
    let input = GateInput {
        kappas,
        shadow: dossier.shadow.as_ref(),
        bindings: &dossier.bindings,
        current: &current,
        improved: dossier.behavior.as_ref().is_some_and(|behavior| behavior.improved),
        approval,
        risk: origin::assessed_risk(dossier),
        requester: &member.origin.requester,
        provenance: candidate.submission.provenance,
        closed: &closed,
        unmet: &unmet(&candidate.manifest, &registered(ledger)),
        review_open: ledger.family(&id.family)?.state.review.is_some(),
        now: record.wall_now(),
        clock_doubt: record.ledger().wall().doubt(),
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
    pub(super) agent: BoundAgent,
    /// Until when one person's emergency approval holds unreviewed; absent in the ordinary way.
    pub(super) emergency_until: Option<WallTime>,
}

/// Moves the binding: gate pass, used approvals, both state changes, pointer and record at once. Under another agent
/// than the store's nothing is activated, by whatever door.
pub(super) fn activate(
    context: &Context,
    record: &mut Record,
    monitors: &mut Monitors,
    dossier: &Dossier,
    id: &CapabilityId,
    Admission { passed, decision, agent, emergency_until }: Admission<'_>,
    approvals: &[SignedApproval],
) -> Result<(), Fault> {
    agent.check()?;
    if let Some(why) = &context.unauthorized {
        return Err(Fault::Impossible(format!("{id} passed the gate, and {why}")));
    }
    let (version, _, _) = record.ledger().version(id)?;
    let event = LifecycleEvent::Pass { version, stage: Stage::Activation };
    record.transition(&id.family, event, Note::because("the gate is passed"))?;
    let evidence = dossier.digest()?;
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
    let note = Note {
        reason: "the gate is passed".to_owned(),
        cause: Some(ActiveCause::Gate { evidence: gate_digest, approvals_needed: needed }),
        before,
        after: Vec::new(),
        audit: vec![AuditBody { kind: RecordKind::Decision, subject: id.to_string(), body: decision }],
    };
    // Without a live monitor no tick runs under a provisional version: it is made first.
    let watched = Watched::new(id, Some(dossier), context, record.now_tick())?;
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
