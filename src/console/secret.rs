//! A passphrase that is being typed: wiped when it is let go of, and never shown.

use holdpoint_approvals::PASSPHRASE_BYTES_MAX;
use zeroize::Zeroizing;

/// A line of which the screen shows one mark a character.
#[derive(Clone, PartialEq, Eq)]
pub struct SecretLine {
    text: Zeroizing<String>,
}

impl Default for SecretLine {
    /// Empty, with room from the start, so that no copy is left behind by growing.
    fn default() -> Self {
        Self { text: Zeroizing::new(String::with_capacity(PASSPHRASE_BYTES_MAX)) }
    }
}

impl std::fmt::Debug for SecretLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SecretLine(..)")
    }
}

impl SecretLine {
    /// Types one character; control characters are no text, and what does not fit is left out.
    pub fn insert(&mut self, typed: char) {
        if !typed.is_control() && self.text.len() + typed.len_utf8() <= PASSPHRASE_BYTES_MAX {
            self.text.push(typed);
        }
    }

    /// Types what was pasted, as from a store of passphrases, without its line end.
    pub fn paste(&mut self, text: &str) {
        for typed in text.trim_end_matches(['\r', '\n']).chars() {
            self.insert(typed);
        }
    }

    /// Takes the last character back.
    pub fn erase(&mut self) {
        self.text.pop();
    }

    /// How many characters were typed.
    #[must_use]
    pub fn len(&self) -> usize {
        self.text.chars().count()
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.text.is_empty()
    }

    /// What was typed; the line is empty then.
    pub fn take(&mut self) -> Zeroizing<String> {
        std::mem::take(self).text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_bounded_and_shows_nothing() {
        let mut line = SecretLine::default();
        line.paste("under the oak\r\n");
        line.insert('\u{1b}');
        line.insert('\u{e4}');
        line.erase();
        assert_eq!((line.len(), format!("{line:?}").as_str()), (13, "SecretLine(..)"));
        assert_eq!(line.take().as_str(), "under the oak");
        assert!(line.is_empty());
        line.paste(&"x".repeat(2 * PASSPHRASE_BYTES_MAX));
        assert_eq!(line.len(), PASSPHRASE_BYTES_MAX);
    }
}
