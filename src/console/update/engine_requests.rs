//! The console's queries to the engine: on entering a view, and again after a change.

use super::{health, operations, overlays, show_message, undo};
use crate::effect::{Effect, EngineQuery};
use crate::model::{
    ConsoleModel, EngineState, Overlay, PendingRequest, PendingStop, RequestSubject, UndoChange,
};
use holdpoint_text::Hint as _;
use holdpoint_wording::console::engine_requests as wording;

/// The most requests without an answer; far below the engine's own limit.
const PENDING_MAX: usize = 32;

/// The shortest interval between repeats of a failed stop, ms.
const STOP_RETRY_MS: u64 = 1_000;

/// The subject of a demonstration candidate in a request.
pub(super) const DEMO: &str = wording::SUBMIT_THE_NEXT;

/// A new request's id; absent if too many requests wait.
pub(super) fn request(model: &mut ConsoleModel, about: RequestSubject, what: String) -> Option<String> {
    // A confirmed operation may be a stop: its sender decides about the destination.
    let is_confirmed = matches!(about, RequestSubject::Operation | RequestSubject::Decision);
    if let Some(absence) = model.absence().filter(|_| !is_confirmed) {
        show_message(model, absence.problem().sentence(), true);
        return None;
    }
    if model.requests.pending.len() >= PENDING_MAX {
        show_message(model, wording::too_many_wait(PENDING_MAX), true);
        return None;
    }
    Some(add_pending(model, about, what))
}

fn add_pending(model: &mut ConsoleModel, about: RequestSubject, what: String) -> String {
    let id = format!("console-{}", model.requests.next_request);
    model.requests.next_request += 1;
    if !what.is_empty() {
        model.key_log.note_request(&id, &what);
    }
    model.requests.pending.insert(id.clone(), PendingRequest { about, what, undo: None, is_sent: false });
    id
}

/// Stops the cell, even if many requests wait, and without a question.
pub(super) fn stop(model: &mut ConsoleModel) -> Vec<Effect> {
    // Without an operator the name is empty: the record names user and process beside it.
    let by = model.session.operator.as_ref().map_or_else(String::new, |operator| operator.name.clone());
    let text = match model.absence() {
        None => wording::STOP_REQUESTED,
        Some(_) => wording::STOP_ASKED_ELSEWHERE,
    };
    show_message(model, text, true);
    request_stop(model, by)
}

fn request_stop(model: &mut ConsoleModel, by: String) -> Vec<Effect> {
    let question = EngineQuery::Stop { by: by.clone() };
    let id = add_pending(model, question.about(), wording::STOP_THE_CELL.to_owned());
    let now_ms = model.now_ms;
    let since_ms = model.engine_data.pending_stop.as_ref().map_or(now_ms, |stop| stop.since_ms);
    model.engine_data.pending_stop =
        Some(PendingStop { id: id.clone(), by, requested_ms: now_ms, since_ms, why: None });
    vec![Effect::Ask { id, question }]
}

/// Sends a stop again to an engine whose cell is running, if the stop failed and was not withdrawn.
pub(super) fn resend_stop(model: &mut ConsoleModel) -> Vec<Effect> {
    if model.engine_data.engine != EngineState::Running {
        return Vec::new();
    }
    let now_ms = model.now_ms;
    // A stop that fails at once is not sent again with each camera frame.
    let is_due =
        |stop: &&PendingStop| stop.why.is_some() && now_ms.saturating_sub(stop.requested_ms) >= STOP_RETRY_MS;
    let Some(by) = model.engine_data.pending_stop.as_ref().filter(is_due).map(|stop| stop.by.clone()) else {
        return Vec::new();
    };
    show_message(model, wording::STOP_SENT_AGAIN, true);
    request_stop(model, by)
}

/// Requests the text of an open approval request for the operator at this console.
pub(super) fn request_approval_text(model: &mut ConsoleModel) -> Vec<Effect> {
    let operator = model.session.operator.as_ref();
    let Some(who) = operator.map(|operator| operator.name.clone()) else { return Vec::new() };
    let Some(Overlay::Approval(prompt)) = &model.input.overlay else { return Vec::new() };
    let is_pending = |id: &str| model.requests.pending.contains_key(id);
    if model.absence().is_some() || model.settings.read_only || !prompt.needs_delivery(&who, is_pending) {
        return Vec::new();
    }
    let (version, purpose) = (prompt.seen.version.clone(), prompt.seen.purpose);
    let question = EngineQuery::ApprovalRequest { version, purpose, who: who.clone() };
    let Some(id) = request(model, question.about(), String::new()) else { return Vec::new() };
    if let Some(Overlay::Approval(prompt)) = &mut model.input.overlay {
        prompt.mark_requested(who, id.clone());
    }
    vec![Effect::Ask { id, question }]
}

/// Notes what a request does to the actions that can be undone.
pub(super) fn note_undo(model: &mut ConsoleModel, id: &str, change: Option<UndoChange>) {
    if let Some(pending) = model.requests.pending.get_mut(id) {
        pending.undo = change;
    }
}

/// Sends a query, which decides nothing.
pub(super) fn send_query(model: &mut ConsoleModel, what: String, question: EngineQuery) -> Vec<Effect> {
    let Some(id) = request(model, question.about(), what) else { return Vec::new() };
    note_undo(model, &id, undo::change_of_query(&question));
    vec![Effect::Ask { id, question }]
}

/// Requests the view's data, even without a change.
pub(super) fn refresh_now(model: &mut ConsoleModel) -> Vec<Effect> {
    if model.engine_data.engine != EngineState::Running {
        return Vec::new();
    }
    let Some(question) = view_query(model) else { return Vec::new() };
    model.requests.changes_at_query.insert(question.about(), model.requests.changes);
    send_query(model, String::new(), question)
}

/// Repeats queries after a change, one of a kind at a time.
pub(super) fn refresh(model: &mut ConsoleModel) -> Vec<Effect> {
    let Some(about) = view_query(model).as_ref().map(EngineQuery::about) else { return Vec::new() };
    let unchanged = model.requests.changes_at_query.get(&about) == Some(&model.requests.changes);
    let is_fresh =
        if about == RequestSubject::Health { health::is_fresh(model, unchanged) } else { unchanged };
    let is_pending = model.requests.pending.values().any(|pending| pending.about == about);
    if is_fresh || is_pending { Vec::new() } else { refresh_now(model) }
}

fn view_query(model: &ConsoleModel) -> Option<EngineQuery> {
    model.view_state.view.behavior().query(model)
}

/// Requests a check of the whole audit chain.
pub(super) fn verify(model: &mut ConsoleModel) -> Vec<Effect> {
    show_message(model, wording::CHECKING_THE_CHAIN, false);
    send_query(model, wording::CHECK_THE_CHAIN.to_owned(), EngineQuery::Verify)
}

/// Submits a candidate: a folder, or the next demonstration candidate. If it needs a signature, a form confirms it
/// first.
pub(super) fn register(model: &mut ConsoleModel, folder: Option<String>) -> Vec<Effect> {
    if overlays::is_signed(&model.engine_data) {
        return operations::register(model, folder);
    }
    submit(model, folder)
}

/// Submits a candidate, with the passphrase to sign it.
pub(super) fn submit(model: &mut ConsoleModel, folder: Option<String>) -> Vec<Effect> {
    let what = folder.as_deref().map_or_else(|| DEMO.to_owned(), |folder| format!("submit {folder:?}"));
    let Some(id) = request(model, RequestSubject::Registration, what) else { return Vec::new() };
    let passphrase = overlays::leave_form(model, &id);
    vec![Effect::Register { id, folder, passphrase }]
}
