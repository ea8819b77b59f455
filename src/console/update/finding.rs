//! The cursor goes to what is typed, in views that nothing may be filtered from.

use super::moving::set_row;
use super::refuse;
use crate::audit;
use crate::effect::Effect;
use crate::model::{HISTORY_PANE, Model, OpenedRecord, Typing, View};
use crate::rows::whole;
use holdpoint_protocol::health::AlarmSpell;

/// Puts the cursor on the next row that contains what is typed, from where it is and then from the top. It stays if
/// there is none.
pub(super) fn look(model: &mut Model) {
    let Some(Typing::Find(line)) = &model.entry.typing else { return };
    if let (Some(lines), Some(opened)) = (model.opened_record().map(audit::raw), model.place.opened) {
        let wanted = line.text().to_lowercase();
        let fits = |at: &usize| lines.get(*at).is_some_and(|text| text.to_lowercase().contains(&wanted));
        let found = (opened.scroll..lines.len()).chain(0..opened.scroll).find(fits);
        if let (Some(scroll), false) = (found, wanted.is_empty()) {
            model.place.opened = Some(OpenedRecord { scroll, ..opened });
        }
        return;
    }
    if let Some(row) = found(model, line.text()) {
        set_row(model, row);
    }
}

/// Where what was searched for stands next, after the row under the cursor.
pub(super) fn next(model: &mut Model) -> Vec<Effect> {
    let sought = model.place.sought.clone();
    if sought.is_empty() {
        return refuse(model, "nothing was searched for yet; / begins a search in a list that hides nothing");
    }
    let wanted = sought.to_lowercase();
    let is_in = |text: &String| text.to_lowercase().contains(&wanted);
    let lines = model.opened_record().map(audit::raw);
    let (texts, at) = match (&lines, model.place.opened) {
        (Some(lines), Some(opened)) => (lines.clone(), opened.scroll),
        _ => (texts(model), model.row()),
    };
    let after = (at + 1..texts.len()).chain(0..=at.min(texts.len().saturating_sub(1)));
    let Some(found) = after.into_iter().find(|row| texts.get(*row).is_some_and(is_in)) else {
        return refuse(model, &format!("{sought:?} is not in this list"));
    };
    match (&lines, &mut model.place.opened) {
        (Some(_), Some(opened)) => opened.scroll = found,
        _ => set_row(model, found),
    }
    Vec::new()
}

pub(super) fn is_there(model: &Model, text: &str) -> bool {
    if let Some(record) = model.opened_record() {
        let wanted = text.to_lowercase();
        return audit::raw(record).iter().any(|line| line.to_lowercase().contains(&wanted));
    }
    text.is_empty() || found(model, text).is_some()
}

fn found(model: &Model, text: &str) -> Option<usize> {
    let wanted = text.to_lowercase();
    let texts = texts(model);
    let fits = |row: &usize| texts.get(*row).is_some_and(|text| text.to_lowercase().contains(&wanted));
    let from = model.row();
    (!wanted.is_empty()).then(|| (from..texts.len()).chain(0..from).find(fits)).flatten()
}

/// What each row of the view says.
fn texts(model: &Model) -> Vec<String> {
    match model.place.view {
        View::Alarms if model.place.pane() == HISTORY_PANE => {
            let said =
                |spell: &AlarmSpell| format!("{} {}", spell.alarm, spell.text.as_deref().unwrap_or(""));
            model.alarm_spells().into_iter().map(said).collect()
        }
        View::Health => model.health_families().iter().map(ToString::to_string).collect(),
        View::Alarms => {
            let rows = model.alarm_rows();
            let alarms = rows.iter().map(|row| row.alarm());
            alarms.map(|alarm| format!("{} {} {}", alarm.alarm, alarm.subject, alarm.text)).collect()
        }
        View::Approvals => model.waiting_rows().iter().map(|row| row.version().to_string()).collect(),
        View::Candidate => model.candidate_rows(model.place.pane()).iter().map(whole).collect(),
        View::Shadow => model.disagreement_rows().iter().map(|row| row.text.clone()).collect(),
        View::Overview | View::Registry | View::Audit => Vec::new(),
    }
}
