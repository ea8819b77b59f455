//! The event log, newest first.
//!
//! ```text
//! 00:12:41  stage-started place@1.1.0 shadow budget 40
//! 00:12:40  state-changed place@1.1.0 validated -> sandboxed
//! ```

use ratatui::layout::Rect;

use crate::look::ThemeRole;
use crate::model::ConsoleModel;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// Draws it; row 0 is the newest line.
pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect, focused: bool) {
    let rows = model.event_log_rows();
    if rows.is_empty() {
        let filtered = !model.event_log_filter().is_empty();
        let text = if filtered { "No line fits the filter" } else { "Nothing has happened yet" };
        pen.text(area, 0, ThemeRole::Muted, text);
        return;
    }
    let cursor = focused.then(|| model.row());
    pen.list(area, rows.len(), cursor, |index, _| {
        rows.get(index).map_or_else(Row::new, |line| {
            let row = Row::of(ThemeRole::Muted, &format!("{}  ", model.moment(line.at_ms)));
            let row = row.with(ThemeRole::Text, &line.text);
            if line.sequences > 1 {
                row.with(ThemeRole::Muted, &format!("  and {} before it", line.sequences - 1))
            } else {
                row
            }
        })
    });
}
