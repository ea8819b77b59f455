//! Undo: sends the reverse of the last action of this console that has one, or refuses aloud.
//!
//! The reverse is an ordinary operation: it opens the same form, and the engine checks it again. An acknowledgment has no
//! reverse. It records that a person has seen the alarm, which stays true; an alarm that has returned to normal is closed by it.

use super::{engine_requests, operations, refuse, selection, show_message};
use crate::action::Action;
use crate::effect::{Effect, EngineQuery};
use crate::model::{ConsoleModel, ItemKey, UndoChange, UndoableAction};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::Command;
use holdpoint_wording::console::undo as wording;

/// What an accepted command does to the actions that can be undone.
pub(super) fn change(model: &ConsoleModel, command: &Command) -> Option<UndoChange> {
    match command {
        Command::Pause(operation) => Some(UndoChange::Adds(UndoableAction::Hold(operation.version.clone()))),
        Command::Resume(operation) => {
            Some(UndoChange::Removes(UndoableAction::Hold(operation.version.clone())))
        }
        Command::ShelveAlarm { alarm, .. } => Some(UndoChange::Adds(UndoableAction::Shelve(alarm.clone()))),
        Command::Goal { goal, .. } => {
            let now = goal_now(model);
            Some(match model.undo.last() {
                Some((last @ UndoableAction::Goal { set, before }, _)) if set == now && before == goal => {
                    UndoChange::Removes(last.clone())
                }
                _ => UndoChange::Adds(UndoableAction::Goal { set: goal.clone(), before: now.to_owned() }),
            })
        }
        _ => None,
    }
}

/// As [`change`], for a query.
pub(super) fn change_of_query(question: &EngineQuery) -> Option<UndoChange> {
    match question {
        EngineQuery::Acknowledge { alarm, .. } => {
            Some(UndoChange::Adds(UndoableAction::Acknowledge(alarm.clone())))
        }
        EngineQuery::Unshelve { alarm, .. } => {
            Some(UndoChange::Removes(UndoableAction::Shelve(alarm.clone())))
        }
        _ => None,
    }
}

/// The engine accepted the request of a change.
pub(super) fn accepted(model: &mut ConsoleModel, change: UndoChange) {
    match change {
        UndoChange::Adds(action) => model.undo.add(action, model.now_ms),
        UndoChange::Removes(action) => model.undo.remove(&action),
    }
}

/// Undoes the last action, or says why not. A refused one is forgotten, so that the next key is about the one before it.
pub(super) fn undo(model: &mut ConsoleModel) -> Vec<Effect> {
    let marks = &model.view_state;
    model.undo.retain_marks(|item| match item {
        ItemKey::Alarm(name) => marks.marked.contains(name),
        ItemKey::Version(id) => marks.marked_versions.contains(id),
        _ => false,
    });
    let is_open = |change: &Option<UndoChange>| matches!(change, Some(UndoChange::Adds(_)));
    if let Some(pending) = model.requests.pending.values().find(|pending| is_open(&pending.undo)) {
        let why = wording::not_answered_yet(&pending.what);
        return refuse(model, &why);
    }
    let Some((action, done_ms)) = model.undo.last().cloned() else { return refuse(model, wording::NOTHING) };
    if let UndoableAction::Mark(item) = &action {
        unmark(model, item);
        model.undo.remove(&action);
        return Vec::new();
    }
    // The comparison needs a snapshot from after the action.
    if model.engine_data.snapshot_ms <= done_ms {
        return not_undone(model, &action, wording::RESULT_NOT_SHOWN);
    }
    let undone = match &action {
        UndoableAction::Shelve(alarm) => unshelve(model, alarm),
        UndoableAction::Hold(id) => resume(model, id),
        UndoableAction::Goal { set, before } => previous_goal(model, set, before),
        UndoableAction::Acknowledge(alarm) => Err(wording::acknowledgment_has_no_reverse(alarm)),
        UndoableAction::Mark(_) => Ok(Vec::new()),
    };
    undone.unwrap_or_else(|why| {
        model.undo.remove(&action);
        not_undone(model, &action, &why)
    })
}

/// Refuses aloud. A form may be expected, and its reason be typed already: letters go nowhere for a moment.
fn not_undone(model: &mut ConsoleModel, action: &UndoableAction, why: &str) -> Vec<Effect> {
    if matches!(action, UndoableAction::Hold(_) | UndoableAction::Goal { .. }) {
        super::swallow_text(model);
    }
    refuse(model, &wording::not_undone(why))
}

fn unmark(model: &mut ConsoleModel, item: &ItemKey) {
    let name = match item {
        ItemKey::Alarm(name) => {
            model.view_state.marked.remove(name);
            name.clone()
        }
        ItemKey::Version(id) => {
            model.view_state.marked_versions.remove(id);
            id.to_string()
        }
        _ => return,
    };
    show_message(model, wording::not_marked_any_more(&name), false);
}

fn unshelve(model: &mut ConsoleModel, alarm: &str) -> Result<Vec<Effect>, String> {
    let by = model.session.operator.as_ref().map_or_else(|| "console".to_owned(), |who| who.name.clone());
    let view = operations::alarm_now(model, alarm).map_err(|why| format!("{alarm}: {why}"))?;
    selection::takes(view, Action::Unshelve).map_err(|why| format!("{alarm}: {why}"))?;
    if let Some((other, _, _)) = view.shelf.as_ref().filter(|(shelved_by, _, _)| *shelved_by != by) {
        return Err(wording::shelved_by_another(alarm, other));
    }
    let question = EngineQuery::Unshelve { alarm: alarm.to_owned(), by };
    let effects = engine_requests::send_query(model, format!("unshelve {alarm}"), question);
    if !effects.is_empty() {
        show_message(model, wording::unshelve_asked(alarm), false);
    }
    Ok(effects)
}

fn resume(model: &mut ConsoleModel, id: &CapabilityId) -> Result<Vec<Effect>, String> {
    let (intent, lines) = operations::intent(model, Action::Resume, id)?;
    Ok(operations::open(model, intent, lines))
}

fn previous_goal(model: &mut ConsoleModel, set: &str, before: &str) -> Result<Vec<Effect>, String> {
    let now = goal_now(model);
    if now != set {
        return Err(wording::goal_has_changed(now, set, before));
    }
    Ok(operations::goal(model, before.to_owned()))
}

fn goal_now(model: &ConsoleModel) -> &str {
    model.engine_data.snapshot.as_ref().map_or("", |snapshot| snapshot.live.goal.as_str())
}
