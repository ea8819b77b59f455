//! A grid of dots, eight to a cell (braille), for scenes and charts; in ASCII one sign a cell.
//!
//! Dots count from the top left. What lies outside is left off; no call panics.

use ratatui::layout::Rect;

use super::pen::Pen;
use crate::look::ThemeRole;

/// Dots across a cell.
pub const ACROSS: usize = 2;

/// Dots down a cell.
pub const DOWN: usize = 4;

/// The longest line, dots: a longer one comes from an error in the numbers.
const LINE_MAX: i64 = 20_000;

/// The ink of a line or shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ink {
    pub role: ThemeRole,
    /// Its sign in ASCII.
    pub ascii: &'static str,
    /// Whether every other pair of dots is left out, for a ghost.
    pub dashed: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct DotCell {
    bits: u8,
    ink: Option<(ThemeRole, &'static str)>,
}

/// A grid of dots.
#[derive(Clone, Debug)]
pub struct Dots {
    columns: usize,
    rows: usize,
    cells: Vec<DotCell>,
}

/// Bits of braille by column and row of the dot.
const BITS: [[u8; DOWN]; ACROSS] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];

impl Dots {
    /// A grid without dots for an area of the screen.
    #[must_use]
    pub fn new(area: Rect) -> Self {
        let (columns, rows) = (usize::from(area.width), usize::from(area.height));
        Self { columns, rows, cells: vec![DotCell::default(); columns * rows] }
    }

    /// Dots across and down.
    #[must_use]
    pub const fn size(&self) -> (usize, usize) {
        (self.columns * ACROSS, self.rows * DOWN)
    }

    /// One dot. The ink that came last gives its cell the role.
    pub fn dot(&mut self, x: i64, y: i64, ink: Ink) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        let (column, row) = (x / ACROSS, y / DOWN);
        if column >= self.columns {
            return;
        }
        let bit = BITS.get(x % ACROSS).and_then(|bits| bits.get(y % DOWN)).copied().unwrap_or(0);
        if let Some(cell) = self.cells.get_mut(row * self.columns + column) {
            cell.bits |= bit;
            cell.ink = Some((ink.role, ink.ascii));
        }
    }

    /// A straight line, both ends included.
    pub fn line(&mut self, from: (i64, i64), to: (i64, i64), ink: Ink) {
        let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs());
        if steps > LINE_MAX {
            return;
        }
        for step in 0..=steps {
            if ink.dashed && step / 2 % 2 == 1 {
                continue;
            }
            let along = |a: i64, b: i64| {
                if steps == 0 { a } else { a + ((b - a) * step * 2 + steps * (b - a).signum()) / (2 * steps) }
            };
            self.dot(along(from.0, to.0), along(from.1, to.1), ink);
        }
    }

    /// The outline of a rectangle, or all of it if `filled`.
    pub fn rectangle(&mut self, from: (i64, i64), to: (i64, i64), ink: Ink, filled: bool) {
        let (left, right) = (from.0.min(to.0), from.0.max(to.0));
        let (top, bottom) = (from.1.min(to.1), from.1.max(to.1));
        if filled {
            let (across, down) = self.size();
            let limit = |value: i64, most: usize| value.clamp(-1, i64::try_from(most).unwrap_or(0));
            for y in limit(top, down)..=limit(bottom, down) {
                self.line((limit(left, across), y), (limit(right, across), y), ink);
            }
            return;
        }
        for (a, b) in [
            ((left, top), (right, top)),
            ((left, bottom), (right, bottom)),
            ((left, top), (left, bottom)),
            ((right, top), (right, bottom)),
        ] {
            self.line(a, b, ink);
        }
    }

    /// Whether one of the next `count` cells of a row has a dot, from a column on.
    #[must_use]
    pub fn covers(&self, column: usize, row: usize, count: usize) -> bool {
        let begin = row * self.columns + column.min(self.columns);
        let end = begin + count.min(self.columns.saturating_sub(column));
        self.cells.get(begin..end).is_some_and(|cells| cells.iter().any(|cell| cell.bits != 0))
    }

    /// Puts the dots on the screen; cells without dots stay as they are.
    pub fn draw(&self, pen: &mut Pen<'_>, area: Rect) {
        let ascii = pen.look.ascii();
        for (y, row) in (area.top()..area.bottom()).zip(self.cells.chunks(self.columns.max(1))) {
            for (x, cell) in (area.left()..area.right()).zip(row) {
                let Some((role, sign)) = cell.ink else { continue };
                let braille = char::from_u32(0x2800 + u32::from(cell.bits)).unwrap_or(' ');
                let mut bytes = [0; 4];
                let sign = if ascii { sign } else { &*braille.encode_utf8(&mut bytes) };
                pen.cell(x, y, sign, role);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_reach_both_ends_and_are_clipped_to_the_area() {
        let ink = Ink { role: ThemeRole::Robot, ascii: "#", dashed: false };
        let mut dots = Dots::new(Rect::new(0, 0, 4, 2));
        dots.line((0, 0), (7, 7), ink);
        let set: u32 = dots.cells.iter().map(|cell| cell.bits.count_ones()).sum();
        assert_eq!(set, 8);
        assert!(
            dots.covers(0, 0, 1) && dots.covers(2, 1, 9) && !dots.covers(2, 0, 9) && !dots.covers(9, 0, 1)
        );
        dots.line((-50, -50), (i64::from(i32::MAX), 4), ink);
        dots.rectangle((-9, -9), (99_999, 99_999), ink, true);
        assert!(dots.cells.iter().all(|cell| cell.bits == 0xff));
    }
}
