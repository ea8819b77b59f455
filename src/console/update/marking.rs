//! Alarms and versions that are marked, so that one key takes all of them; and whether an alarm takes an answer as it
//! stands.
//!
//! What takes authority away takes several at once, after one question that names each. What gives any never does.

use super::{asking, moving, operating, refuse, tell};
use crate::action::Action;
use crate::effect::{Effect, Question};
use crate::form::Intent;
use crate::model::{ItemKey, Model, View};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::snapshot::AlarmView;

/// The most versions that one question names.
const TOGETHER_MAX: usize = 20;

/// Lines of a screen that a question takes beside the versions it names.
const QUESTION_ROWS: usize = 9;

/// What lies under the cursor, if it can be marked.
pub(super) fn markable(model: &Model) -> Option<ItemKey> {
    let item = model.item_key(model.row())?;
    match (&item, model.place.view) {
        (ItemKey::Version(_), View::Overview | View::Registry) | (ItemKey::Alarm(_), View::Alarms) => {
            Some(item)
        }
        _ => None,
    }
}

/// Marks what lies under the cursor, or takes its mark away, and goes on to the next.
pub(super) fn mark(model: &mut Model) -> Vec<Effect> {
    let at = model.row();
    match markable(model) {
        Some(ItemKey::Alarm(name)) => {
            if !model.place.marked.remove(&name) {
                model.place.marked.insert(name);
            }
        }
        Some(ItemKey::Version(id)) => {
            if !model.place.marked_versions.remove(&id) {
                model.place.marked_versions.insert(id);
            }
            tell_marked(model);
        }
        _ => return refuse(model, "there is nothing under the cursor that can be marked"),
    }
    let last = model.row_count().saturating_sub(1);
    moving::set_row(model, (at + 1).min(last));
    Vec::new()
}

/// How many are marked, and what takes them.
fn tell_marked(model: &mut Model) {
    let key = |action| model.keymap.key(action);
    let text = match model.place.marked_versions.len() {
        0 => "nothing is marked".to_owned(),
        count => format!(
            "{count} marked: {} rejects, {} holds, {} copies them, {} takes the marks away",
            key(Action::Refuse),
            key(Action::Pause),
            key(Action::Copy),
            key(Action::Back)
        ),
    };
    tell(model, text, false);
}

/// Takes the marks of the list away that has the keys. Tells whether there were any.
pub(super) fn clear(model: &mut Model) -> bool {
    if model.place.lists_versions() {
        return !std::mem::take(&mut model.place.marked_versions).is_empty();
    }
    model.place.view == View::Alarms && !std::mem::take(&mut model.place.marked).is_empty()
}

/// The marked versions, where they can be seen; those that nobody knows any more lose their marks.
pub(super) fn versions(model: &Model) -> Vec<CapabilityId> {
    let marked = model.place.lists_versions().then_some(&model.place.marked_versions);
    marked.into_iter().flatten().filter(|id| model.stands(id).is_some()).cloned().collect()
}

/// What an action does to every marked version. `None` if none is marked, or it is one that stops what acts: that is for the
/// version under the cursor, whatever is marked.
pub(super) fn on_versions(model: &mut Model, action: Action) -> Option<Vec<Effect>> {
    let marked = versions(model);
    if marked.is_empty() {
        return None;
    }
    match action {
        Action::Refuse | Action::Pause => Some(together(model, action, &marked)),
        Action::Demote | Action::Rollback | Action::Restrict => None,
        _ => {
            let (count, key) = (marked.len(), model.keymap.key(Action::Back));
            let why = format!("{count} are marked, and this acts on one alone: {key} takes the marks away");
            Some(refuse(model, &why))
        }
    }
}

/// One question about all of them.
fn together(model: &mut Model, action: Action, marked: &[CapabilityId]) -> Vec<Effect> {
    let room = usize::from(model.size.1).saturating_sub(QUESTION_ROWS).min(TOGETHER_MAX);
    if marked.len() > room {
        let why = format!("{} are marked, and one question on this screen names {room}", marked.len());
        return refuse(model, &why);
    }
    let mut each = Vec::new();
    for id in marked {
        match operating::intent(model, action, id) {
            Ok((intent, _)) => each.push(intent),
            Err(why) => return refuse(model, &format!("{why}: take its mark away")),
        }
    }
    let intent = match <[Intent; 1]>::try_from(each) {
        Ok([one]) => one,
        Err(each) => Intent::Several(each),
    };
    match operating::now(model, &intent) {
        Ok(lines) => operating::open(model, intent, lines),
        Err(why) => refuse(model, &why),
    }
}

/// How each of several stands, then what becomes of all of them.
pub(super) fn lines(model: &Model, each: &[Intent]) -> Result<Vec<String>, String> {
    let (mut stand, mut become_of): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    for intent in each {
        let mut lines = operating::now(model, intent)?.into_iter();
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

/// Acknowledges every marked alarm that takes it; marks of others stay.
pub(super) fn acknowledge(model: &mut Model, by: &str) -> Vec<Effect> {
    let snapshot = model.told.snapshot.clone();
    let alarms = snapshot.as_ref().map_or(&[][..], |now| &now.alarms);
    // What is gone keeps no mark.
    model.place.marked.retain(|name| alarms.iter().any(|alarm| alarm.alarm == *name));
    let takes = |alarm: &&AlarmView| takes(alarm, Action::Acknowledge).is_ok();
    let marked: Vec<&AlarmView> =
        alarms.iter().filter(|alarm| model.place.marked.contains(&alarm.alarm)).filter(takes).collect();
    let mut effects = Vec::new();
    for alarm in &marked {
        let question = Question::Acknowledge { alarm: alarm.alarm.clone(), by: by.to_owned() };
        let asked = asking::ask(model, format!("acknowledge {}", alarm.alarm), question);
        if asked.is_empty() {
            // So many wait already: the others keep their marks.
            break;
        }
        model.place.marked.remove(&alarm.alarm);
        effects.extend(asked);
    }
    if marked.is_empty() {
        model.place.marked.clear();
        return refuse(model, "every alarm that was marked is acknowledged already");
    }
    effects
}

/// Whether an alarm takes this as it stands, or why not.
pub(super) fn takes(alarm: &AlarmView, action: Action) -> Result<(), String> {
    match action {
        Action::Acknowledge if alarm.acknowledged_by.is_some() => {
            Err("somebody has acknowledged it already".to_owned())
        }
        Action::Acknowledge => Ok(()),
        Action::Unshelve if alarm.shelf.is_none() => Err("it is not shelved".to_owned()),
        Action::Unshelve => Ok(()),
        _ => operating::alarm_lines(alarm, action).map(drop),
    }
}
