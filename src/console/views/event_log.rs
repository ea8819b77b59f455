//! The event log, newest first.
//!
//! ```text
//! 18:31:57  6 sequences, 4 done, the last: work     sequence 211: not done, grasp@1.0.0 failed (the object slipped)
//! 18:31:41  stage-started place@1.1.0 shadow budget 40
//! 18:31:40  state-changed place@1.1.0 validated -> sandboxed
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
            let mut row = Row::of(ThemeRole::Muted, &format!("{}  ", model.moment(line.at_ms)));
            if line.sequences > 1 {
                let count = format!("{} sequences, {} done, the last: ", line.sequences, line.done);
                row.push(ThemeRole::Title, &count);
            }
            row.with(ThemeRole::Text, &line.text)
        })
    });
}
