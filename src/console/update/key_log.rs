//! The log of the keys: notes what each key did, and moves in the list.

use ratatui::crossterm::event::KeyEvent;

use super::act;
use crate::action::Action;
use crate::effect::Effect;
use crate::formatters::{seconds, time_of_day};
use crate::keymap;
use crate::model::{ConsoleModel, Overlay};

/// Rows that a page moves.
const PAGE_ROWS: usize = 10;

/// Handles a key, and notes its effect. One that only moves the cursor leaves no entry unless it is refused.
pub(super) fn note(
    model: &mut ConsoleModel,
    key: KeyEvent,
    handle: impl FnOnce(&mut ConsoleModel, KeyEvent) -> Vec<Effect>,
) -> Vec<Effect> {
    let at = model.wall_ms().map_or_else(|| seconds(model.now_ms), time_of_day);
    model.key_log.begin(at, keymap::written(key));
    let effects = handle(model, key);
    let is_left_out = |action: &Action| {
        // The other two begin a line, which is noted when it ends.
        action.moves_cursor() || matches!(action, Action::KeyLog | Action::CommandLine | Action::Filter)
    };
    if let Some(action) = model.key_log.unexplained().filter(|action| !is_left_out(action)) {
        let text = match &model.input.overlay {
            Some(Overlay::Form(form)) => format!("asks: {}", form.intent.title()),
            _ => action.name().to_owned(),
        };
        model.key_log.note_text(&text, false);
    }
    model.key_log.finish();
    effects
}

/// Opens the list, on its newest entry.
pub(super) fn open(model: &mut ConsoleModel) -> Vec<Effect> {
    model.input.overlay = Some(Overlay::KeyLog(0));
    Vec::new()
}

/// Keys in the open list.
pub(super) fn log_key(model: &mut ConsoleModel, action: Option<Action>) -> Vec<Effect> {
    let last = model.key_log.entries.len().saturating_sub(1);
    let Some(Overlay::KeyLog(row)) = &mut model.input.overlay else { return Vec::new() };
    match action {
        Some(action @ (Action::Stop | Action::Abort)) => return act(model, action),
        Some(Action::Up) => *row = row.saturating_sub(1),
        Some(Action::Down) => *row = row.saturating_add(1).min(last),
        Some(Action::PageUp) => *row = row.saturating_sub(PAGE_ROWS),
        Some(Action::PageDown) => *row = row.saturating_add(PAGE_ROWS).min(last),
        Some(Action::Top) => *row = 0,
        Some(Action::Bottom) => *row = last,
        Some(Action::Back | Action::Quit | Action::KeyLog) => model.input.overlay = None,
        // No other key reaches the view below.
        Some(_) | None => {}
    }
    Vec::new()
}
