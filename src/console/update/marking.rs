//! Alarms that are marked, so that one key answers all of them; and whether an alarm takes an answer as it stands.

use super::{asking, moving, operating, refuse};
use crate::action::Action;
use crate::effect::{Effect, Question};
use crate::model::{Model, View};
use holdpoint_protocol::snapshot::AlarmView;

/// Marks the alarm under the cursor, or takes its mark away, and goes on to the next.
pub(super) fn mark(model: &mut Model) -> Vec<Effect> {
    let rows = model.alarm_rows();
    let at = model.row();
    let name = rows.get(at).map(|item| item.alarm().alarm.clone());
    let Some(name) = name.filter(|_| model.place.view == View::Alarms) else {
        return refuse(model, "there is no alarm under the cursor to mark");
    };
    let last = rows.len().saturating_sub(1);
    if !model.place.marked.remove(&name) {
        model.place.marked.insert(name);
    }
    moving::set_row(model, (at + 1).min(last));
    Vec::new()
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
