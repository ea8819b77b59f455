//! The help, which is also the palette: the actions that apply here, with their keys, narrowed by typing.
//!
//! ```text
//! ┌ Keys and commands ───────────────┐
//! │ > fre▏                           │
//! │▸ f        freeze   Freeze the …  │
//! └──────────────────────────────────┘
//! ```

use ratatui::layout::Rect;

use super::hints::field;
use crate::look::{Glyph, ThemeRole};
use crate::model::ConsoleModel;
use crate::palette::Palette;
use crate::update::availability::ActionAvailability;
use crate::widgets::list::place;
use crate::widgets::pen::{Pen, below};
use crate::widgets::row::Row;
use holdpoint_wording::console::palette as wording;

/// The widest palette, columns.
const WIDTH_MAX: u16 = 96;

/// Draws it over the view.
pub fn draw(model: &ConsoleModel, palette: &Palette, pen: &mut Pen<'_>, area: Rect) {
    let rows = palette.rows();
    let cursor = palette.cursor.min(rows.len().saturating_sub(1));
    let inside = super::window(pen, area, WIDTH_MAX, area.height, wording::TITLE, &place(rows.len(), cursor));
    let line = Row::of(ThemeRole::Key, &format!("{} ", pen.look.glyph(Glyph::Here))).and(field(
        pen,
        &palette.line,
        usize::from(inside.width.saturating_sub(2)),
        true,
    ));
    pen.row(inside, 0, &line);
    let list = below(inside, 1);
    if rows.is_empty() {
        pen.text(list, 0, ThemeRole::Muted, wording::NOTHING_FITS);
        return;
    }
    let possible = ActionAvailability::of(model);
    pen.list(list, rows.len(), Some(cursor), |index, _| {
        let Some(action) = rows.get(index) else { return Row::new() };
        let keys = model.keymap.keys(*action).join(" ");
        // An action that would be refused stays in its place, with the reason.
        let why = if model.settings.read_only && action.changes_something() {
            Some("read-only".to_owned())
        } else {
            possible.why_not(*action)
        };
        let off = why.is_some();
        let role = if off { ThemeRole::KeyOff } else { ThemeRole::Text };
        let row = Row::new()
            .cell(if off { ThemeRole::KeyOff } else { ThemeRole::Key }, &keys, 14)
            .with(role, " ")
            .cell(role, action.name(), 16)
            .with(role, " ");
        match why {
            Some(why) => {
                // The state of the version is on the screen already, so only the rule is shown.
                let rule = why.rsplit("; ").next().unwrap_or(&why);
                row.with(ThemeRole::KeyOff, &format!("(off: {rule}) {}", action.help()))
            }
            None => row.with(role, action.help()),
        }
    });
}
