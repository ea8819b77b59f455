//! The completions of a command line, above the line: Tab steps through them.
//!
//! ```text
//!   demo grasp-improved
//! ▸ demo place-robust
//! :demo place-robust▏
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::commands::WITH_ARGUMENT;
use crate::look::ThemeRole;
use crate::model::CompletionMenu;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// The most lines of a menu.
const ROWS_MAX: u16 = 10;

/// Columns of a command before its help.
const WORD_COLUMNS: usize = 24;

/// Draws it at the foot of an area, at most over half of it.
pub fn draw(menu: &CompletionMenu, pen: &mut Pen<'_>, area: Rect) {
    let count = u16::try_from(menu.lines.len()).unwrap_or(u16::MAX);
    let height = count.min(ROWS_MAX).min(area.height / 2);
    let place = Rect { y: area.bottom() - height, height, ..area };
    pen.clear(place);
    pen.list(place, menu.lines.len(), Some(menu.at), |index, _| {
        let Some(line) = menu.lines.get(index) else { return Row::new() };
        let row = Row::new().cell(ThemeRole::Text, line, line.chars().count().max(WORD_COLUMNS));
        row.with(ThemeRole::Muted, &format!("  {}", help(line)))
    });
}

/// The help of a line's command.
fn help(line: &str) -> &'static str {
    if line.contains(' ') {
        return "";
    }
    let known = WITH_ARGUMENT.iter().find(|(name, ..)| *name == line).map(|(_, _, help)| *help);
    known.or_else(|| Action::parse(line).map(Action::help)).unwrap_or("")
}
