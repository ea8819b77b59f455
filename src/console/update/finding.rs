//! The cursor goes to what is typed, in views that nothing may be filtered from.

use super::moving::set_row;
use crate::model::{HISTORY_PANE, Model, Typing, View};
use crate::rows::said;
use holdpoint_protocol::health::AlarmSpell;

/// Puts the cursor on the next row that contains what is typed, from where it is and then from the top. It stays if
/// there is none.
pub(super) fn look(model: &mut Model) {
    let Some(Typing::Find(line)) = &model.entry.typing else { return };
    if let Some(row) = found(model, line.text()) {
        set_row(model, row);
    }
}

pub(super) fn is_there(model: &Model, text: &str) -> bool {
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
        View::Candidate => model.candidate_rows(model.place.pane()).iter().map(said).collect(),
        View::Shadow => model.disagreement_rows().iter().map(|row| row.text.clone()).collect(),
        View::Overview | View::Registry | View::Audit => Vec::new(),
    }
}
