//! Stage 5: the gate, and the people it asks. Activation moves the binding, the pointer and the
//! record in one transaction.

use crate::pipeline::ledger::Note;
use crate::pipeline::manager::{Fault, UpgradeManager};
use crate::pipeline::stages::asking::SHOWN_BYTES_MAX;
use crate::pipeline::stages::validation::first_reason;
use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::AlarmEvent;
use holdpoint_governance::approval::{
    self, Answer, ApprovalOutcome, ApprovalResult, Request, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::gate::{self, GateInput, GateOutcome, GatePassed, GateResult};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Event, Stage};
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::names::{EvidenceKind, RequestState};
use holdpoint_registry::{ActiveCause, ApprovalRequest, AuditBody, Change};

/// Something that waits for people.
pub struct Prompt {
    pub(in crate::pipeline) id: String,
    pub(in crate::pipeline) request: Request,
    pub(in crate::pipeline) votes: Vec<Vote>,
    signed: Vec<SignedApproval>,
    pub(in crate::pipeline) evidence: Digest,
    pub(in crate::pipeline) row_version: u64,
    life_row_version: u64,
    pub(in crate::pipeline) asked_ms: u64,
    pub(in crate::pipeline) deadline_ms: u64,
    pub(in crate::pipeline) replaces: Option<CapabilityId>,
    /// It takes people to override what a rule would not pass.
    pub(in crate::pipeline) review: bool,
}

impl UpgradeManager {
    /// Stage 5 of a candidate, up to its activation, a refusal or a question to people.
    pub(in crate::pipeline) fn activation(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        self.start_stage(id, Stage::Activation, 1)?;
        let result = self.gate(id, None)?;
        self.conclude_gate(id, result, Vec::new())
    }

    fn gate(&mut self, id: &CapabilityId, approval: Option<&ApprovalResult>) -> Result<GateResult, Fault> {
        let candidate = self.capability(id)?;
        let (_, _, member) = self.ledger.version(id)?;
        let row_version = member.row_version;
        let current = self.binding(&candidate);
        let evidence = self.dossier(id).digest()?;
        let made_under = self.made_under(&candidate, evidence);
        let now_s = self.now_s();
        let (table, profile) = (self.table.clone(), self.profile.clone());
        let dossier = self.dossier(id);
        let Some(kappas) = &dossier.kappas else {
            return Err(Fault::Impossible(format!("{id} reached the gate without an assessment")));
        };
        let input = GateInput {
            kappas,
            shadow: dossier.shadow.as_ref(),
            bindings: &dossier.bindings,
            current: &current,
            improved: dossier.behavior.as_ref().is_some_and(|behavior| behavior.improved),
            approval,
            risk: candidate.submission.estimated_risk,
            provenance: candidate.submission.provenance,
            closed: &dossier.closed,
            review_open: false,
            now_s,
            row_version,
            made_under,
        };
        Ok(gate::evaluate(&input, &table, &profile))
    }

    #[allow(clippy::cast_precision_loss, reason = "virtual milliseconds of one engine's life")]
    pub(in crate::pipeline) fn now_s(&self) -> f64 {
        self.clock.now_ms() as f64 / 1000.0
    }

    fn conclude_gate(
        &mut self,
        id: &CapabilityId,
        result: GateResult,
        approvals: Vec<SignedApproval>,
    ) -> Result<(), Fault> {
        let decision = &result.decision;
        self.dossier(id).reasons = decision.reasons().to_vec();
        if let Some(passed) = &result.passed {
            self.dossier(id).conditions.clone_from(&passed.terms().conditions);
        }
        self.decided(id, Stage::Activation, decision)?;
        let (version, _, _) = self.ledger.version(id)?;
        let reason = first_reason(decision);
        match (decision.outcome(), result.passed) {
            (GateOutcome::Pass, Some(passed)) => {
                let body = serde_json::to_string(&result.decision)?;
                self.activate(id, &passed, body, &approvals)
            }
            (GateOutcome::AwaitApproval, _) => self.ask(id),
            (GateOutcome::Hold, _) => {
                self.dossier(id).held = true;
                self.abort_stage(id, &reason)
            }
            // A pass without its proof is no pass.
            (GateOutcome::Demote | GateOutcome::Pass, _) => {
                let note = self.stage_note(id, EvidenceKind::Gate, reason, &result.decision)?;
                self.transition(&id.family, Event::Demote { version }, note)?;
                Ok(())
            }
            (GateOutcome::Reject, _) => {
                let note = self.stage_note(id, EvidenceKind::Gate, reason, &result.decision)?;
                self.transition(&id.family, Event::Reject { version }, note)?;
                self.rejected(id)
            }
        }
    }

    /// Asks people; from here on only they or the deadline move the candidate.
    fn ask(&mut self, id: &CapabilityId) -> Result<(), Fault> {
        let candidate = self.capability(id)?;
        let evidence = self.dossier(id).digest()?;
        let Some(kappas) = self.dossier(id).kappas.clone() else {
            return Err(Fault::Impossible(format!("{id} reached the gate without an assessment")));
        };
        let settings = self.profile.approval;
        let risk = candidate.submission.estimated_risk;
        let review = gate::needs_review(&kappas, &self.profile);
        let quorum = approval::quorum(&settings, self.profile.activation.approval_bound, risk, review);
        let (version, _, member) = self.ledger.version(id)?;
        let row_version = member.row_version;
        let now_ms = self.clock.now_ms();
        let deadline_ms = now_ms.saturating_add(secs_to_ms(settings.timeout_s));
        // An engine that comes up again asks the same question anew, with another deadline: another request.
        let prompt_id = format!("{}-{}-{row_version}-{}-{now_ms}", id.family, id.version, evidence.short());
        let replaces = self.active_of(&id.family).map(|active| active.id());
        let shown = serde_json::to_string(self.dossier(id))?;
        let question = ApprovalRequest {
            id: prompt_id.clone(),
            version: id.clone(),
            row_version,
            evidence_digest: evidence,
            policy_digest: self.context_digest,
            profile: self.profile.name.name().to_owned(),
            needed: u32::from(quorum),
            deadline_ms,
            state: RequestState::Open,
            json: shown,
        };
        let note = Note {
            before: vec![Change::PutApprovalRequest(Box::new(question))],
            ..Note::because("people are asked")
        };
        self.transition(&id.family, Event::RequestApproval { version }, note)?;
        let life_row_version = self.ledger.version(id)?.1.row_version;
        let prompt = Prompt {
            id: prompt_id,
            request: Request {
                subject: Subject {
                    candidate: candidate.digest(),
                    row_version,
                    evidence,
                    policy: self.context_digest,
                    profile: self.profile_digest,
                },
                risk,
                quorum,
                requester: "engine".to_owned(),
                author: candidate.submission.author.clone(),
                asked_s: self.now_s(),
            },
            votes: Vec::new(),
            signed: Vec::new(),
            evidence,
            row_version,
            life_row_version,
            asked_ms: now_ms,
            deadline_ms,
            replaces: replaces.clone(),
            review,
        };
        let asked = self.prompt_view(id, &prompt);
        self.prompts.insert(id.clone(), prompt);
        self.emit(EventKind::ApprovalRequested {
            version: id.clone(),
            replaces,
            needed: asked.needed,
            deadline_ms,
            evidence,
            author: asked.author,
            new_permissions: asked.new_permissions,
            untested: asked.untested,
            on_drift: asked.on_drift,
        });
        let priority = self.profile.alarms.approval_waiting;
        self.raise(
            &format!("approval:{id}"),
            "approval",
            priority,
            false,
            &format!("{id} waits for approval"),
        );
        Ok(())
    }

    /// Takes one signed decision, with what was on the screen.
    pub(in crate::pipeline) fn decide(
        &mut self,
        signed: SignedApproval,
        shown: Option<&str>,
    ) -> Result<Reply, Fault> {
        let said = signed.approval().clone();
        let id = said.version.clone();
        let refuse = |code, text: String, hint: Option<&str>| {
            Ok(Reply::Refused { code, text, hint: hint.map(ToOwned::to_owned) })
        };
        if let Some(text) = shown.filter(|text| text.len() > SHOWN_BYTES_MAX) {
            let text = format!(
                "the text of the screen has {} bytes; at most {SHOWN_BYTES_MAX} are allowed",
                text.len()
            );
            return refuse(Refusal::BadInput, text, None);
        }
        let folder = self.ledger.store().layout().identities();
        let identity = match holdpoint_approvals::Identity::find(&folder, &said.who) {
            Ok(identity) => identity,
            Err(error) => {
                let hint = Some("make an identity with `holdpoint identity new`");
                return refuse(Refusal::NotAllowed, error.to_string(), hint);
            }
        };
        if let Err(error) = signed.verify(&identity) {
            return refuse(Refusal::NotAllowed, error.to_string(), None);
        }
        let Some(prompt) = self.prompts.get(&id) else {
            let text = format!("nothing waits for a decision on {id}");
            return refuse(Refusal::NotFound, text, Some("see `holdpoint status`"));
        };
        let profile =
            if said.profile == self.profile.name.name() { self.profile_digest } else { self.context_digest };
        let subject = Subject {
            candidate: said.candidate_digest,
            row_version: said.row_version,
            evidence: said.evidence_digest,
            policy: said.policy_digest,
            profile,
        };
        if subject != prompt.request.subject {
            let text = format!("the decision on {id} is over something that has changed since");
            return refuse(Refusal::Stale, text, Some("look at the prompt again and decide again"));
        }
        #[allow(clippy::cast_precision_loss, reason = "virtual milliseconds of one engine's life")]
        let expires_s = said.not_after_ms as f64 / 1000.0;
        let vote = Vote {
            person: said.who.clone(),
            role: identity.role,
            answer: said.decision,
            reason: said.reason.clone(),
            subject,
            expires_s,
            break_glass: false,
            signature: SignatureCheck::Valid,
            nonce_used: false,
        };
        let at_ms = self.clock.now_ms();
        let mut records = Vec::new();
        if let Some(shown) = shown {
            records.push(Self::shown_record(&id, &said.who, said.nonce.as_str(), shown)?);
        }
        let change = Change::PutApproval(Box::new(signed.clone()));
        if let Err(error) = self.ledger.write(vec![change], records, at_ms) {
            return refuse(Refusal::NotAllowed, error.to_string(), None);
        }
        let now_s = self.now_s();
        let settings = self.profile.approval;
        let Some(prompt) = self.prompts.get_mut(&id) else {
            return refuse(Refusal::NotFound, format!("nothing waits for a decision on {id}"), None);
        };
        prompt.votes.push(vote);
        prompt.signed.push(signed);
        let result = approval::evaluate(&prompt.request, &prompt.votes, now_s, &settings);
        let needed = u32::from(prompt.request.quorum);
        let have = match &result.outcome {
            ApprovalOutcome::Granted { people, .. } => u32::try_from(people.len()).unwrap_or(u32::MAX),
            ApprovalOutcome::Pending { missing } => needed.saturating_sub(u32::from(*missing)),
            ApprovalOutcome::NotNeeded | ApprovalOutcome::TimedOut | ApprovalOutcome::Refused { .. } => 0,
        };
        self.emit(EventKind::ApprovalReceived {
            version: id.clone(),
            by: said.who.clone(),
            decision: said.decision,
            reason: holdpoint_text::Untrusted::new(said.reason.clone()).line().into_string(),
            have,
            needed,
        });
        let text = self.settle_prompt(&id, &result)?;
        Ok(Reply::Accepted { text, version: Some(id) })
    }

    /// Acts on what asking came to so far. Returns a sentence for the one who asked or answered.
    pub(in crate::pipeline) fn settle_prompt(
        &mut self,
        id: &CapabilityId,
        result: &ApprovalResult,
    ) -> Result<String, Fault> {
        let (version, _, _) = self.ledger.version(id)?;
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
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded if self.is_out() => {
                // Versions change places between two sequences, never under a moving arm.
                self.granted.insert(id.clone());
                Ok(format!("{id} is approved and takes over when the sequence that runs is over"))
            }
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => {
                let Some(prompt) = self.prompts.remove(id) else { return Ok(reason) };
                let event = Event::Approved { version, row_version: prompt.life_row_version };
                let note = self.request_note(id, &prompt, RequestState::Granted, &reason);
                self.transition(&id.family, event, note)?;
                let by = prompt.signed.last().map(|signed| signed.approval().who.clone());
                self.clear_prompt_alarm(id, by);
                let approvals: Vec<SignedApproval> = prompt
                    .signed
                    .into_iter()
                    .filter(|signed| signed.approval().decision == Answer::Approve)
                    .collect();
                let gate = self.gate(id, Some(result))?;
                self.conclude_gate(id, gate, approvals)?;
                Ok(format!("{id} is approved"))
            }
            ApprovalOutcome::Refused { person } => {
                let Some(prompt) = self.prompts.remove(id) else { return Ok(reason) };
                self.dossier(id).reasons.clone_from(&result.reasons);
                let note = self.request_note(id, &prompt, RequestState::Refused, &reason);
                self.transition(&id.family, Event::Reject { version }, note)?;
                self.clear_prompt_alarm(id, Some(person.clone()));
                self.rejected(id)?;
                Ok(format!("{id} is rejected: {person} refused"))
            }
            ApprovalOutcome::TimedOut => {
                let Some(prompt) = self.prompts.remove(id) else { return Ok(reason) };
                let dossier = self.dossier(id);
                dossier.reasons.clone_from(&result.reasons);
                dossier.held = true;
                let note = self.request_note(id, &prompt, RequestState::Expired, &reason);
                self.transition(&id.family, Event::ApprovalExpired { version }, note)?;
                self.clear_prompt_alarm(id, None);
                self.abort_stage(id, "nobody answered in time; the version is held")?;
                Ok(format!("{id} is held: nobody answered in time"))
            }
        }
    }

    fn request_note(&self, id: &CapabilityId, prompt: &Prompt, state: RequestState, reason: &str) -> Note {
        let request = ApprovalRequest {
            id: prompt.id.clone(),
            version: id.clone(),
            row_version: prompt.row_version,
            evidence_digest: prompt.evidence,
            policy_digest: self.context_digest,
            profile: self.profile.name.name().to_owned(),
            needed: u32::from(prompt.request.quorum),
            deadline_ms: prompt.deadline_ms,
            state,
            json: "{}".to_owned(),
        };
        Note { before: vec![Change::PutApprovalRequest(Box::new(request))], ..Note::because(reason) }
    }

    /// Nobody waits any more. Whoever answered has seen that somebody did.
    fn clear_prompt_alarm(&mut self, id: &CapabilityId, answered_by: Option<String>) {
        let key = format!("approval:{id}");
        if let Some(by) = answered_by.filter(|_| self.alarms.get(&key).is_some()) {
            self.alarm_event(&AlarmEvent::Acknowledge { key: key.clone(), by });
        }
        self.alarm_event(&AlarmEvent::Clear { key });
    }

    /// Moves the binding: gate pass, used approvals, both state changes, pointer and record at once.
    fn activate(
        &mut self,
        id: &CapabilityId,
        passed: &GatePassed,
        decision: String,
        approvals: &[SignedApproval],
    ) -> Result<(), Fault> {
        let (version, _, _) = self.ledger.version(id)?;
        self.transition(
            &id.family,
            Event::Pass { version, stage: Stage::Activation },
            Note::because("the gate is passed"),
        )?;
        let evidence = self.dossier(id).digest()?;
        let gate_digest = Digest::of_parts("holdpoint.gate.v1", &[decision.as_bytes(), evidence.bytes()]);
        let replaced = self.active_of(&id.family).map(|active| active.id());
        let mut before = vec![Change::PutEvidence {
            version: id.clone(),
            kind: EvidenceKind::Gate,
            json: decision.clone(),
            digest: gate_digest,
        }];
        for signed in approvals {
            let nonce = signed.approval().nonce.as_str().to_owned();
            before.push(Change::ConsumeApproval { nonce, evidence_digest: evidence });
        }
        let needed = u32::try_from(approvals.len()).unwrap_or(u32::MAX);
        let note = Note {
            reason: "the gate is passed".to_owned(),
            cause: Some(ActiveCause::Gate { evidence: gate_digest, approvals_needed: needed }),
            before,
            after: Vec::new(),
            audit: vec![AuditBody {
                kind: holdpoint_governance::record::RecordKind::Decision,
                subject: id.to_string(),
                body: decision,
            }],
        };
        // Without a live monitor no tick runs under a provisional version: it is made first.
        let watch = self.new_watch(id)?;
        self.transition(&id.family, Event::Activate { version }, note)?;
        self.watches.insert(id.family.clone(), watch);
        let terms = passed.terms();
        self.emit(EventKind::Activated {
            version: id.clone(),
            replaced,
            modes: terms.modes.iter().copied().collect(),
            conditions: terms.conditions.clone(),
            provisional_episodes: terms.provisional_episodes,
        });
        Ok(())
    }

    /// Prompts and escalations whose time is over. Tells whether anything was done.
    pub(in crate::pipeline) fn look_at_deadlines(&mut self) -> Result<bool, Fault> {
        Ok(self.look_at_prompts()? || self.look_at_monitors()?)
    }

    /// Prompts whose time is over. Tells whether anything was done.
    pub(in crate::pipeline) fn look_at_prompts(&mut self) -> Result<bool, Fault> {
        let now_ms = self.clock.now_ms();
        let due: Vec<CapabilityId> = self
            .prompts
            .iter()
            .filter(|(id, prompt)| prompt.deadline_ms <= now_ms && !self.granted.contains(id))
            .map(|(id, _)| id.clone())
            .collect();
        for id in &due {
            let now_s = self.now_s();
            let settings = self.profile.approval;
            let Some(prompt) = self.prompts.get(id) else { continue };
            let result = approval::evaluate(&prompt.request, &prompt.votes, now_s, &settings);
            self.settle_prompt(id, &result)?;
        }
        Ok(!due.is_empty())
    }

    pub(in crate::pipeline) fn next_deadline_ms(&self) -> Option<u64> {
        let prompts = self.prompts.values().map(|prompt| prompt.deadline_ms);
        prompts.chain(self.next_escalation_ms()).min()
    }
}

/// Whole milliseconds of a span; profiles hold finite, bounded, non-negative times.
pub(in crate::pipeline) fn secs_to_ms(secs: f64) -> u64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let ms = (secs.clamp(0.0, 1.0e9) * 1000.0) as u64;
    ms
}
