//! Lists of any length: only visible rows are made and drawn.

use ratatui::layout::Rect;

use super::pen::{Hit, Pen};
use super::row::Row;
use crate::look::{Glyph, ThemeRole};

/// Columns before a row: the mark of the row under the cursor.
pub const GUTTER: u16 = 2;

/// The first visible row, so that the one under the cursor is in sight.
#[must_use]
pub const fn first_shown(count: usize, cursor: usize, height: u16) -> usize {
    let height = height as usize;
    if count <= height {
        return 0;
    }
    let middle = cursor.saturating_sub(height / 2);
    let last = count - height;
    if middle < last { middle } else { last }
}

impl Pen<'_> {
    /// Draws the visible rows. `cursor` is the row under the cursor, if the list has the keys or shows one; `row`
    /// makes a row of a width.
    pub fn list(
        &mut self,
        area: Rect,
        count: usize,
        cursor: Option<usize>,
        mut row: impl FnMut(usize, usize) -> Row,
    ) {
        let first = first_shown(count, cursor.unwrap_or(0), area.height);
        let width = area.width.saturating_sub(GUTTER);
        let inner = Rect { x: area.x + GUTTER.min(area.width), width, ..area };
        for (index, at) in (first..count).zip(0..area.height) {
            self.row(inner, at, &row(index, usize::from(width)));
            if cursor.is_some() {
                let place = Rect { y: area.y + at, height: 1, ..area };
                self.hit(place, Hit::Row { pane: None, row: index });
            }
            if cursor == Some(index) {
                self.row(area, at, &Row::of(ThemeRole::Text, self.look.glyph(Glyph::Here)));
                self.lay(Rect { y: area.y + at, height: 1, ..area }, ThemeRole::Selected);
            }
        }
    }
}

/// The place of the cursor, `3 of 40`; empty for an empty list.
#[must_use]
pub fn place(count: usize, cursor: usize) -> String {
    if count == 0 { String::new() } else { format!("{} of {count}", cursor.min(count - 1) + 1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cursor_is_always_visible() {
        for (count, height) in [(0, 5), (3, 5), (10, 5), (10_000, 1), (7, 0)] {
            for cursor in 0..count.min(50) {
                let first = first_shown(count, cursor, height);
                let shown = first..first + usize::from(height);
                assert!(height == 0 || shown.contains(&cursor), "{count} {height} {cursor}");
            }
        }
        assert_eq!((place(0, 0), place(3, 9)), (String::new(), "3 of 3".to_owned()));
    }
}
