//! A line of text that is being typed, of bounded length.

use tui_input::{Input, InputRequest};

/// The longest line, characters.
pub const LINE_MAX: usize = 512;

/// A line and its cursor.
#[derive(Clone, Debug, Default)]
pub struct EditLine {
    input: Input,
    /// Whether the text is an offer: the first typed character replaces it.
    is_offer: bool,
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
        Self { input: Input::new(text.chars().take(LINE_MAX).collect()), is_offer: false }
    }

    /// A line with an offered text: a key that edits keeps it, and a typed character replaces it.
    #[must_use]
    pub fn offer(text: &str) -> Self {
        Self { is_offer: true, ..Self::new(text) }
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
        if typed.is_control() {
            return;
        }
        if std::mem::take(&mut self.is_offer) {
            self.input.reset();
        }
        if self.text().chars().count() < LINE_MAX {
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
        self.is_offer = false;
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

    #[test]
    fn typed_text_replaces_an_offer_that_no_key_has_edited() {
        let mut line = EditLine::offer("30");
        line.insert('\n');
        assert_eq!(line.text(), "30");
        line.paste("45");
        assert_eq!(line.text(), "45");
        let mut edited = EditLine::offer("30");
        edited.edit(InputRequest::DeletePrevChar);
        edited.insert('5');
        assert_eq!(edited.text(), "35");
    }
}
