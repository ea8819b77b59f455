//! Handles the engine's updates and answers.

use std::sync::Arc;

use super::{cell_restart, engine_requests, operations, overlays, show_message, undo, why};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::pipeline_idle_reason;
use crate::model::{
    ConsoleModel, EngineLink, EngineState, EventLogLine, LOG_MAX, Overlay, RequestSubject, SharedLine,
    StageProgress, View,
};
use holdpoint_governance::alarms::Priority;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::approval_document::ApprovalDocument;
use holdpoint_protocol::command::{Refusal, Reply, StopPersistence};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_service::control_socket::UnverifiedOrigin;
use holdpoint_service::engine_handle::EngineEndError;
use holdpoint_text::{Hint, Problem, Untrusted};
use holdpoint_wording::console::engine_updates as wording;
use holdpoint_wording::event as event_text;

pub(super) fn started(model: &mut ConsoleModel) -> Vec<Effect> {
    model.engine_data.engine = EngineState::Running;
    let mut effects = vec![Effect::ReadIdentities];
    let everything = EngineQuery::Registry { group: VersionGroup::All, text: String::new() };
    effects.extend(engine_requests::send_query(model, String::new(), everything));
    effects
}

/// The engine is gone, or never came up.
pub(super) fn ended(model: &mut ConsoleModel, how: Result<(), EngineEndError>) -> Vec<Effect> {
    if let Err(why) = &how {
        let came_up = model.engine_data.engine == EngineState::Running;
        let what = match (came_up, why.orderly) {
            (true, true) => wording::ENGINE_GONE,
            (true, false) => wording::ENGINE_ENDED,
            (false, _) => wording::ENGINE_DID_NOT_COME_UP,
        };
        show_message(model, format!("{what}: {why}"), !why.orderly);
    }
    model.engine_data.console_number = None;
    model.engine_data.engine = EngineState::Ended(how);
    operations::dismiss_all_forms(model, wording::ENGINE_GONE);
    Vec::new()
}

/// Attaches to an engine: view and cursor stay, requests to another engine get no answer any more, and the new event
/// log continues below the old one.
pub(super) fn attached(
    model: &mut ConsoleModel,
    process: Option<i32>,
    unverified: Option<UnverifiedOrigin>,
) -> Vec<Effect> {
    let came_back = matches!(model.engine_data.engine, EngineState::Ended(_));
    let is_same = process.is_some() && model.engine_data.process == process;
    if let Some(last) = model.engine_data.events.back().filter(|_| !is_same).cloned() {
        let text = wording::ANOTHER_ENGINE_FOLLOWS.to_owned();
        model.engine_data.events.push_back(EventLogLine {
            seq: last.seq.saturating_add(1),
            text,
            shared: None,
            ..last
        });
        model.engine_data.event_base = last.seq.saturating_add(2);
    }
    model.engine_data.process = process;
    model.engine_data.unverified = unverified;
    model.engine_data.link = EngineLink::Attached;
    model.engine_data.engine = EngineState::Starting;
    model.engine_data.reconnect = None;
    if came_back {
        // The end of the other engine says nothing about this one.
        model.engine_data.started_here = false;
        model.engine_data.attached_ms = Some(model.now_ms);
        let stop = model.engine_data.pending_stop.as_ref().map(|stop| stop.id.clone());
        let dropped = std::mem::take(&mut model.requests.pending).into_iter();
        // The stop has a warning of its own, and the console's own queries are repeated.
        let dropped = dropped.filter(|(id, one)| !one.what.is_empty() && stop.as_ref() != Some(id));
        let dropped: Vec<String> = dropped.map(|(_, one)| one.what).collect();
        model.requests.alarms_changed = 0;
        model.requests.changes_at_query.clear();
        model.key_log.lost(wording::ENGINE_WAS_LOST);
        let (lost, now) = if is_same {
            let lost = wording::CONNECTION_LOST;
            (lost, wording::ATTACHED_AGAIN)
        } else {
            let lost = wording::ASKED_ENGINE_GONE;
            (lost, wording::ATTACHED_TO_ANOTHER)
        };
        overlays::unanswered(model, &wording::request_in_doubt(lost));
        if let Some(stop) = &mut model.engine_data.pending_stop {
            stop.why = Some(lost.to_owned());
        }
        if dropped.is_empty() {
            show_message(model, now, false);
        } else {
            let text = format!("{}: {}", dropped.join(", "), wording::request_in_doubt(lost));
            show_message(model, text, true);
        }
    }
    Vec::new()
}

/// Takes in events from before this console was attached.
pub(super) fn past(model: &mut ConsoleModel, events: &[Event], earlier: u64) -> Vec<Effect> {
    let base = model.engine_data.event_base;
    let known = model.engine_data.events.back().map(|line| line.seq);
    if known.is_none_or(|known| known < base)
        && let Some(first) = events.first()
    {
        let text = if earlier == 0 {
            wording::ENGINE_BEGAN_HERE.to_owned()
        } else {
            wording::log_begins_here(earlier)
        };
        let seq = base.saturating_add(first.seq);
        model.engine_data.events.push_back(EventLogLine { seq, at_ms: first.at_ms, text, shared: None });
    }
    let is_new = |event: &&Event| known.is_none_or(|known| event.seq.saturating_add(base) > known);
    for event in events.iter().filter(is_new) {
        append_event_line(model, event);
    }
    Vec::new()
}

/// Adds a line to the event log.
fn append_event_line(model: &mut ConsoleModel, event: &Event) {
    let text = event_text::sentence(event, event_text::LINE_WIDTH_MAX).into_string();
    let seq = event.seq.saturating_add(model.engine_data.event_base);
    let events = &mut model.engine_data.events;
    let mut shared = SharedLine::of(&event.kind);
    // A sequence and its tasks alternate: each joins its own line among the newest shared ones.
    let newest = events.iter().enumerate().rev();
    let mut before = newest.map_while(|(at, line)| line.shared.as_ref().map(|shared| (at, shared)));
    let joined = shared
        .as_ref()
        .and_then(|this| before.find_map(|(at, others)| others.with(this).map(|all| (at, all))));
    if let Some((at, all)) = joined {
        events.remove(at);
        shared = Some(all);
    }
    events.push_back(EventLogLine { seq, at_ms: event.at_ms, text, shared });
    if events.len() > LOG_MAX {
        events.pop_front();
    }
}

pub(super) fn events(model: &mut ConsoleModel, events: Vec<Event>) -> Vec<Effect> {
    for event in events {
        // Progress is frequent, and the snapshot contains it.
        if matches!(event.kind, EventKind::Progress { .. }) {
            continue;
        }
        if let EventKind::CellStopped { by, caller, .. } = &event.kind {
            cell_restart::stopped_again(model, (by, caller), event.at_ms);
        }
        if let (
            EventKind::ApprovalReceived { version, by, decision, have, needed, .. },
            Some(Overlay::Approval(prompt)),
        ) = (&event.kind, &mut model.input.overlay)
        {
            prompt.note_answer(version, by, *decision, have >= needed);
        }
        if !matches!(event.kind, EventKind::Sequence { .. }) {
            model.requests.changes += 1;
        }
        if let EventKind::CellReleased { by, .. } = &event.kind {
            released(model, by);
        }
        append_event_line(model, &event);
    }
    Vec::new()
}

/// The cell is running again, from whatever source: no text may still say that it is stopped.
fn released(model: &mut ConsoleModel, by: &str) {
    show_message(model, wording::cell_runs_again(&Untrusted::new(by.to_owned()).line().into_string()), false);
    if let Some(frame) = &mut model.engine_data.frame {
        // This is the last frame of the stop, and the next one may take long.
        Arc::make_mut(frame).stopped = false;
    }
}

/// Takes in a new snapshot and compares an open approval request with it at once.
pub(super) fn snapshot(model: &mut ConsoleModel, snapshot: Arc<Snapshot>) -> Vec<Effect> {
    let critical =
        |snapshot: &Snapshot| snapshot.alarm_summary.highest_unacknowledged == Some(Priority::Critical);
    let calls = critical(&snapshot) && !model.engine_data.snapshot.as_deref().is_some_and(critical);
    if let Some(Overlay::Approval(prompt)) = &mut model.input.overlay {
        prompt.look(&snapshot, model.now_ms);
    }
    if snapshot.stopped.is_some() {
        // A stopped cell confirms the stop, whatever its source.
        model.engine_data.pending_stop = None;
    }
    headway(model, &snapshot);
    model.engine_data.snapshot_ms = model.now_ms;
    model.engine_data.snapshot = Some(snapshot);
    operations::follow(model);
    let mut effects = engine_requests::resend_stop(model);
    if calls {
        effects.push(Effect::Bell);
    }
    effects
}

/// Notes the progress of each running stage; entries of other versions are dropped.
fn headway(model: &mut ConsoleModel, now: &Snapshot) {
    let is_running = |id: &CapabilityId| {
        now.candidates.iter().any(|candidate| candidate.version == *id && candidate.progress.is_some())
    };
    model.engine_data.stage_progress.retain(|id, _| is_running(id));
    let all_stand = pipeline_idle_reason(now).is_some();
    for candidate in &now.candidates {
        let Some(progress) = &candidate.progress else { continue };
        match model.engine_data.stage_progress.get_mut(&candidate.version) {
            Some(known) if all_stand || candidate.flags.paused => known.rest(progress, now.at_ms),
            Some(known) => known.see(progress, now.at_ms),
            None => {
                model
                    .engine_data
                    .stage_progress
                    .insert(candidate.version.clone(), StageProgress::of(progress, now.at_ms));
            }
        }
    }
}

pub(super) fn answer(model: &mut ConsoleModel, id: &str, reply: Reply) -> Vec<Effect> {
    overlays::answered(model, id);
    let stays_in_sight = stop_answered(model, id, &reply);
    let pending = model.requests.pending.remove(id);
    let about = pending.as_ref().map(|pending| pending.about);
    let (what, change) = pending.map(|pending| (pending.what, pending.undo)).unwrap_or_default();
    if let (Reply::Accepted { .. }, Some(change)) = (&reply, change) {
        undo::accepted(model, change);
    }
    if let Some((text, refused)) = reply_text(&reply) {
        model.key_log.answered(id, &text, refused);
    }
    let others = model.requests.alarms_changed;
    if about == Some(RequestSubject::Alarm) {
        let waits = model.requests.pending.values().any(|pending| pending.about == RequestSubject::Alarm);
        let changed = usize::from(matches!(reply, Reply::Accepted { .. }));
        model.requests.alarms_changed = if waits { others + changed } else { 0 };
    }
    match reply {
        _ if stays_in_sight => Vec::new(),
        Reply::Accepted { text, .. } if about == Some(RequestSubject::Alarm) => {
            show_message(model, wording::alarm_changed(&text, others), false);
            Vec::new()
        }
        Reply::Accepted { text, .. } | Reply::Stopped { text, kept: StopPersistence::OnRecord } => {
            show_message(model, text, false);
            Vec::new()
        }
        // The stop is in force, but the operator must know what a sudden end would lose.
        Reply::Stopped { text, kept: StopPersistence::InMark | StopPersistence::InMemory } => {
            show_message(model, text, true);
            Vec::new()
        }
        // Both consoles have the same list, so the next entry is as good.
        Reply::Refused { code: Refusal::Exists, text, .. }
            if what == engine_requests::DEMO && !overlays::is_signed(&model.engine_data) =>
        {
            let effects = engine_requests::submit(model, None);
            show_message(model, wording::next_is_submitted(&text), false);
            effects
        }
        Reply::Refused { code: Refusal::Exists, text, .. } if what == engine_requests::DEMO => {
            show_message(model, wording::next_must_be_asked_for(&text), true);
            Vec::new()
        }
        // Others ask as well: a query without a key press is repeated silently.
        Reply::Refused { code: Refusal::NotNow, .. }
            if matches!(about, Some(RequestSubject::Health | RequestSubject::AlarmHistory)) =>
        {
            about.map(|about| model.requests.changes_at_query.remove(&about));
            Vec::new()
        }
        Reply::Refused { text, hint, .. } if about == Some(RequestSubject::Question) => {
            receive_request(model, id, Err(Problem::from((text, hint)).sentence()));
            Vec::new()
        }
        Reply::Question { question } => {
            receive_request(model, id, Ok(question));
            Vec::new()
        }
        Reply::Refused { text, hint, .. } => {
            let lead = if what.is_empty() { what } else { format!("{what}: ") };
            show_message(model, format!("{lead}{}", Problem::from((text, hint)).sentence()), true);
            Vec::new()
        }
        // The engine publishes snapshots by itself, so a requested one is not needed.
        Reply::Snapshot { snapshot: latest } => snapshot(model, Arc::from(latest)),
        Reply::Detail { detail } => {
            model.engine_data.detail = Some(Arc::from(detail));
            Vec::new()
        }
        Reply::Film { film } => {
            why::film(model, film);
            Vec::new()
        }
        Reply::Registry { page } => {
            model.engine_data.registry.take(page);
            Vec::new()
        }
        Reply::Audit { page } => {
            model.engine_data.audit = Arc::new(page);
            Vec::new()
        }
        Reply::Health { series } => {
            if about == Some(RequestSubject::AlarmHistory) {
                model.engine_data.alarm_history = Some(Arc::from(series));
            } else {
                model.engine_data.health = Some((Arc::from(series), model.now_ms));
            }
            Vec::new()
        }
        Reply::Verified { verified } => {
            show_message(model, verified.text.clone(), !verified.holds);
            model.engine_data.verified = Some(verified);
            if model.view_state.view == View::Audit {
                engine_requests::refresh_now(model)
            } else {
                Vec::new()
            }
        }
        // This console did not ask for it.
        _ => Vec::new(),
    }
}

/// The sentence of an answer, and whether it refuses or warns; absent for data.
fn reply_text(reply: &Reply) -> Option<(String, bool)> {
    match reply {
        Reply::Accepted { text, .. } => Some((text.clone(), false)),
        Reply::Stopped { text, kept } => Some((text.clone(), *kept != StopPersistence::OnRecord)),
        Reply::Refused { text, hint, .. } => {
            Some((Problem::from((text.clone(), hint.clone())).sentence(), true))
        }
        Reply::Verified { verified } => Some((verified.text.clone(), !verified.holds)),
        _ => None,
    }
}

/// Handles the text of an open approval request, or why there is none; answers for another one are ignored.
fn receive_request(model: &mut ConsoleModel, id: &str, answer: Result<Box<ApprovalDocument>, String>) {
    if let Some(Overlay::Approval(prompt)) = &mut model.input.overlay {
        prompt.take(id, answer);
    }
}

/// Handles the answer to a stop. An unanswered stop is repeated until it is confirmed. Returns whether it stays
/// visible, so that no other message is needed.
fn stop_answered(model: &mut ConsoleModel, id: &str, reply: &Reply) -> bool {
    let Some(stop) = model.engine_data.pending_stop.as_mut().filter(|stop| stop.id == id) else {
        return false;
    };
    if let Reply::Refused { code: Refusal::NoAnswer, text, hint } = reply {
        stop.why = Some(Problem::from((text.clone(), hint.clone())).sentence());
        model.notice = None;
        return true;
    }
    model.engine_data.pending_stop = None;
    false
}
