//! Help over the screen: every key, and what the signs of the time bar mean.

use ratatui::layout::Rect;

use crate::console::look::{Look, Role};
use crate::console::replay::action::Action;
use crate::console::replay::mark::LEGEND;
use crate::console::views::window;
use crate::console::widgets::pen::Pen;
use crate::console::widgets::row::Row;

/// The widest help, columns.
const WIDTH_MAX: u16 = 80;

/// Draws it from line `first` on.
pub fn draw(first: u16, pen: &mut Pen<'_>, area: Rect) {
    let rows = rows(pen.look);
    let height = u16::try_from(rows.len() + 2).unwrap_or(u16::MAX);
    let hidden = rows.len().saturating_sub(usize::from(area.height.saturating_sub(2)));
    let right = if hidden == 0 { "esc closes" } else { "down shows more, esc closes" };
    let inside = window(pen, area, WIDTH_MAX, height, "Keys of the replay", right);
    let first = usize::from(first).min(hidden);
    pen.rows(inside, 0, rows.get(first..).unwrap_or_default());
}

fn rows(look: &Look) -> Vec<Row> {
    let keys = Action::ALL.iter().map(|action| {
        Row::new().cell(Role::Key, action.keys(), 14).with(Role::Text, " ").with(Role::Text, action.help())
    });
    let title = [Row::new(), Row::of(Role::Title, "On the time bar")];
    let legend = LEGEND.iter().map(|(glyph, text)| {
        Row::new().cell(Role::Title, look.glyph(*glyph), 14).with(Role::Text, " ").with(Role::Text, text)
    });
    keys.chain(title).chain(legend).collect()
}
