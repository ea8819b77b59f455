//! Break-glass: one person activates a version past missing approvals, a freeze or a block; two others review it.
//!
//! Break-glass never overrides a measurement: the gate decides with the emergency approval, and its rejections and
//! returns to evaluation stand. A version not reviewed by its deadline is demoted, and the review stays open;
//! until it is closed no version of the family is promoted (design rule 3.10).

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey, Priority};
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::gate::GateOutcome;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{DeactivationKind, LifecycleEvent, Review, Stage, State};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::{AuditBody, Change, RequestState};
use holdpoint_wording::command_effect::{VersionEffect, version_effect};

use super::activation::{Activation, Admission, activate, gate};
use super::closing::{first_reason, report_decision};
use super::monitoring::{LiveMonitoring, maybe_confirm};
use super::rollback::trigger;
use crate::decide::halt;
use crate::decide::operations::accepted;
use crate::decide::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::decide::people::break_glass_approvals;
use crate::decide::people::request_display::RequestSources;
use crate::fault::EngineFault;
use holdpoint_record::version_table::TransitionNote;

impl Activation<'_> {
    /// One person activates a version by break-glass. A refusal changes nothing.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub(crate) fn break_glass(&mut self, signed: SignedApproval) -> Result<Reply, EngineFault> {
        // Before anything is written.
        self.agent.check()?;
        if self.cell_stands {
            return Ok(halt::activation_refusal(&signed.approval().version));
        }
        let (context, record, evidence_files) = (self.context, &*self.record, &*self.evidence_files);
        let from = RequestSources { context, record, evidence_files };
        let emergency = match break_glass_approvals::check(from, self.approvals, signed)? {
            Ok(emergency) => emergency,
            Err(refusal) => return Ok(refusal),
        };
        let approval = emergency.signed.approval().clone();
        let (id, until) = (approval.version.clone(), emergency.until);
        let result = gate(self.context, self.record, self.evidence_files, &id, Some(&emergency.result))?;
        let (GateOutcome::Pass, Some(passed)) = (result.decision.outcome(), &result.passed) else {
            return Ok(Reply::Refused {
                code: Refusal::NotNow,
                text: format!(
                    "{id} is not activated: {}",
                    holdpoint_wording::notice_sentence(&first_reason(&result.decision))
                ),
                hint: Some(
                    "break-glass overrides missing approvals, a freeze or a block, nothing else".to_owned(),
                ),
            });
        };
        let (version, lifecycle, _) = self.record.version_table().version(&id)?;
        let (running, awaits_approval) = (lifecycle.flags.running, lifecycle.flags.awaiting_approval);
        let body = serde_json::json!({ "by": approval.who, "reason": approval.reason, "until": until });
        let records = vec![
            AuditBody { kind: RecordKind::BreakGlass, subject: id.to_string(), body: body.to_string() },
            emergency.shown.record(&approval)?,
        ];
        self.record.write(vec![Change::PutApproval(Box::new(emergency.signed.clone()))], records)?;
        self.record.tell(EventKind::BreakGlass {
            version: id.clone(),
            by: approval.who.clone(),
            reason: approval.reason.clone(),
            until,
        });
        if running != Some(Stage::Activation) {
            self.record.start_stage(&id, Stage::Activation, 1)?;
        }
        let needs_approval = self.record.version_table().family(&id.family)?.state.needs_approval;
        if needs_approval && !awaits_approval {
            let note = TransitionNote::because(Notice::BreakGlassBegins);
            self.record.transition(&id.family, LifecycleEvent::RequestApproval { version }, note)?;
        }
        if needs_approval || awaits_approval {
            let note = match self.approvals.close(&id) {
                Some(prompt) => closing_note(&prompt, RequestState::Granted, Notice::BreakGlassUsed),
                None => TransitionNote::because(Notice::BreakGlassUsed),
            };
            let row_version = self.record.version_table().version(&id)?.1.row_version;
            self.record.transition(&id.family, LifecycleEvent::Approved { version, row_version }, note)?;
            clear_alarm(self.record, &id, Some(approval.who.clone()));
        }
        let evidence_file = self.evidence_files.edit(&id);
        evidence_file.held = false;
        evidence_file.take_gate(&result.decision);
        report_decision(self.context, self.record, evidence_file, &id, Stage::Activation, &result.decision);
        let decision = serde_json::to_string(&result.decision)?;
        let (agent, emergency_until) = (self.agent, Some(until));
        let entry = Admission { passed, decision, agent, emergency_until };
        activate(self.context, self.record, self.monitors, evidence_file, &id, entry, &[emergency.signed])?;
        // Like an engine's own fault it has one priority in every profile.
        let notice = Notice::Unreviewed { version: id.clone(), by: approval.who };
        self.record.raise(AlarmKey::Unreviewed(id.clone()), Priority::High, false, notice);
        accepted(&id, &VersionEffect::ActiveByBreakGlass { until })
    }
}

/// Open reviews: demotes a version that was not reviewed in time, and keeps the review request open in any state
/// of the version. Returns whether anything was done.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn look_at_reviews(
    live: &mut LiveMonitoring<'_>,
    approvals: &mut Approvals,
) -> Result<bool, EngineFault> {
    let families = live.record.version_table().families();
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
            let trigger = trigger(live.record, TriggerKind::Unreviewed, Notice::ReviewLate);
            live.deactivate(&id, trigger, None, DeactivationKind::Demoted)?;
            return Ok(true);
        }
        if approvals.of(&id).is_none_or(|pending| !pending.is_about(row_version, overdue)) {
            approvals.request_review(live.context, live.record, live.evidence_files, &id, review)?;
            return Ok(true);
        }
    }
    Ok(false)
}

/// Acts on the review's answers so far. Returns a sentence for the reviewer.
///
/// # Errors
/// If the result cannot be written.
pub(crate) fn settle_review(
    live: &mut LiveMonitoring<'_>,
    approvals: &mut Approvals,
    id: &CapabilityId,
    result: &ApprovalResult,
) -> Result<String, EngineFault> {
    let (upheld, by) = match &result.outcome {
        ApprovalOutcome::Granted { people, .. } => (true, people.iter().cloned().collect::<Vec<_>>()),
        ApprovalOutcome::Refused { person } => (false, vec![person.clone()]),
        // A review that is late is still a review.
        ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut | ApprovalOutcome::NotNeeded => {
            let last = result.reasons.last();
            return Ok(version_effect(id, &VersionEffect::AwaitsReview { last }));
        }
    };
    let (version, lifecycle, _) = live.record.version_table().version(id)?;
    if !upheld && lifecycle.state == State::Active {
        let notice = Notice::ReviewNotUpheld { by: by.clone() };
        let trigger = trigger(live.record, TriggerKind::Operator, notice);
        live.deactivate(id, trigger, None, DeactivationKind::RolledBack)?;
    }
    let state = if upheld { RequestState::Granted } else { RequestState::Refused };
    let mut note = match approvals.close(id) {
        Some(prompt) => closing_note(&prompt, state, Notice::ReviewClosed),
        None => TransitionNote::because(Notice::ReviewClosed),
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
        maybe_confirm(live.record, live.evidence_files, live.monitors, id)?;
    }
    Ok(version_effect(id, &VersionEffect::Reviewed { upheld }))
}

/// Upholding an activation past a block also unblocks the version under the profile.
fn open_profile(live: &mut LiveMonitoring<'_>, id: &CapabilityId) -> Result<(), EngineFault> {
    let profile = live.context.profile.name;
    live.evidence_files.edit(id).closed.remove(&profile);
    let (version, lifecycle, _) = live.record.version_table().version(id)?;
    if lifecycle.state == State::Active && lifecycle.is_blocked_under(profile) {
        let note = TransitionNote::because(Notice::ProfileUnblockedByReview);
        live.record.transition(&id.family, LifecycleEvent::Open { version, profile }, note)?;
    }
    Ok(())
}
