//! Moves the cursor to the typed text: while it is typed in views without a filter, and to the next match in every list.

use super::navigation::set_row;
use super::refuse;
use crate::audit;
use crate::effect::Effect;
use crate::model::{ConsoleModel, OpenedRecord, Typing};
use holdpoint_wording::console::find_in_view as wording;
use holdpoint_wording::console::shared;

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
        return refuse(model, wording::NOTHING_SEARCHED);
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
        return refuse(model, &shared::not_in_this_list(&search));
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
    model.view_state.view.behavior().row_texts(model)
}
