//! Break-glass: one person lets in what people or the calendar hold back, and two others review it.
//!
//! Never a way around what was measured: the gate is asked with the emergency approval in hand, and what it rejects
//! or sends back stays so. Unreviewed by its deadline the version is taken off, and the review stays open; nothing of
//! the family is promoted before it is closed (design rule 3.10).

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::gate::GateOutcome;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Leave, LifecycleEvent, Review, Stage, State};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::names::RequestState;
use holdpoint_registry::{AuditBody, Change};

use super::activation::{Activation, Admission, activate, gate};
use super::closing::{decided, first_reason};
use super::monitoring::{Live, maybe_confirm};
use super::rollback::trigger;
use crate::fault::Fault;
use crate::halt;
use crate::ledger::Note;
use crate::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::people::emergencies;

impl Activation<'_> {
    /// One person lets a version in by the emergency door. What is refused has changed nothing.
    ///
    /// # Errors
    /// If what it comes to cannot be written.
    pub(crate) fn break_glass(&mut self, signed: SignedApproval) -> Result<Reply, Fault> {
        // Before anything is written.
        self.agent.check()?;
        if self.cell_stands {
            return Ok(halt::lets_nothing_in(&signed.approval().version));
        }
        let checked = emergencies::check(self.context, self.record, self.dossiers, self.approvals, signed)?;
        let emergency = match checked {
            Ok(emergency) => emergency,
            Err(refused) => return Ok(refused),
        };
        let said = emergency.signed.approval().clone();
        let (id, until) = (said.version.clone(), emergency.until);
        let judged = gate(self.context, self.record, self.dossiers, &id, Some(&emergency.result))?;
        let (GateOutcome::Pass, Some(passed)) = (judged.decision.outcome(), &judged.passed) else {
            return Ok(Reply::Refused {
                code: Refusal::NotNow,
                text: format!("{id} is not let in: {}", first_reason(&judged.decision)),
                hint: Some("the emergency door overrules people and the calendar, nothing else".to_owned()),
            });
        };
        let (version, standing, _) = self.record.ledger().version(&id)?;
        let (running, asked) = (standing.flags.running, standing.flags.awaiting_approval);
        let body = serde_json::json!({ "by": said.who, "reason": said.reason, "until": until });
        let records = vec![
            AuditBody { kind: RecordKind::BreakGlass, subject: id.to_string(), body: body.to_string() },
            emergency.shown.record(&said)?,
        ];
        self.record.write(vec![Change::PutApproval(Box::new(emergency.signed.clone()))], records)?;
        self.record.tell(EventKind::BreakGlass {
            version: id.clone(),
            by: said.who.clone(),
            reason: said.reason.clone(),
            until,
        });
        if running != Some(Stage::Activation) {
            self.record.start_stage(&id, Stage::Activation, 1)?;
        }
        let needs_approval = self.record.ledger().family(&id.family)?.state.needs_approval;
        if needs_approval && !asked {
            let note = Note::because("one person answers, by the emergency door");
            self.record.transition(&id.family, LifecycleEvent::RequestApproval { version }, note)?;
        }
        if needs_approval || asked {
            let note = match self.approvals.close(&id) {
                Some(prompt) => {
                    closing_note(self.context, &id, &prompt, RequestState::Granted, "the emergency door")
                }
                None => Note::because("the emergency door was used"),
            };
            let row_version = self.record.ledger().version(&id)?.1.row_version;
            self.record.transition(&id.family, LifecycleEvent::Approved { version, row_version }, note)?;
            clear_alarm(self.record, &id, Some(said.who.clone()));
        }
        let dossier = self.dossiers.edit(&id);
        dossier.held = false;
        dossier.take_gate(&judged.decision);
        decided(self.context, self.record, dossier, &id, Stage::Activation, &judged.decision);
        let decision = serde_json::to_string(&judged.decision)?;
        let (agent, emergency_until) = (self.agent, Some(until));
        let entry = Admission { passed, decision, agent, emergency_until };
        activate(self.context, self.record, self.monitors, dossier, &id, entry, &[emergency.signed])?;
        // Like an engine's own fault it has one priority in every profile.
        let text = format!("{id} was let in by {} alone and is not reviewed", said.who);
        self.record.raise(AlarmKey::Unreviewed(id.clone()), Priority::High, false, &text);
        Ok(Reply::Accepted {
            text: format!("{id} is active by the emergency door; two people review it by {until}"),
            version: Some(id),
        })
    }
}

/// Open reviews: what is not reviewed in time is taken off, and the question is open whatever has become of the
/// version. Tells whether anything was done.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn look_at_reviews(live: &mut Live<'_>, approvals: &mut Approvals) -> Result<bool, Fault> {
    let families = live.record.ledger().families();
    let open: Vec<(CapabilityId, State, u64, Review)> = families
        .filter_map(|(_, entry)| {
            let review = entry.state.review?;
            let member = entry.members.get(usize::from(review.version.0))?;
            let state = entry.state.state(review.version)?;
            Some((member.capability.id(), state, member.row_version, review))
        })
        .collect();
    for (id, state, row_version, review) in open {
        let overdue = review.until <= live.record.wall_now();
        if overdue && state == State::Active {
            let text = "nobody reviewed its emergency activation in time";
            let trigger = trigger(live.record, TriggerKind::Unreviewed, text);
            live.take_off(&id, trigger, None, Leave::Demoted)?;
            return Ok(true);
        }
        if approvals.of(&id).is_none_or(|asked| !asked.is_about(row_version, overdue)) {
            approvals.ask_review(live.context, live.record, live.dossiers, &id, review)?;
            return Ok(true);
        }
    }
    Ok(false)
}

/// Acts on what a review came to so far. Returns a sentence for the one who answered.
///
/// # Errors
/// If what it comes to cannot be written.
pub(crate) fn settle_review(
    live: &mut Live<'_>,
    approvals: &mut Approvals,
    id: &CapabilityId,
    result: &ApprovalResult,
) -> Result<String, Fault> {
    let (upheld, by) = match &result.outcome {
        ApprovalOutcome::Granted { people, .. } => (true, people.iter().cloned().collect::<Vec<_>>()),
        ApprovalOutcome::Refused { person } => (false, vec![person.clone()]),
        // A review that is late is still a review.
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut | ApprovalOutcome::NotNeeded => {
            let last = result.reasons.last().map_or_else(String::new, |reason| reason.text.clone());
            return Ok(format!("the review of {id} waits for more people; {last}"));
        }
    };
    let (version, standing, _) = live.record.ledger().version(id)?;
    if !upheld && standing.state == State::Active {
        let text = format!("the review of its emergency activation did not uphold it: {}", by.join(", "));
        let trigger = trigger(live.record, TriggerKind::Operator, text);
        live.take_off(id, trigger, None, Leave::RolledBack)?;
    }
    let state = if upheld { RequestState::Granted } else { RequestState::Refused };
    let mut note = match approvals.close(id) {
        Some(prompt) => closing_note(live.context, id, &prompt, state, "the review is closed"),
        None => Note::because("the review is closed"),
    };
    note.audit.push(AuditBody {
        kind: RecordKind::BreakGlassReviewed,
        subject: id.to_string(),
        body: serde_json::json!({ "upheld": upheld, "by": by }).to_string(),
    });
    live.record.transition(&id.family, LifecycleEvent::Reviewed { version }, note)?;
    live.record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::Unreviewed(id.clone()) });
    live.record.tell(EventKind::Reviewed { version: id.clone(), upheld, by });
    if upheld {
        open_profile(live, id)?;
        maybe_confirm(live.record, live.dossiers, live.monitors, id)?;
        return Ok(format!("the emergency activation of {id} is upheld"));
    }
    Ok(format!("the emergency activation of {id} is not upheld"))
}

/// Who reviewed a version that was let in past a closed profile, and upholds that, has opened the profile.
fn open_profile(live: &mut Live<'_>, id: &CapabilityId) -> Result<(), Fault> {
    let profile = live.context.profile.name;
    live.dossiers.edit(id).closed.remove(&profile);
    let (version, standing, _) = live.record.ledger().version(id)?;
    if standing.state == State::Active && standing.closed.contains(&profile) {
        let note = Note::because("the review of the emergency activation upheld it under this profile");
        live.record.transition(&id.family, LifecycleEvent::Open { version, profile }, note)?;
    }
    Ok(())
}
