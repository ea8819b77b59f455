//! Marked alarms and versions, so that one key takes all of them, and whether an alarm accepts an action.
//!
//! An operation that takes authority away applies to several at once, after one question that names each. One that
//! gives authority never does.

use super::{engine_requests, navigation, operations, refuse, show_message};
use crate::action::Action;
use crate::effect::{Effect, EngineQuery};
use crate::form::Intent;
use crate::model::{ConsoleModel, HISTORY_PANE, ItemKey, UndoableAction, View};
use crate::rows::AlarmItem;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::snapshot::AlarmView;
use holdpoint_wording::console::selection as wording;

/// The most versions that one question names.
const TOGETHER_MAX: usize = 20;

/// Lines of a screen for a question besides the versions it names.
const QUESTION_ROWS: usize = 9;

/// The item under the cursor, if it can be marked.
pub(super) fn markable(model: &ConsoleModel) -> Option<ItemKey> {
    let item = model.item_key(model.row())?;
    model.view_state.view.behavior().can_mark(&item).then_some(item)
}

/// Marks or unmarks the item under the cursor, and moves to the next.
pub(super) fn mark(model: &mut ConsoleModel) -> Vec<Effect> {
    let at = model.row();
    match markable(model) {
        Some(ItemKey::Alarm(name)) => {
            let action = UndoableAction::Mark(ItemKey::Alarm(name.clone()));
            if model.view_state.marked.remove(&name) {
                model.undo.remove(&action);
            } else {
                model.view_state.marked.insert(name);
                model.undo.add(action, model.now_ms);
            }
        }
        Some(ItemKey::Version(id)) => {
            let action = UndoableAction::Mark(ItemKey::Version(id.clone()));
            if model.view_state.marked_versions.remove(&id) {
                model.undo.remove(&action);
            } else {
                model.view_state.marked_versions.insert(id);
                model.undo.add(action, model.now_ms);
            }
            announce_selection(model);
        }
        _ => return refuse(model, wording::NOTHING_TO_MARK),
    }
    let last = model.row_count().saturating_sub(1);
    navigation::set_row(model, (at + 1).min(last));
    Vec::new()
}

/// The number of marks, and the keys that use them.
fn announce_selection(model: &mut ConsoleModel) {
    let key = |action| model.keymap.key(action);
    let text = match model.view_state.marked_versions.len() {
        0 => wording::NOTHING_MARKED.to_owned(),
        count => wording::marked(
            count,
            &key(Action::Refuse),
            &key(Action::Pause),
            &key(Action::Copy),
            &key(Action::Back),
        ),
    };
    show_message(model, text, false);
}

/// Removes all marks of the list with the keys. Returns whether there were any.
pub(super) fn clear(model: &mut ConsoleModel) -> bool {
    if model.view_state.lists_versions() {
        return !std::mem::take(&mut model.view_state.marked_versions).is_empty();
    }
    model.view_state.view == View::Alarms && !std::mem::take(&mut model.view_state.marked).is_empty()
}

/// The marked versions that are visible; unknown ones lose their marks.
pub(super) fn versions(model: &ConsoleModel) -> Vec<CapabilityId> {
    let marked = model.view_state.lists_versions().then_some(&model.view_state.marked_versions);
    marked.into_iter().flatten().filter(|id| model.version_state(id).is_some()).cloned().collect()
}

/// The names of the marked versions, else of the one under the cursor.
pub(crate) fn copied(model: &ConsoleModel) -> Option<String> {
    let marked: Vec<String> = versions(model).iter().map(ToString::to_string).collect();
    if marked.is_empty() {
        return model.version_here().map(|version| version.to_string());
    }
    Some(marked.join("\n"))
}

/// Applies an action to every marked version. `None` if none is marked, or if the action stops a version: that one
/// applies to the version under the cursor, whatever is marked.
pub(super) fn on_versions(model: &mut ConsoleModel, action: Action) -> Option<Vec<Effect>> {
    let marked = versions(model);
    if marked.is_empty() {
        return None;
    }
    match action {
        Action::Refuse | Action::Pause => Some(together(model, action, &marked)),
        Action::Demote | Action::Rollback | Action::Restrict => None,
        _ => {
            let (count, key) = (marked.len(), model.keymap.key(Action::Back));
            let why = wording::acts_on_one(count, &key);
            Some(refuse(model, &why))
        }
    }
}

/// One question about all of them.
fn together(model: &mut ConsoleModel, action: Action, marked: &[CapabilityId]) -> Vec<Effect> {
    let room = usize::from(model.size.1).saturating_sub(QUESTION_ROWS).min(TOGETHER_MAX);
    if marked.len() > room {
        let why = wording::too_many(marked.len(), room);
        return refuse(model, &why);
    }
    let mut each = Vec::new();
    for id in marked {
        match operations::intent(model, action, id) {
            Ok((intent, _)) => each.push(intent),
            Err(why) => return refuse(model, &wording::take_its_mark_away(&why)),
        }
    }
    let intent = match <[Intent; 1]>::try_from(each) {
        Ok([one]) => one,
        Err(each) => Intent::Several(each),
    };
    match operations::now(model, &intent) {
        Ok(lines) => operations::open(model, intent, lines),
        Err(why) => refuse(model, &why),
    }
}

/// The state of each of several versions, then the consequences for all of them.
pub(super) fn lines(model: &ConsoleModel, each: &[Intent]) -> Result<Vec<String>, String> {
    let (mut stand, mut become_of): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for intent in each {
        let mut lines = operations::now(model, intent)?.into_iter();
        stand.extend(lines.next());
        for line in lines {
            if !become_of.contains(&line) {
                become_of.push(line);
            }
        }
    }
    stand.extend(become_of);
    Ok(stand)
}

/// The subject of the group under the cursor; absent on an alarm by itself.
pub(crate) fn group_here(model: &ConsoleModel) -> Option<String> {
    if model.view_state.view != View::Alarms || model.view_state.pane() == HISTORY_PANE {
        return None;
    }
    match model.alarm_rows().get(model.row())? {
        AlarmItem::Group { first, .. } => Some(first.subject.clone()),
        AlarmItem::Alarm(_) => None,
    }
}

/// Marks all alarms of the group under the cursor, so that they are acknowledged as one. Returns whether it is a group.
pub(super) fn mark_group(model: &mut ConsoleModel) -> bool {
    let names: Vec<String> = match (model.alarm_rows().get(model.row()), &model.engine_data.snapshot) {
        (Some(AlarmItem::Group { first, .. }), Some(now)) => {
            let is_member = |alarm: &&AlarmView| {
                (&alarm.subject, alarm.priority, alarm.state) == (&first.subject, first.priority, first.state)
            };
            now.alarms.iter().filter(is_member).map(|alarm| alarm.alarm.clone()).collect()
        }
        _ => return false,
    };
    model.view_state.marked.extend(names);
    true
}

/// Acknowledges every marked alarm that accepts it; the others keep their marks.
pub(super) fn acknowledge(model: &mut ConsoleModel, by: &str) -> Vec<Effect> {
    let snapshot = model.engine_data.snapshot.clone();
    let alarms = snapshot.as_ref().map_or(&[][..], |now| &now.alarms);
    // An alarm that is gone loses its mark.
    model.view_state.marked.retain(|name| alarms.iter().any(|alarm| alarm.alarm == *name));
    let takes = |alarm: &&AlarmView| takes(alarm, Action::Acknowledge).is_ok();
    let marked: Vec<&AlarmView> =
        alarms.iter().filter(|alarm| model.view_state.marked.contains(&alarm.alarm)).filter(takes).collect();
    let mut effects = Vec::new();
    for alarm in &marked {
        let question = EngineQuery::Acknowledge { alarm: alarm.alarm.clone(), by: by.to_owned() };
        let queries = engine_requests::send_query(model, format!("acknowledge {}", alarm.alarm), question);
        if queries.is_empty() {
            // Too many requests wait: the others keep their marks.
            break;
        }
        model.view_state.marked.remove(&alarm.alarm);
        effects.extend(queries);
    }
    if marked.is_empty() {
        model.view_state.marked.clear();
        return refuse(model, wording::ALL_ACKNOWLEDGED);
    }
    effects
}

/// Whether an alarm accepts the action in its state, or why not.
pub(super) fn takes(alarm: &AlarmView, action: Action) -> Result<(), String> {
    match action {
        Action::Acknowledge if alarm.acknowledged_by.is_some() => {
            Err(wording::ALREADY_ACKNOWLEDGED.to_owned())
        }
        Action::Acknowledge => Ok(()),
        Action::Unshelve if alarm.shelf.is_none() => Err(wording::NOT_SHELVED.to_owned()),
        Action::Unshelve => Ok(()),
        _ => operations::alarm_lines(alarm, action).map(drop),
    }
}
