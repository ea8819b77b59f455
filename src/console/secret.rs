//! A passphrase that is being typed: wiped when dropped, and never shown.

use holdpoint_approvals::{PASSPHRASE_BYTES_MAX, Passphrase};
use holdpoint_wording::console::form as wording;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use zeroize::Zeroizing;

/// A line whose characters appear as marks.
#[derive(Clone, PartialEq, Eq)]
pub struct SecretLine {
    text: Zeroizing<String>,
}

impl Default for SecretLine {
    /// Empty, with its full capacity from the start, so that growing leaves no copy behind.
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
    /// Types one character; control characters and characters without room are dropped.
    pub fn insert(&mut self, typed: char) {
        if !typed.is_control() && self.text.len() + typed.len_utf8() <= PASSPHRASE_BYTES_MAX {
            self.text.push(typed);
        }
    }

    /// Types a paste, such as from a password manager, without its line end.
    pub fn paste(&mut self, text: &str) {
        for typed in text.trim_end_matches(['\r', '\n']).chars() {
            self.insert(typed);
        }
    }

    /// Deletes the last character.
    pub fn erase(&mut self) {
        self.text.pop();
    }

    /// The number of typed characters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.text.chars().count()
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.text.is_empty()
    }

    /// Takes the typed text; the line is then empty.
    pub fn take(&mut self) -> Zeroizing<String> {
        std::mem::take(self).text
    }
}

/// A decision that waits for its passphrase. It is made only when the passphrase is complete, from the state then.
#[derive(Clone, Debug, PartialEq)]
pub struct Signing<W> {
    /// The decision to sign.
    pub what: W,
    pub secret: SecretLine,
    /// The id of the request that contains it, until the engine has answered.
    pub request_id: Option<String>,
    /// Why the last attempt did not sign.
    pub problem: Option<String>,
    /// Why the decision changed: it is not signed.
    is_stale: bool,
}

/// The passphrase entry of a decision, whatever the decision is.
pub trait PassphraseEntry {
    /// Whether the passphrase is being checked: no key is text meanwhile, and stopping must work.
    fn is_checked(&self) -> bool;

    /// Whether it waits for the answer to this request.
    fn waits_for(&self, id: &str) -> bool;

    /// The passphrase opened no key: it can be typed again.
    fn failed(&mut self, text: String);
}

/// The meaning of a key while a passphrase is typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SigningKey {
    /// None, or a character of the passphrase.
    Typed,
    /// To sign now.
    Sign,
    /// Back to the decision.
    Back,
    /// To take it back, while the passphrase is checked.
    Away,
}

impl<W> Signing<W> {
    #[must_use]
    pub fn of(what: W) -> Self {
        Self { what, secret: SecretLine::default(), request_id: None, problem: None, is_stale: false }
    }

    /// Enter signs, Esc leads back, and nothing else is a key.
    pub fn key(&mut self, key: KeyEvent) -> SigningKey {
        let chord = key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT);
        match key.code {
            KeyCode::Esc if self.request_id.is_some() => return SigningKey::Away,
            KeyCode::Esc => return SigningKey::Back,
            // Already sent.
            _ if self.request_id.is_some() || self.is_stale => {}
            KeyCode::Enter if !self.secret.is_empty() => return SigningKey::Sign,
            KeyCode::Enter => self.problem = Some(wording::TYPE_THE_PASSPHRASE.to_owned()),
            KeyCode::Backspace => self.secret.erase(),
            KeyCode::Char('u') if chord => drop(self.secret.take()),
            KeyCode::Char(typed) if !chord => self.secret.insert(typed),
            _ => {}
        }
        SigningKey::Typed
    }

    /// The decision has changed: the typed text is wiped, further typing goes nowhere, and only Esc is a key.
    pub fn go_stale(&mut self, why: &str) {
        if self.request_id.is_none() {
            drop(self.secret.take());
            self.is_stale = true;
            self.problem = Some(why.to_owned());
        }
    }

    /// Types a paste, unless the request was already sent.
    pub fn paste(&mut self, text: &str) {
        if self.request_id.is_none() && !self.is_stale {
            self.secret.paste(text);
        }
    }

    /// Takes the typed text for the request `id`.
    pub fn take_passphrase(&mut self, id: &str) -> Option<Passphrase> {
        self.request_id = Some(id.to_owned());
        self.problem = None;
        Passphrase::new(self.secret.take()).ok()
    }
}

impl<W> PassphraseEntry for Signing<W> {
    fn is_checked(&self) -> bool {
        self.request_id.is_some()
    }

    fn waits_for(&self, id: &str) -> bool {
        self.request_id.as_deref() == Some(id)
    }

    fn failed(&mut self, text: String) {
        self.request_id = None;
        self.problem = Some(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secret_line_is_bounded_and_prints_no_secret() {
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
