//! A line of text that is being typed, of bounded length.

use tui_input::{Input, InputRequest};

/// The longest line, characters.
pub const LINE_MAX: usize = 512;

/// A line and its cursor.
#[derive(Clone, Debug, Default)]
pub struct EditLine {
    input: Input,
}

impl PartialEq for EditLine {
    fn eq(&self, other: &Self) -> bool {
        self.input.value() == other.input.value() && self.input.cursor() == other.input.cursor()
    }
}

impl EditLine {
    /// A line with this text, the cursor at its end.
    #[must_use]
    pub fn new(text: &str) -> Self {
        Self { input: Input::new(text.chars().take(LINE_MAX).collect()) }
    }

    #[must_use]
    pub fn text(&self) -> &str {
        self.input.value()
    }

    /// The cursor, in characters from the start.
    #[must_use]
    pub fn cursor(&self) -> usize {
        self.input.cursor()
    }

    /// Types one character; control characters are ignored.
    pub fn insert(&mut self, typed: char) {
        if !typed.is_control() && self.text().chars().count() < LINE_MAX {
            self.input.handle(InputRequest::InsertChar(typed));
        }
    }

    /// Types pasted text; line ends become spaces, and text without room is dropped.
    pub fn paste(&mut self, text: &str) {
        for typed in text.trim_end_matches(['\r', '\n']).chars() {
            self.insert(if matches!(typed, '\r' | '\n' | '\t') { ' ' } else { typed });
        }
    }

    pub fn edit(&mut self, request: InputRequest) {
        self.input.handle(request);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edit_line_is_bounded_and_drops_control_characters() {
        let mut line = EditLine::new("ab");
        line.insert('\u{1b}');
        line.paste("c\nd\u{7}\r\n");
        assert_eq!(line.text(), "abc d");
        line.paste(&"x".repeat(2 * LINE_MAX));
        assert_eq!(line.text().chars().count(), LINE_MAX);
    }
}
