//! The time bar: marks of events, the stretches with frames, the failures, and the cursor.
//!
//! ```text
//!            ✔      ◷✔ ↑           ✖↩
//! 700.0 s ···━━━━━━━━━━┃━━━━━━━━━━━✖━━━····· 890.0 s
//! ```

use ratatui::layout::Rect;

use super::secs;
use crate::look::{Glyph, ThemeRole};
use crate::replay::model::ReplayModel;
use crate::replay::time_mark::TimeMark;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// Draws its two lines.
pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let area = area.intersection(pen.buf.area);
    let (from_ms, to_ms) = model.timeline.span_ms();
    let (begin, end) = (format!("{} ", secs(from_ms)), format!(" {}", secs(to_ms)));
    let taken = u16::try_from(begin.len() + end.len()).unwrap_or(u16::MAX);
    let Some(width) = area.width.checked_sub(taken).filter(|width| *width > 0 && area.height > 0) else {
        return;
    };
    let left = u16::try_from(begin.len()).unwrap_or(0);
    let bar = Rect { x: area.x + left, width, ..area };
    let line = area.height - 1;
    pen.row(area, line, &Row::of(ThemeRole::Muted, &begin));
    pen.row(
        Rect { x: bar.right(), width: area.right() - bar.right(), ..area },
        line,
        &Row::of(ThemeRole::Muted, &end),
    );
    let column = |at_ms| column(at_ms, (from_ms, to_ms), width);
    draw_stretches(model, pen, Rect { y: area.y + line, height: 1, ..bar }, &column);
    for at_ms in model.timeline.failures().times_ms() {
        pen.cell(bar.x + column(*at_ms), area.y + line, pen.look.glyph(Glyph::Bad), ThemeRole::Bad);
    }
    if line > 0 {
        marks(model, pen, Rect { height: 1, ..bar }, &column);
    }
    let here = bar.x + column(model.cursor.at_ms);
    pen.cell(here, area.y + line, pen.look.glyph(Glyph::Limit), ThemeRole::Focus);
}

/// The column of a time; the last column for the end.
fn column(at_ms: u64, (from_ms, to_ms): (u64, u64), width: u16) -> u16 {
    let span_ms = u128::from(to_ms.saturating_sub(from_ms).max(1));
    let passed_ms = u128::from(at_ms.saturating_sub(from_ms));
    let column = passed_ms * u128::from(width.saturating_sub(1)) / span_ms;
    u16::try_from(column).unwrap_or(u16::MAX).min(width.saturating_sub(1))
}

/// Draws the stretches with frames and the gaps.
fn draw_stretches(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect, column: &dyn Fn(u64) -> u16) {
    let full = if pen.look.ascii() { "=" } else { "━" };
    for x in area.left()..area.right() {
        pen.cell(x, area.y, pen.look.glyph(Glyph::Ahead), ThemeRole::Muted);
    }
    for (first_ms, last_ms) in model.timeline.stretches_ms() {
        for place in column(*first_ms)..=column(*last_ms) {
            pen.cell(area.x + place, area.y, full, ThemeRole::Value);
        }
    }
}

/// The most serious mark of each column.
fn marks(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect, column: &dyn Fn(u64) -> u16) {
    let mut gravest: Vec<Option<TimeMark>> = vec![None; usize::from(area.width)];
    for (at_ms, mark) in model.timeline.marks() {
        if let Some(place) = gravest.get_mut(usize::from(column(at_ms)))
            && place.is_none_or(|known| known.weight < mark.weight)
        {
            *place = Some(mark);
        }
    }
    for (x, mark) in (area.left()..area.right()).zip(gravest) {
        if let Some(mark) = mark {
            pen.cell(x, area.y, pen.look.glyph(mark.glyph), mark.role);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_their_columns() {
        for (at_ms, width, expected) in
            [(100, 11, 0), (150, 11, 5), (200, 11, 10), (999, 11, 10), (0, 11, 0), (200, 1, 0)]
        {
            assert_eq!(column(at_ms, (100, 200), width), expected, "{at_ms} {width}");
        }
        assert_eq!(column(u64::MAX, (0, u64::MAX), 80), 79);
        assert_eq!(column(5, (5, 5), 80), 0);
    }
}
