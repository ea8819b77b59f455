//! A click: to a view, a pane, a row; on the row under the cursor it opens, as Enter does. It never reaches what lies over
//! the view: a question is not answered by pointing.

use ratatui::layout::Rect;

use super::{act, moving, show};
use crate::action::Action;
use crate::effect::Effect;
use crate::frame;
use crate::look::{Look, LookOptions};
use crate::model::Model;
use crate::widgets::pen::Hit;

pub(super) fn click(model: &mut Model, column: u16, row: u16) -> Vec<Effect> {
    if model.entry.overlay.is_some() || model.entry.typing.is_some() || !model.settings.mouse {
        return Vec::new();
    }
    // Where things are does not depend on how they look.
    let Ok(look) = Look::detect(&LookOptions { ascii: true, ..LookOptions::default() }) else {
        return Vec::new();
    };
    let (width, height) = model.size;
    match frame::hit(model, &look, Rect::new(0, 0, width, height), (column, row)) {
        Some(Hit::View(view)) => show(model, view),
        Some(Hit::Pane(pane)) => moving::to_pane(model, pane),
        Some(Hit::Row { pane, row }) => {
            let was_there = pane.is_none_or(|pane| pane == model.place.pane());
            let effects = pane.filter(|_| !was_there).map(|pane| moving::to_pane(model, pane));
            if was_there && row == model.row() {
                return act(model, Action::Open);
            }
            moving::set_row(model, row);
            effects.unwrap_or_default()
        }
        None => Vec::new(),
    }
}
