//! Lifts restrictions: the full envelope returns, or a version is unblocked under a profile.
//!
//! A profile that binds activations to people's approval asks them for a release as well (design rule 3.10); elsewhere
//! a person's word with a reason is enough.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, State};
use holdpoint_governance::monitor::{MonitorAction, MonitorAnswer};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_store::{AuditBody, RequestState};
use holdpoint_wording::command_effect::{VersionEffect, version_effect};

use crate::decide::operations::{accepted, checked, own_version_refusal};
use crate::decide::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::decide::recorder::EngineRecorder;
use crate::decide::stages::closing::end_request;
use crate::decide::stages::monitoring::LiveMonitoring;
use crate::fault::EngineFault;
use crate::live::monitors::Monitors;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_table::TransitionNote;
use holdpoint_wording::program::engine::RELEASE_APPROVED;

/// A person requests to lift the restriction of an active version.
pub(crate) fn release(
    live: &mut LiveMonitoring<'_>,
    approvals: &mut Approvals,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(live.record, operation)?;
    let (_, lifecycle, _) = live.record.version_table().version(&id)?;
    if lifecycle.state != State::Active || !lifecycle.flags.restricted {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is {} and not restricted", lifecycle.state),
            hint: Some("to unblock a version, name the profile; see `holdpoint status`".to_owned()),
        });
    }
    if !live.context.needs_approval() {
        if let Some(refused) = own_version_refusal(live.context, live.record, operation)? {
            return Ok(refused);
        }
        let Operation { by, reason, .. } = operation;
        let notice = Notice::RestrictionLifted { by: by.clone(), reason: reason.clone() };
        lift(live, &id, by, reason, notice)?;
        return accepted(&id, &VersionEffect::Released);
    }
    if approvals.of(&id).is_some() {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("people are asked about {id} already"),
            hint: Some("that question is answered first; see `holdpoint status`".to_owned()),
        });
    }
    approvals.request_release(live.context, live.record, live.evidence_files, operation)?;
    accepted(&id, &VersionEffect::ReleaseAsked)
}

/// Acts on the answers to such a request so far. Returns a sentence for the approver.
pub(crate) fn settle(
    live: &mut LiveMonitoring<'_>,
    approvals: &mut Approvals,
    id: &CapabilityId,
    result: &ApprovalResult,
) -> Result<String, EngineFault> {
    let last = result.reasons.last();
    match &result.outcome {
        ApprovalOutcome::Pending { missing } => {
            Ok(version_effect(id, &VersionEffect::AwaitsRelease { missing: *missing, last }))
        }
        ApprovalOutcome::Granted { people, .. } => {
            let Some(prompt) = approvals.of(id) else {
                return Ok(last.map_or_else(String::new, holdpoint_wording::reason));
            };
            let by = people.iter().cloned().collect::<Vec<_>>().join(", ");
            let (version, _, _) = live.record.version_table().version(id)?;
            let note = closing_note(prompt, RequestState::Granted, Notice::ReleaseApproved);
            let event = LifecycleEvent::Approved { version, row_version: prompt.life_row_version };
            let answered = prompt.last_voter();
            live.record.transition(&id.family, event, note)?;
            approvals.close(id);
            clear_alarm(live.record, id, answered);
            let notice = Notice::RestrictionLiftedByApprovers { by: by.clone() };
            lift(live, id, &by, RELEASE_APPROVED, notice)?;
            Ok(version_effect(id, &VersionEffect::Released))
        }
        ApprovalOutcome::Refused { person } => {
            end_request(live.record, approvals, id, RequestState::Refused, Notice::ReleaseRefused)?;
            Ok(version_effect(id, &VersionEffect::ReleaseRefusedBy(person)))
        }
        ApprovalOutcome::TimedOut | ApprovalOutcome::NotNeeded => {
            lapse(live.record, approvals, id)?;
            Ok(version_effect(id, &VersionEffect::ReleaseExpired))
        }
    }
}

/// No answer came in time: the version stays restricted, and a person can ask again.
pub(crate) fn lapse(
    record: &mut EngineRecorder,
    approvals: &mut Approvals,
    id: &CapabilityId,
) -> Result<(), EngineFault> {
    end_request(record, approvals, id, RequestState::Expired, Notice::ReleaseLapsed).map(|_| ())
}

/// The restriction ends: in the record, in the envelope from the next task on, and in the monitor, which restarts.
fn lift(
    live: &mut LiveMonitoring<'_>,
    id: &CapabilityId,
    by: &str,
    reason: &str,
    notice: Notice,
) -> Result<(), EngineFault> {
    let (version, _, _) = live.record.version_table().version(id)?;
    let answer = serde_json::json!({ "answer": MonitorAnswer::Release, "by": by, "reason": reason });
    let mut note = TransitionNote::because(notice);
    note.audit.push(AuditBody {
        kind: RecordKind::MonitorAnswer,
        subject: id.to_string(),
        body: answer.to_string(),
    });
    live.record.transition(&id.family, LifecycleEvent::Release { version }, note)?;
    release_monitor(live.context, live.record, live.evidence_files, live.monitors, id)?;
    live.record.tell(EventKind::Released {
        version: id.clone(),
        by: by.to_owned(),
        reason: reason.to_owned(),
    });
    for key in [AlarmKey::Restricted(id.clone()), AlarmKey::Escalated(id.clone())] {
        live.record.alarm_event(&AlarmEvent::Clear { key });
    }
    Ok(())
}

fn release_monitor(
    context: &Context,
    record: &EngineRecorder,
    evidence_files: &EvidenceFiles,
    monitors: &mut Monitors,
    id: &CapabilityId,
) -> Result<(), EngineFault> {
    let now_tick = record.now_tick();
    let expected = evidence_files.of(id).and_then(|file| file.normal_rates(&context.profile.monitor));
    let (Some(watched), Some(expected)) = (monitors.of_mut(id), expected) else { return Ok(()) };
    watched
        .monitor
        .on_restriction_lifted(&context.profile, &expected, now_tick)
        .map_err(|error| EngineFault::Impossible(error.to_string()))?;
    watched.restricted = false;
    watched.announced = MonitorAction::Continue;
    watched.escalation_reason = None;
    watched.question.clear();
    if !watched.confirmed {
        watched.episodes = 0;
    }
    Ok(())
}

/// Blocks or unblocks a version under profiles. A refusal changes nothing.
pub(crate) fn set_profiles(
    record: &mut EngineRecorder,
    operation: &Operation,
    profiles: &[ProfileName],
    block: bool,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let (version, lifecycle, _) = record.version_table().version(&id)?;
    let wanted: Vec<ProfileName> = ProfileName::ALL
        .into_iter()
        .filter(|profile| profiles.contains(profile) && lifecycle.is_blocked_under(*profile) != block)
        .collect();
    if wanted.is_empty() || lifecycle.state.is_terminal() {
        let how = if block { "blocks" } else { "permits" };
        let text = if lifecycle.state.is_terminal() {
            format!("{id} is {}, which is final", lifecycle.state)
        } else {
            format!("every named profile {how} {id} already")
        };
        return Ok(Reply::Refused { code: Refusal::NotNow, text, hint: None });
    }
    let mut after = lifecycle.closed.clone();
    for profile in &wanted {
        if block {
            after.insert(*profile)
        } else {
            after.remove(profile)
        };
    }
    let blocked_under: Vec<ProfileName> = after.into_iter().collect();
    let body = serde_json::json!({ "closed": blocked_under, "by": operation.by, "reason": operation.reason });
    for (index, profile) in wanted.iter().copied().enumerate() {
        let event = if block {
            LifecycleEvent::Close { version, profile }
        } else {
            LifecycleEvent::Open { version, profile }
        };
        let (by, reason) = (operation.by.clone(), operation.reason.clone());
        let why = if block {
            Notice::ProfileBlocked { profile, by, reason }
        } else {
            Notice::ProfileUnblocked { profile, by, reason }
        };
        let mut note = TransitionNote::because(why);
        if index == 0 {
            note.audit.push(AuditBody {
                kind: RecordKind::ProfilesSet,
                subject: id.to_string(),
                body: body.to_string(),
            });
        }
        record.transition(&id.family, event, note)?;
    }
    record.tell(EventKind::ProfilesSet {
        version: id.clone(),
        closed: blocked_under.clone(),
        by: operation.by.clone(),
        reason: operation.reason.clone(),
    });
    accepted(&id, &VersionEffect::BlockedUnder(&blocked_under))
}
