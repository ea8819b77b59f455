//! The means of drawing: a look, a buffer, and the size class of the screen.
//!
//! Everything is clipped to the buffer; no call panics, whatever the area.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::row::{Row, wrap};
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::View;

/// How much room the screen has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fit {
    /// Alarms and waiting requests, in any number of lines.
    Tiny,
    /// One pane, from 60 x 16.
    One,
    /// Two panes, from 80 x 24.
    Two,
    /// Everything, from 100 x 30.
    Full,
}

impl Fit {
    /// Of a screen of this size.
    #[must_use]
    pub const fn of(width: u16, height: u16) -> Self {
        match (width, height) {
            (100.., 30..) => Self::Full,
            (80.., 24..) => Self::Two,
            (60.., 16..) => Self::One,
            _ => Self::Tiny,
        }
    }
}

/// The meaning of a click.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hit {
    View(View),
    /// A pane of the view.
    Pane(usize),
    /// A row of the list that has the keys, or that has them once its pane does.
    Row {
        pane: Option<usize>,
        row: usize,
    },
}

/// A look on a buffer.
pub struct Pen<'a> {
    pub look: &'a Look,
    pub buf: &'a mut Buffer,
    /// How much room the screen has.
    pub fit: Fit,
    /// The click targets, the topmost last.
    pub hits: Vec<(Rect, Hit)>,
}

impl<'a> Pen<'a> {
    /// A pen for a screen of this size.
    #[must_use]
    pub const fn new(look: &'a Look, buf: &'a mut Buffer, fit: Fit) -> Self {
        Self { look, buf, fit, hits: Vec::new() }
    }
}

impl Pen<'_> {
    /// Registers a click target.
    pub fn hit(&mut self, area: Rect, hit: Hit) {
        if !area.is_empty() {
            self.hits.push((area, hit));
        }
    }

    /// Draws a line at `at` lines below the area's top; too long a line ends in an ellipsis.
    pub fn row(&mut self, area: Rect, at: u16, row: &Row) {
        let area = area.intersection(self.buf.area);
        if at >= area.height || area.width == 0 {
            return;
        }
        let y = area.y + at;
        let mut x = area.x;
        for (text, role) in row.parts() {
            let left = area.right().saturating_sub(x);
            if left == 0 {
                break;
            }
            let style = self.look.style(role);
            (x, _) = if self.look.ascii() && text.contains('…') {
                // The mark by which sanitizing shows a cut.
                let text = text.replace('…', self.look.glyph(Glyph::Ellipsis));
                self.buf.set_stringn(x, y, text, usize::from(left), style)
            } else {
                self.buf.set_stringn(x, y, text, usize::from(left), style)
            };
        }
        if row.width() > usize::from(area.width) {
            self.buf.set_stringn(
                area.right() - 1,
                y,
                self.look.glyph(Glyph::Ellipsis),
                1,
                self.look.style(ThemeRole::Muted),
            );
        }
    }

    /// Draws lines from `at` on; returns the number of lines, drawn or not.
    pub fn rows(&mut self, area: Rect, at: u16, rows: &[Row]) -> u16 {
        for (row, y) in rows.iter().zip(at..area.height) {
            self.row(area, y, row);
        }
        u16::try_from(rows.len()).unwrap_or(u16::MAX)
    }

    /// Draws wrapped text from `at` on; returns the number of lines.
    pub fn text(&mut self, area: Rect, at: u16, role: ThemeRole, text: &str) -> u16 {
        let rows_max = usize::from(area.height.saturating_sub(at));
        let lines = wrap(text, usize::from(area.width), rows_max);
        let rows: Vec<Row> = lines.iter().map(|line| Row::of(role, line)).collect();
        self.rows(area, at, &rows)
    }

    /// One cell; the sign must be one column wide.
    pub fn cell(&mut self, x: u16, y: u16, sign: &str, role: ThemeRole) {
        let style = self.look.style(role);
        if let Some(cell) = self.buf.cell_mut((x, y)) {
            cell.set_symbol(sign).set_style(style);
        }
    }

    /// Lays a role over an area, text kept.
    pub fn lay(&mut self, area: Rect, role: ThemeRole) {
        let style = self.look.style(role);
        self.buf.set_style(area.intersection(self.buf.area), style);
    }

    /// Lets an area look old, text kept: muted, and dim where a theme has no color for that.
    pub fn dim(&mut self, area: Rect) {
        self.lay(area, ThemeRole::Muted);
        let dim = ratatui::style::Style::default().add_modifier(ratatui::style::Modifier::DIM);
        self.buf.set_style(area.intersection(self.buf.area), dim);
    }

    pub fn clear(&mut self, area: Rect) {
        let style = self.look.style(ThemeRole::Text);
        let area = area.intersection(self.buf.area);
        for y in area.top()..area.bottom() {
            for x in area.left()..area.right() {
                if let Some(cell) = self.buf.cell_mut((x, y)) {
                    cell.reset();
                    cell.set_style(style);
                }
            }
        }
    }

    /// A pane's heading line, with `right` at its right end; returns the area below.
    pub fn pane(&mut self, area: Rect, title: &str, focused: bool, right: &str) -> Rect {
        let line = self.look.glyph(Glyph::Horizontal);
        let role = if focused { ThemeRole::Focus } else { ThemeRole::Title };
        let lead = if focused { self.look.glyph(Glyph::Here) } else { line };
        let mut heading = Row::of(ThemeRole::Rule, lead)
            .with(ThemeRole::Rule, " ")
            .with(role, title)
            .with(ThemeRole::Rule, " ");
        let right = if right.is_empty() { String::new() } else { format!(" {right} ") };
        let tail = Row::of(ThemeRole::Muted, &right).with(ThemeRole::Rule, line);
        let width = usize::from(area.width);
        let fill = width.saturating_sub(heading.width() + tail.width());
        heading.push(ThemeRole::Rule, &line.repeat(fill));
        // If both do not fit, the title stays.
        let heading = if heading.width() + tail.width() <= width { heading.and(tail) } else { heading };
        self.row(area, 0, &heading);
        below(area, 1)
    }

    /// A vertical line in a column.
    pub fn divider(&mut self, area: Rect) {
        let sign = self.look.glyph(Glyph::Vertical);
        for y in area.top()..area.bottom() {
            self.cell(area.x, y, sign, ThemeRole::Rule);
        }
    }

    /// Two columns with a line between them; `left` columns go to the first.
    pub fn split(&mut self, area: Rect, left: u16) -> (Rect, Rect) {
        let left = left.min(area.width);
        let first = Rect { width: left, ..area };
        let gap = 3.min(area.width - left);
        self.divider(Rect { x: area.x + left + gap / 2, width: u16::from(gap > 0), ..area });
        let second = Rect { x: area.x + left + gap, width: area.width - left - gap, ..area };
        (first, second)
    }
}

/// Columns for the text at the right end of a pane's heading with this title.
#[must_use]
pub fn heading_room(title: &str, width: u16) -> usize {
    // The lead, the rule's end, and the blanks between them.
    usize::from(width).saturating_sub(title.width() + 6)
}

/// The rest of an area below its first `rows` lines.
#[must_use]
pub const fn below(area: Rect, rows: u16) -> Rect {
    let taken = if rows < area.height { rows } else { area.height };
    Rect { x: area.x, y: area.y + taken, width: area.width, height: area.height - taken }
}

/// The first `rows` lines of an area.
#[must_use]
pub const fn above(area: Rect, rows: u16) -> Rect {
    let height = if rows < area.height { rows } else { area.height };
    Rect { x: area.x, y: area.y, width: area.width, height }
}

/// An area cut after its first `rows` lines.
#[must_use]
pub const fn cut(area: Rect, rows: u16) -> (Rect, Rect) {
    (above(area, rows), below(area, rows))
}
