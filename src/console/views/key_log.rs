//! What each key of this console did, newest first, and the entry under the cursor in full.
//!
//! ```text
//! ┌ Keys ──────────────────────────────────── 1 of 40 ┐
//! │▸ 08:12:41 enter  Hold grasp@1.1.0: asked; grasp…  │
//! │  08:12:30 p      asks: Hold grasp@1.1.0           │
//! │ Hold grasp@1.1.0: asked                           │
//! │ the engine: grasp@1.1.0 is held                   │
//! └───────────────────────────────────────────────────┘
//! ```

use ratatui::layout::Rect;

use crate::look::ThemeRole;
use crate::model::{ConsoleModel, KeyLogEntry};
use crate::widgets::list::place;
use crate::widgets::pen::{Pen, below, cut};
use crate::widgets::row::Row;
use holdpoint_wording::console::key_log as wording;

/// The widest list, columns.
const WIDTH_MAX: u16 = 96;

/// Lines for the entry under the cursor.
const DETAIL_ROWS: u16 = 4;

/// Draws it over the view.
pub fn draw(model: &ConsoleModel, cursor: usize, pen: &mut Pen<'_>, area: Rect) {
    let entries: Vec<&KeyLogEntry> = model.key_log.entries.iter().rev().collect();
    let cursor = cursor.min(entries.len().saturating_sub(1));
    let inside = super::window(pen, area, WIDTH_MAX, area.height, "Keys", &place(entries.len(), cursor));
    if entries.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, wording::NO_KEY_YET);
        return;
    }
    let (list, detail) = cut(inside, inside.height.saturating_sub(DETAIL_ROWS.min(inside.height / 2)));
    pen.list(list, entries.len(), Some(cursor), |index, _| {
        entries.get(index).map_or_else(Row::new, |entry| line(entry))
    });
    if let Some(entry) = entries.get(cursor) {
        let taken = pen.text(detail, 0, role(entry.refused), &entry.text);
        let answer = answer(entry);
        pen.text(below(detail, taken), 0, role(entry.answer_refused), &answer);
    }
}

const fn role(refused: bool) -> ThemeRole {
    if refused { ThemeRole::Warning } else { ThemeRole::Text }
}

fn line(entry: &KeyLogEntry) -> Row {
    let row = Row::of(ThemeRole::Muted, &format!("{} ", entry.at))
        .cell(ThemeRole::Key, &super::short(&entry.key, 11), 12)
        .with(role(entry.refused), &entry.text);
    let answer = answer(entry);
    if answer.is_empty() { row } else { row.with(role(entry.answer_refused), &format!("; {answer}")) }
}

/// The engine's answer, as far as there is one.
fn answer(entry: &KeyLogEntry) -> String {
    match (entry.answer.as_str(), entry.is_waiting()) {
        ("", false) => String::new(),
        ("", true) => wording::NOT_ANSWERED_YET.to_owned(),
        (text, false) => wording::engine_answered(text),
        (text, true) => wording::more_answers_missing(text),
    }
}
