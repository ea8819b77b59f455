//! A drift monitor's question to operators: shown while open, answered with "continue", asked again when it recurs.
//!
//! Owns the answer and its record. The monitor decides what raises a question and what an unanswered one causes. An
//! answer lifts no restriction and confirms no version.

use crate::decide::operations::{accepted, checked, own_version_refusal};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::monitors::Monitors;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::monitor::{MonitorAction, MonitorAnswer};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_wording::command_effect::VersionEffect;

/// An operator answers a monitor's question: the version continues and its charts restart.
pub(crate) fn answer_continue(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &EvidenceFiles,
    monitors: &mut Monitors,
    operation: &Operation,
) -> Result<Reply, EngineFault> {
    let id = checked(record, operation)?;
    let now_tick = record.now_tick();
    let expected = evidence_files.of(&id).and_then(|file| file.normal_rates(&context.profile.monitor));
    let monitor = monitors.of_mut(&id).filter(|watched| {
        watched.monitor.escalation().is_some_and(|escalation| escalation.deadline_tick > now_tick)
    });
    let (Some(expected), Some(watched)) = (expected, monitor) else {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("no monitor asks about {id}"),
            hint: Some("open questions are in `holdpoint status`".to_owned()),
        });
    };
    // An author could keep a version in control that gets worse: each answer restarts its charts.
    if let Some(refused) = own_version_refusal(context, record, operation)? {
        return Ok(refused);
    }
    watched
        .monitor
        .on_answer(&context.profile, &expected, now_tick)
        .map_err(|error| EngineFault::Impossible(error.to_string()))?;
    // The next question is a new one.
    watched.announced = MonitorAction::Continue;
    watched.escalation_reason = None;
    watched.question.clear();
    let answer = MonitorAnswer::GoOn;
    let body = serde_json::json!({ "answer": answer, "by": operation.by, "reason": operation.reason });
    record.note(RecordKind::MonitorAnswer, id.to_string(), body.to_string())?;
    record.tell(EventKind::Continued {
        version: id.clone(),
        by: operation.by.clone(),
        reason: operation.reason.clone(),
    });
    record.alarm_event(&AlarmEvent::Clear { key: AlarmKey::Escalated(id.clone()) });
    accepted(&id, &VersionEffect::Continues)
}

#[cfg(test)]
mod tests;
