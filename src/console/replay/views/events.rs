//! The events, with the one at the cursor marked and later ones muted. A line too long for the pane is shown in full
//! below the list. A re-run has no events, and its failures stand here.
//!
//! ```text
//! ─ Events ─────────────────────────────────── 14 of 96 ─
//!      760.1 state    place@1.1.0: sandboxed -> shadowed
//! ▸ ⚠  761.0 decide   place@1.1.0: shadow -> hold …
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::secs;
use crate::look::{Glyph, Look, ThemeRole};
use crate::replay::model::ReplayModel;
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Pen, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_recordings::recording::FilmSpan;
use holdpoint_wording::console::replay as wording;
use holdpoint_wording::event as event_text;

/// The height from which there is a list.
const PANE_HEIGHT_MIN: u16 = 3;

/// Lines of the pane from which a long event is shown in full.
const WHOLE_HEIGHT_MIN: u16 = 6;

/// The most lines of a long event.
const WHOLE_ROWS_MAX: usize = 3;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let count = model.timeline.recording().events.len();
    if area.height < PANE_HEIGHT_MIN {
        pen.row(area, 0, &here(model, pen.look));
        return;
    }
    if let Some(film) = model.timeline.recording().rerun() {
        return failures(film, model, pen, area);
    }
    let right = match model.cursor.event {
        Some(event) => place(count, event),
        None if count == 0 => String::new(),
        None => wording::before_the_first(count),
    };
    let inside = pen.pane(area, "Events", false, &right);
    if count == 0 {
        pen.text(inside, 0, ThemeRole::Muted, wording::NO_EVENT_RECORDED);
        return;
    }
    let whole = full_event_rows(model, inside);
    let taken = u16::try_from(whole.len()).unwrap_or(0).min(inside.height);
    let (list, foot) = cut(inside, inside.height - taken);
    let look = pen.look;
    pen.list(list, count, model.cursor.event, |event, _| row(model, look, event));
    if model.cursor.event.is_none() && list.height > 0 {
        pen.lay(list, ThemeRole::Muted);
    }
    pen.rows(foot, 0, &whole);
}

/// The event at the cursor, or the last failure of a re-run.
#[must_use]
pub fn here(model: &ReplayModel, look: &Look) -> Row {
    if let Some(film) = model.timeline.recording().rerun() {
        let last = last_failure(film, model);
        return last.map_or_else(Row::new, |last| failure_row(film, last, Some(last), look));
    }
    model.cursor.event.map_or_else(Row::new, |event| row(model, look, event))
}

/// The moments at which a re-run went wrong.
fn failures(film: &FilmSpan, model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let (count, last, look) = (film.failures.len(), last_failure(film, model), pen.look);
    let right = last.map_or_else(String::new, |last| place(count, last));
    let inside = pen.pane(area, "Failures", false, &right);
    if count == 0 {
        let text =
            if film.ended.is_empty() { wording::NO_FAILURE_RECORDED } else { wording::NOTHING_WENT_WRONG };
        pen.text(inside, 0, ThemeRole::Muted, text);
        return;
    }
    pen.list(inside, count, last, |at, _| failure_row(film, at, last, look));
}

/// The last failure that the cursor has reached.
fn last_failure(film: &FilmSpan, model: &ReplayModel) -> Option<usize> {
    film.failures.partition_point(|failure| failure.at_ms <= model.cursor.at_ms).checked_sub(1)
}

/// A failure with its time; muted as long as the cursor is before it.
fn failure_row(film: &FilmSpan, at: usize, last: Option<usize>, look: &Look) -> Row {
    let Some(failure) = film.failures.get(at) else { return Row::new() };
    let is_past = last.is_some_and(|last| at <= last);
    Row::of(ThemeRole::Bad, look.glyph(Glyph::Bad)).with(
        if is_past { ThemeRole::Text } else { ThemeRole::Muted },
        &format!(" {}  {}", secs(failure.at_ms), failure.text),
    )
}

/// One event: its mark on the time bar, and its line of the plain stream.
#[must_use]
pub fn row(model: &ReplayModel, look: &Look, event: usize) -> Row {
    let Some(line) = model.timeline.event(event).map(event_text::line) else { return Row::new() };
    let (glyph, role) =
        model.timeline.mark(event).map_or((" ", ThemeRole::Text), |mark| (look.glyph(mark.glyph), mark.role));
    let is_past = model.cursor.event.is_some_and(|here| event <= here);
    Row::of(role, glyph).with(if is_past { ThemeRole::Text } else { ThemeRole::Muted }, &line)
}

/// The event at the cursor in full, if its line cuts it and the pane has room.
fn full_event_rows(model: &ReplayModel, inside: Rect) -> Vec<Row> {
    let width = inside.width.saturating_sub(GUTTER);
    let here = model.cursor.event.and_then(|event| model.timeline.event(event));
    let text = here.filter(|_| inside.height >= WHOLE_HEIGHT_MIN).map(event_text::line).unwrap_or_default();
    if text.width() < usize::from(width) {
        return Vec::new();
    }
    let lines = wrap(text.trim_start(), usize::from(width), WHOLE_ROWS_MAX);
    lines.iter().map(|line| Row::of(ThemeRole::Text, "  ").with(ThemeRole::Text, line)).collect()
}
