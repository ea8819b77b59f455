//! Moves the cursor to the typed text: while it is typed in views without a filter, and to the next match in every list.

use super::navigation::set_row;
use super::refuse;
use crate::audit::{self, AuditItem};
use crate::effect::Effect;
use crate::formatters::state_label;
use crate::model::{ConsoleModel, HISTORY_PANE, OpenedRecord, Typing, View};
use crate::rows::{RegistryItem, search_text};
use holdpoint_protocol::health::AlarmEpisode;
use holdpoint_protocol::snapshot::CandidateView;
use holdpoint_wording::notice;

/// Moves the cursor to the next row that contains the typed text, from its place and then from the top. It stays if
/// there is none.
pub(super) fn look(model: &mut ConsoleModel) {
    let Some(Typing::Find(line)) = &model.input.typing else { return };
    if let (Some(lines), Some(opened)) = (model.opened_record().map(audit::raw), model.view_state.opened) {
        let needle = line.text().to_lowercase();
        let fits = |at: &usize| lines.get(*at).is_some_and(|text| text.to_lowercase().contains(&needle));
        let found = (opened.scroll..lines.len()).chain(0..opened.scroll).find(fits);
        if let (Some(scroll), false) = (found, needle.is_empty()) {
            model.view_state.opened = Some(OpenedRecord { scroll, ..opened });
        }
        return;
    }
    if let Some(row) = find_row(model, line.text()) {
        set_row(model, row);
    }
}

/// Moves to the next match, after the row under the cursor.
pub(super) fn next(model: &mut ConsoleModel) -> Vec<Effect> {
    let search = model.view_state.search.clone();
    if search.is_empty() {
        return refuse(model, "nothing was searched for yet; / begins a search");
    }
    let needle = search.to_lowercase();
    let is_in = |text: &String| text.to_lowercase().contains(&needle);
    let lines = model.opened_record().map(audit::raw);
    let (texts, at) = match (&lines, model.view_state.opened) {
        (Some(lines), Some(opened)) => (lines.clone(), opened.scroll),
        _ => (texts(model), model.row()),
    };
    let after = (at + 1..texts.len()).chain(0..=at.min(texts.len().saturating_sub(1)));
    let Some(found) = after.into_iter().find(|row| texts.get(*row).is_some_and(is_in)) else {
        return refuse(model, &format!("{search:?} is not in this list"));
    };
    match (&lines, &mut model.view_state.opened) {
        (Some(_), Some(opened)) => opened.scroll = found,
        _ => set_row(model, found),
    }
    Vec::new()
}

pub(super) fn is_there(model: &ConsoleModel, text: &str) -> bool {
    if let Some(record) = model.opened_record() {
        let needle = text.to_lowercase();
        return audit::raw(record).iter().any(|line| line.to_lowercase().contains(&needle));
    }
    text.is_empty() || find_row(model, text).is_some()
}

fn find_row(model: &ConsoleModel, text: &str) -> Option<usize> {
    let needle = text.to_lowercase();
    let texts = texts(model);
    let fits = |row: &usize| texts.get(*row).is_some_and(|text| text.to_lowercase().contains(&needle));
    let from = model.row();
    (!needle.is_empty()).then(|| (from..texts.len()).chain(0..from).find(fits)).flatten()
}

/// The text of each row of the view.
fn texts(model: &ConsoleModel) -> Vec<String> {
    match model.view_state.view {
        View::Alarms if model.view_state.pane() == HISTORY_PANE => {
            let episode_text = |spell: &AlarmEpisode| {
                format!("{} {}", spell.alarm, spell.text.as_ref().map(notice).unwrap_or_default())
            };
            model.alarm_spells().into_iter().map(episode_text).collect()
        }
        View::Health => model.health_families().iter().map(ToString::to_string).collect(),
        View::Alarms => {
            let rows = model.alarm_rows();
            let alarms = rows.iter().map(|row| row.alarm());
            alarms.map(|alarm| format!("{} {} {}", alarm.alarm, alarm.subject, notice(&alarm.text))).collect()
        }
        View::Approvals => model.waiting_rows().iter().map(|row| row.version().to_string()).collect(),
        View::Candidate => model.candidate_rows(model.view_state.pane()).iter().map(search_text).collect(),
        View::Shadow => model.disagreement_rows().iter().map(|row| row.text.clone()).collect(),
        View::Overview if model.view_state.is_in_event_log() => {
            model.event_log_rows().iter().map(|line| line.text.clone()).collect()
        }
        View::Overview => {
            let text = |row: &&CandidateView| {
                format!("{} {} {}", row.version, row.author, state_label(row.state, &row.flags))
            };
            model.pipeline_rows().iter().map(text).collect()
        }
        View::Registry => {
            let text = |row: &RegistryItem<'_>| match row {
                RegistryItem::Family { family, .. } => family.to_string(),
                RegistryItem::Version(row) => {
                    format!("{} {} {}", row.version, row.author, state_label(row.state, &row.flags))
                }
            };
            model.registry_rows().iter().map(text).collect()
        }
        View::Audit => {
            let text = |row: &AuditItem<'_>| {
                let record = row.record;
                format!("{} {} {}", record.kind, record.subject, audit::sentence(record))
            };
            model.audit_rows().iter().map(text).collect()
        }
    }
}
