//! A click goes to a view, a pane or a row; on the row under the cursor it opens the row, as Enter does. A click never
//! reaches a dialog, so the mouse decides nothing.

use ratatui::layout::Rect;

use super::{act, navigation, show};
use crate::action::Action;
use crate::effect::Effect;
use crate::frame;
use crate::look::{Look, LookOptions};
use crate::model::ConsoleModel;
use crate::widgets::pen::Hit;

pub(super) fn click(model: &mut ConsoleModel, column: u16, row: u16) -> Vec<Effect> {
    if model.input.overlay.is_some() || model.input.typing.is_some() || !model.settings.mouse {
        return Vec::new();
    }
    // Places do not depend on the look.
    let Ok(look) = Look::detect(&LookOptions { ascii: true, ..LookOptions::default() }) else {
        return Vec::new();
    };
    let (width, height) = model.size;
    match frame::hit(model, &look, Rect::new(0, 0, width, height), (column, row)) {
        Some(Hit::View(view)) => show(model, view),
        Some(Hit::Pane(pane)) => navigation::to_pane(model, pane),
        Some(Hit::Row { pane, row }) => {
            let was_there = pane.is_none_or(|pane| pane == model.view_state.pane());
            let effects = pane.filter(|_| !was_there).map(|pane| navigation::to_pane(model, pane));
            if was_there && row == model.row() {
                return act(model, Action::Open);
            }
            navigation::set_row(model, row);
            effects.unwrap_or_default()
        }
        None => Vec::new(),
    }
}
