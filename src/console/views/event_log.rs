//! The event log, newest first, and one of its events in full.
//!
//! ```text
//! 18:31:57  6 sequences, 4 done, the last: work     sequence 211: not done, grasp@1.0.0 failed (the object slipped)
//! 18:31:41  stage-started place@1.1.0 shadow budget 40
//! 18:31:40  state-changed place@1.1.0 validated -> sandboxed
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, EventLogLine, EventScreen, SharedLine};
use crate::widgets::pen::Pen;
use crate::widgets::row::{Row, wrap};
use holdpoint_wording::console::event_log as wording;
use holdpoint_wording::event::LINE_WIDTH_MAX;

/// The widest window of one event, columns.
const WIDTH_MAX: u16 = 96;

/// Columns of a window's frame.
const FRAME: u16 = 4;

/// Draws it; row 0 is the newest line.
pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect, focused: bool) {
    let rows = model.event_log_rows();
    if rows.is_empty() {
        let filtered = !model.event_log_filter().is_empty();
        let text = if filtered { wording::NO_LINE_FITS } else { wording::NOTHING_HAPPENED };
        pen.text(area, 0, ThemeRole::Muted, text);
        return;
    }
    let cursor = focused.then(|| model.row());
    pen.list(area, rows.len(), cursor, |index, _| {
        rows.get(index).map_or_else(Row::new, |line| {
            Row::of(ThemeRole::Muted, &format!("{}  ", model.moment(line.at_ms)))
                .with(ThemeRole::Title, &count(line))
                .with(ThemeRole::Text, &line.text)
        })
    });
}

/// The count of the events that share a line, before the text of the last one.
fn count(line: &EventLogLine) -> String {
    match line.shared {
        Some(SharedLine::Sequences { count, done }) if count > 1 => wording::sequences(count, done),
        Some(SharedLine::TasksPastLimit { count, .. }) if count > 1 => wording::tasks_past_limit(count),
        Some(SharedLine::Sequences { .. } | SharedLine::TasksPastLimit { .. }) | None => String::new(),
    }
}

/// The whole text of an event, wrapped for its window on a screen of this width.
#[must_use]
pub fn lines_in_full(line: &EventLogLine, columns: u16) -> Vec<String> {
    let width = usize::from(columns.min(WIDTH_MAX).saturating_sub(FRAME));
    wrap(&format!("{}{}", count(line), line.text), width, LINE_WIDTH_MAX)
}

/// Draws an event in full over the view.
pub fn draw_in_full(model: &ConsoleModel, screen: &EventScreen, pen: &mut Pen<'_>, area: Rect) {
    let lines = lines_in_full(&screen.line, area.width);
    let height = u16::try_from(lines.len() + 2).unwrap_or(u16::MAX);
    let title = format!("Event of {}", model.moment(screen.line.at_ms));
    let room = usize::from(area.height.saturating_sub(2));
    let hidden = lines.len().saturating_sub(room);
    let first = screen.scroll.min(hidden);
    let right = if first < hidden {
        wording::shows_more(&model.keymap.key(Action::Down))
    } else {
        format!("{} closes", model.keymap.key(Action::Back))
    };
    let inside = super::window(pen, area, WIDTH_MAX, height, &title, &right);
    let rows: Vec<Row> = lines.iter().skip(first).map(|line| Row::of(ThemeRole::Text, line)).collect();
    pen.rows(inside, 0, &rows);
}
