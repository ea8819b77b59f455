//! The whole text of an event over the view: opening and keys.

use super::act;
use crate::action::Action;
use crate::effect::Effect;
use crate::model::{ConsoleModel, EventScreen, Overlay};
use crate::views::event_log::lines_in_full;

/// Rows that a page moves.
const PAGE_ROWS: usize = 10;

/// Opens the event under the cursor.
pub(crate) fn open(model: &mut ConsoleModel) -> Vec<Effect> {
    let line = model.event_log_rows().get(model.row()).map(|line| (*line).clone());
    if let Some(line) = line {
        model.input.overlay = Some(Overlay::Event(EventScreen { line, scroll: 0 }));
    }
    Vec::new()
}

/// Keys in the open text.
pub(super) fn key(model: &mut ConsoleModel, action: Option<Action>) -> Vec<Effect> {
    let columns = model.size.0;
    let Some(Overlay::Event(screen)) = &mut model.input.overlay else { return Vec::new() };
    let last = lines_in_full(&screen.line, columns).len().saturating_sub(1);
    match action {
        Some(action @ (Action::Stop | Action::Abort)) => return act(model, action),
        Some(Action::Copy) => return vec![Effect::Copy(screen.line.text.clone())],
        Some(Action::Up) => screen.scroll = screen.scroll.saturating_sub(1),
        Some(Action::Down) => screen.scroll = screen.scroll.saturating_add(1).min(last),
        Some(Action::PageUp) => screen.scroll = screen.scroll.saturating_sub(PAGE_ROWS),
        Some(Action::PageDown) => screen.scroll = screen.scroll.saturating_add(PAGE_ROWS).min(last),
        Some(Action::Top) => screen.scroll = 0,
        Some(Action::Bottom) => screen.scroll = last,
        Some(Action::Back | Action::Quit | Action::Open) => model.input.overlay = None,
        // No other key reaches the view below.
        Some(_) | None => {}
    }
    Vec::new()
}
