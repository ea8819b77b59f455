//! One line of the screen: pieces of text, each with a role. All text reaches the screen through it.
//!
//! A row sanitizes its texts here, so that no view can forget it.

use std::borrow::Cow;

use unicode_width::UnicodeWidthStr as _;

use crate::look::ThemeRole;
use holdpoint_text::Untrusted;

/// The widest piece, columns: wider than any screen that is drawn.
const PIECE_MAX: usize = 600;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Row {
    parts: Vec<(Cow<'static, str>, ThemeRole)>,
    width: usize,
}

/// Printable text without effects on a terminal, at most `width_max` columns wide.
#[must_use]
pub fn safe(text: &str, width_max: usize) -> String {
    // Most text is short and plain; the rest takes the slow path.
    if text.len() <= width_max && text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
        return text.to_owned();
    }
    Untrusted::new(text).display(width_max).into_string()
}

impl Row {
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A line of one piece.
    #[must_use]
    pub fn of(role: ThemeRole, text: &str) -> Self {
        Self::new().with(role, text)
    }

    #[must_use]
    pub fn with(mut self, role: ThemeRole, text: &str) -> Self {
        self.push(role, text);
        self
    }

    pub fn push(&mut self, role: ThemeRole, text: &str) {
        let text = safe(text, PIECE_MAX);
        self.width += text.width();
        self.parts.push((Cow::Owned(text), role));
    }

    /// Adds a piece that takes exactly `width` columns: cut with an ellipsis, or filled up with blanks.
    #[must_use]
    pub fn cell(mut self, role: ThemeRole, text: &str, width: usize) -> Self {
        let text = safe(text, width);
        let missing = width.saturating_sub(text.width());
        self.width += width;
        self.parts.push((Cow::Owned(text), role));
        self.blank(missing);
        self
    }

    /// As [`Row::cell`], with the text at the right.
    #[must_use]
    pub fn cell_right(mut self, role: ThemeRole, text: &str, width: usize) -> Self {
        let text = safe(text, width);
        let missing = width.saturating_sub(text.width());
        self.blank(missing);
        self.width += width;
        self.parts.push((Cow::Owned(text), role));
        self
    }

    fn blank(&mut self, columns: usize) {
        if columns > 0 {
            self.parts.push((Cow::Owned(" ".repeat(columns.min(PIECE_MAX))), ThemeRole::Text));
        }
    }

    /// Fills up with blanks to a column; existing text stays.
    #[must_use]
    pub fn to_column(mut self, column: usize) -> Self {
        let missing = column.saturating_sub(self.width);
        self.blank(missing);
        self.width += missing;
        self
    }

    /// Adds the pieces of another line.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.width += other.width;
        self.parts.extend(other.parts);
        self
    }

    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    pub fn parts(&self) -> impl Iterator<Item = (&str, ThemeRole)> {
        self.parts.iter().map(|(text, role)| (text.as_ref(), *role))
    }
}

/// Foreign text in lines of at most `width` columns, broken between words if it can be; at most `rows_max`. An ellipsis
/// ends a text that is longer.
#[must_use]
pub fn wrap(text: &str, width: usize, rows_max: usize) -> Vec<String> {
    if width == 0 || rows_max == 0 {
        return Vec::new();
    }
    // Invisible text is cut before it is measured.
    let safe = safe(text, width.saturating_mul(rows_max).min(holdpoint_text::WIDTH_MAX));
    let mut lines: Vec<String> =
        textwrap::wrap(&safe, width).into_iter().map(|line| self::safe(line.trim_end(), width)).collect();
    if lines.len() > rows_max {
        lines.truncate(rows_max);
        if let Some(last) = lines.last_mut() {
            *last = self::safe(&format!("{last}…"), width);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_keep_their_width_and_control_characters_are_escaped() {
        let row =
            Row::new().cell(ThemeRole::Text, "漢字漢字", 5).cell_right(ThemeRole::Text, "7", 3).to_column(12);
        let text: String = row.parts().map(|(text, _)| text).collect();
        assert_eq!(text.width(), 12, "{text:?}");
        assert_eq!(row.width(), 12);
        let hostile = Row::of(ThemeRole::Text, "a\u{1b}[2J\u{202e}b");
        assert!(hostile.parts().all(|(text, _)| !text.contains(['\u{1b}', '\u{202e}'])));
    }

    #[test]
    fn wrapping_is_bounded() {
        assert_eq!(wrap("one two three", 7, 9), ["one two", "three"]);
        assert!(wrap("one", 0, 9).is_empty());
        // The text was cut between words, and nothing told so.
        assert_eq!(wrap("one twofold three", 7, 2), ["one", "twofol…"]);
        assert_eq!(wrap(&"x".repeat(10_000), 10, 3).len(), 3);
    }
}
