//! A passphrase that is being typed: wiped when it is let go of, and never shown.

use holdpoint_approvals::{PASSPHRASE_BYTES_MAX, Passphrase};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
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

/// Something that waits for its passphrase. It is made only when the passphrase was typed, of how things stand then.
#[derive(Clone, Debug, PartialEq)]
pub struct Signing<W> {
    /// What is about to be signed.
    pub what: W,
    pub secret: SecretLine,
    /// The request that it was handed over in, until the engine has answered.
    pub asked: Option<String>,
    /// Why the last try signed nothing.
    pub problem: Option<String>,
    /// What was to be signed is something else now: nothing is.
    is_stale: bool,
}

/// What a key meant while a passphrase was typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SigningKey {
    /// Nothing more, or a character of the passphrase.
    Typed,
    /// To sign now.
    Sign,
    /// Back to what is to be signed.
    Back,
    /// Away, once it was handed over.
    Away,
}

impl<W> Signing<W> {
    #[must_use]
    pub fn of(what: W) -> Self {
        Self { what, secret: SecretLine::default(), asked: None, problem: None, is_stale: false }
    }

    /// Enter signs, Esc leads back, and nothing else is a key.
    pub fn key(&mut self, key: KeyEvent) -> SigningKey {
        let chord = key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT);
        match key.code {
            KeyCode::Esc if self.asked.is_some() => return SigningKey::Away,
            KeyCode::Esc => return SigningKey::Back,
            // Handed over already.
            _ if self.asked.is_some() || self.is_stale => {}
            KeyCode::Enter if !self.secret.is_empty() => return SigningKey::Sign,
            KeyCode::Enter => self.problem = Some("type the passphrase first, or Esc".to_owned()),
            KeyCode::Backspace => self.secret.erase(),
            KeyCode::Char('u') if chord => drop(self.secret.take()),
            KeyCode::Char(typed) if !chord => self.secret.insert(typed),
            _ => {}
        }
        SigningKey::Typed
    }

    /// What was to be signed has changed: what was typed is wiped, what is typed goes nowhere, and only Esc is a key.
    pub fn go_stale(&mut self, why: &str) {
        if self.asked.is_none() {
            drop(self.secret.take());
            self.is_stale = true;
            self.problem = Some(why.to_owned());
        }
    }

    /// Types what was pasted, unless it was handed over already.
    pub fn paste(&mut self, text: &str) {
        if self.asked.is_none() && !self.is_stale {
            self.secret.paste(text);
        }
    }

    /// What was typed leaves for the request `id`.
    pub fn hand_over(&mut self, id: &str) -> Option<Passphrase> {
        self.asked = Some(id.to_owned());
        self.problem = None;
        Passphrase::new(self.secret.take()).ok()
    }

    /// Whether what was typed is being checked: no key is text meanwhile, and what stops has to work.
    #[must_use]
    pub const fn is_checked(&self) -> bool {
        self.asked.is_some()
    }

    /// Whether it waits for the answer to this request.
    #[must_use]
    pub fn waits_for(&self, id: &str) -> bool {
        self.asked.as_deref() == Some(id)
    }

    /// What was typed opened no key: it can be typed anew.
    pub fn failed(&mut self, text: String) {
        self.asked = None;
        self.problem = Some(text);
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
