//! A monitor's question to people: shown while it waits, answered with "go on", told again when it comes again.
//!
//! Owns the answer and its record. What a question is raised for, and what becomes of one that nobody answers, is
//! the monitor's. An answer lifts no restriction and confirms nothing.

use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::monitors::Monitors;
use crate::operations::checked;
use crate::record::Record;
use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::monitor::{MonitorAction, MonitorAnswer, normal_rates};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;

/// Somebody answers a monitor's question: the version goes on, its charts begin anew.
pub(crate) fn go_on(
    context: &Context,
    record: &mut Record,
    dossiers: &Dossiers,
    monitors: &mut Monitors,
    operation: &Operation,
) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let now_tick = record.now_tick();
    let expected = dossiers.of(&id).and_then(|dossier| normal_rates(&dossier.twins));
    let asking = monitors
        .of_mut(&id)
        .filter(|watched| watched.monitor.escalation().is_some_and(|asked| asked.deadline_tick > now_tick));
    let (Some(expected), Some(watched)) = (expected, asking) else {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("no monitor asks about {id}"),
            hint: Some("open questions are in `holdpoint status`".to_owned()),
        });
    };
    watched
        .monitor
        .answered(&context.profile, &expected, now_tick)
        .map_err(|error| Fault::Impossible(error.to_string()))?;
    // The next question is a new one.
    watched.announced = MonitorAction::Continue;
    watched.asked = None;
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
    Ok(Reply::Accepted { text: format!("{id} goes on"), version: Some(id) })
}

#[cfg(test)]
mod tests;
