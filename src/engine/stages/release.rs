//! The way out of a restriction: a tightened envelope is lifted, a closed profile is opened.
//!
//! A profile that binds activations to people's approval asks them for a release as well (design rule 3.10); elsewhere
//! a person's word with a reason is enough.

use holdpoint_governance::alarms::{AlarmEvent, AlarmKey};
use holdpoint_governance::approval::{ApprovalOutcome, ApprovalResult};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, State};
use holdpoint_governance::monitor::{MonitorAction, MonitorAnswer, normal_rates};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Operation, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::AuditBody;
use holdpoint_registry::names::RequestState;

use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::ledger::Note;
use crate::monitors::Monitors;
use crate::operations::checked;
use crate::people::approvals::{Approvals, clear_alarm, closing_note};
use crate::record::Record;
use crate::stages::monitoring::Live;

/// Somebody asks for the restriction of an active version to be lifted.
pub(crate) fn release(
    live: &mut Live<'_>,
    approvals: &mut Approvals,
    operation: &Operation,
) -> Result<Reply, Fault> {
    let id = checked(live.record, operation)?;
    let (_, standing, _) = live.record.ledger().version(&id)?;
    if standing.state != State::Active || !standing.flags.restricted {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("{id} is {} and not restricted", standing.state),
            hint: Some("closed profiles are opened by name; see `holdpoint status`".to_owned()),
        });
    }
    if !live.context.needs_approval() {
        lift(live, &id, &operation.by, &operation.reason, Note::default())?;
        return Ok(Reply::Accepted { text: format!("{id} is released"), version: Some(id) });
    }
    if approvals.of(&id).is_some() {
        return Ok(Reply::Refused {
            code: Refusal::NotNow,
            text: format!("people are asked about {id} already"),
            hint: Some("that question is answered first; see `holdpoint status`".to_owned()),
        });
    }
    approvals.ask_release(live.context, live.record, live.dossiers, operation)?;
    Ok(Reply::Accepted { text: format!("people are asked to release {id}"), version: Some(id) })
}

/// Acts on what asking for a release came to so far. Returns a sentence for the one who answered.
pub(crate) fn settle(
    live: &mut Live<'_>,
    approvals: &mut Approvals,
    id: &CapabilityId,
    result: &ApprovalResult,
) -> Result<String, Fault> {
    let last = result.reasons.last().map_or_else(String::new, |reason| reason.text.clone());
    match &result.outcome {
        ApprovalOutcome::Pending { missing } => {
            Ok(format!("the release of {id} waits for {missing} more; {last}"))
        }
        ApprovalOutcome::Granted { people, .. } => {
            let Some(prompt) = approvals.of(id) else { return Ok(last) };
            let by = people.iter().cloned().collect::<Vec<_>>().join(", ");
            let (version, _, _) = live.record.ledger().version(id)?;
            let note = closing_note(live.context, id, prompt, RequestState::Granted, "people released it");
            let event = LifecycleEvent::Approved { version, row_version: prompt.life_row_version() };
            let answered = prompt.last_voter();
            live.record.transition(&id.family, event, note)?;
            approvals.close(id);
            clear_alarm(live.record, id, answered);
            lift(live, id, &by, "people approved its release", Note::default())?;
            Ok(format!("{id} is released"))
        }
        ApprovalOutcome::Refused { person } => {
            close(
                live.context,
                live.record,
                approvals,
                id,
                RequestState::Refused,
                "its release was refused",
            )?;
            Ok(format!("{id} stays restricted: {person} refused"))
        }
        ApprovalOutcome::TimedOut | ApprovalOutcome::NotNeeded => {
            lapse(live.context, live.record, approvals, id)?;
            Ok(format!("{id} stays restricted: too few people answered in time"))
        }
    }
}

/// Nobody answered in time: the version stays restricted, and can be asked about again.
pub(crate) fn lapse(
    context: &Context,
    record: &mut Record,
    approvals: &mut Approvals,
    id: &CapabilityId,
) -> Result<(), Fault> {
    close(
        context,
        record,
        approvals,
        id,
        RequestState::Expired,
        "too few people answered in time; it stays restricted",
    )
}

fn close(
    context: &Context,
    record: &mut Record,
    approvals: &mut Approvals,
    id: &CapabilityId,
    state: RequestState,
    why: &str,
) -> Result<(), Fault> {
    let Some(prompt) = approvals.of(id) else { return Ok(()) };
    let note = closing_note(context, id, prompt, state, why);
    let (version, standing, _) = record.ledger().version(id)?;
    if standing.flags.awaiting_approval {
        record.transition(&id.family, LifecycleEvent::ApprovalExpired { version }, note)?;
    } else {
        // The version left its place meanwhile, and the question with it.
        record.write(note.before, Vec::new())?;
    }
    approvals.close(id);
    clear_alarm(record, id, None);
    Ok(())
}

/// The restriction ends: on record, in the envelope from the next task on, and for the monitor, which begins anew.
fn lift(live: &mut Live<'_>, id: &CapabilityId, by: &str, reason: &str, note: Note) -> Result<(), Fault> {
    let (version, _, _) = live.record.ledger().version(id)?;
    let answer = serde_json::json!({ "answer": MonitorAnswer::Release, "by": by, "reason": reason });
    let mut note = Note { reason: format!("released by {by}: {reason}"), ..note };
    note.audit.push(AuditBody {
        kind: RecordKind::MonitorAnswer,
        subject: id.to_string(),
        body: answer.to_string(),
    });
    live.record.transition(&id.family, LifecycleEvent::Release { version }, note)?;
    begin_anew(live.context, live.record, live.dossiers, live.monitors, id)?;
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

fn begin_anew(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    monitors: &mut Monitors,
    id: &CapabilityId,
) -> Result<(), Fault> {
    let now_tick = record.now_tick();
    let expected = dossiers.of(id).and_then(|dossier| normal_rates(&dossier.twins));
    let (Some(watched), Some(expected)) = (monitors.of_mut(id), expected) else { return Ok(()) };
    watched
        .monitor
        .released(&context.profile, &expected, now_tick)
        .map_err(|error| Fault::Impossible(error.to_string()))?;
    watched.restricted = false;
    watched.announced = MonitorAction::Continue;
    watched.asked = None;
    watched.question.clear();
    if !watched.confirmed {
        watched.episodes = 0;
    }
    Ok(())
}

/// Closes profiles to a version, or opens them again. What is refused has changed nothing.
pub(crate) fn set_profiles(
    record: &mut Record,
    operation: &Operation,
    profiles: &[ProfileName],
    closed: bool,
) -> Result<Reply, Fault> {
    let id = checked(record, operation)?;
    let (version, standing, _) = record.ledger().version(&id)?;
    let wanted: Vec<ProfileName> = ProfileName::ALL
        .into_iter()
        .filter(|profile| profiles.contains(profile) && standing.closed.contains(profile) != closed)
        .collect();
    if wanted.is_empty() || standing.state.is_terminal() {
        let how = if closed { "closed to" } else { "open to" };
        let text = if standing.state.is_terminal() {
            format!("{id} is {} for good", standing.state)
        } else {
            format!("every profile named is {how} {id} already")
        };
        return Ok(Reply::Refused { code: Refusal::NotNow, text, hint: None });
    }
    let mut after = standing.closed.clone();
    for profile in &wanted {
        if closed {
            after.insert(*profile)
        } else {
            after.remove(profile)
        };
    }
    let closed_now: Vec<ProfileName> = after.into_iter().collect();
    let body = serde_json::json!({ "closed": closed_now, "by": operation.by, "reason": operation.reason });
    for (index, profile) in wanted.iter().copied().enumerate() {
        let event = if closed {
            LifecycleEvent::Close { version, profile }
        } else {
            LifecycleEvent::Open { version, profile }
        };
        let how = if closed { "closed to it" } else { "open to it again" };
        let why =
            format!("the profile {} is {how}, by {}: {}", profile.name(), operation.by, operation.reason);
        let mut note = Note::because(why);
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
        closed: closed_now.clone(),
        by: operation.by.clone(),
        reason: operation.reason.clone(),
    });
    let named: Vec<&str> = closed_now.iter().map(|profile| profile.name()).collect();
    let named = if named.is_empty() { "none".to_owned() } else { named.join(", ") };
    Ok(Reply::Accepted { text: format!("profiles closed to {id}: {named}"), version: Some(id) })
}
