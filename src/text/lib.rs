//! Foreign text: everything that people, manifests, bundles or files wrote.
//!
//! An [`Untrusted`] value cannot be printed: it has no `Display`, and its `Debug` is sanitized. Only the sanitizer
//! here makes a [`SafeText`], which may reach a widget, log, title, table or error. It shows as `\u{..}` what a terminal
//! would act on or a reader would not see: control characters (C0, C1, DEL), bidirectional overrides, tag and
//! zero-width characters, unusual spaces, private and unassigned code points. It also bounds the width in columns and
//! the bytes of one grapheme, as a pile of accents makes one huge cell.
//!
//! An error keeps what would help ([`Hint`]) apart from its message, because messages quote foreign text. Programs get
//! the error's details ([`ErrorDetails`]) instead of the message.
//!
//! What this module must not do: judge whether text is honest. Look-alike letters stay; ids and digests are
//! compared, never read.

mod error_reason;
pub mod file;
pub mod hex;
mod hint;
mod sanitize;
pub mod users;

use std::fmt;

use serde::{Deserialize, Serialize};

pub use error_reason::{ErrorDetails, ErrorReason, FilePlace};
pub use hint::{Hint, Problem};
pub use sanitize::{GRAPHEME_BYTES_MAX, WIDTH_MAX, escape_json, is_visible, sanitize};

/// The width, in columns, for errors, logs and other places without a width of their own.
pub const LINE_WIDTH_MAX: usize = 240;

/// Text from outside, kept as it came. Equal to another only byte by byte.
#[derive(Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Untrusted(String);

impl Untrusted {
    /// Wraps text from outside.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }

    /// The text as it came, for comparing, hashing and storing; never for showing.
    #[must_use]
    pub fn raw(&self) -> &str {
        &self.0
    }

    /// Whether a reader sees nothing of it (see [`is_visible`]).
    #[must_use]
    pub fn is_blank(&self) -> bool {
        !is_visible(&self.0)
    }

    /// The text on one line of at most `width_max` columns (see [`sanitize`]).
    #[must_use]
    pub fn display(&self, width_max: usize) -> SafeText {
        sanitize(&self.0, width_max)
    }

    /// The text on one line of at most [`LINE_WIDTH_MAX`] columns.
    #[must_use]
    pub fn line(&self) -> SafeText {
        self.display(LINE_WIDTH_MAX)
    }

    /// The text's own lines, at most `lines_max` of them; where some are left off the last one is `…`.
    #[must_use]
    pub fn lines(&self, width_max: usize, lines_max: usize) -> Vec<SafeText> {
        let mut shown: Vec<SafeText> =
            self.0.lines().take(lines_max).map(|line| sanitize(line, width_max)).collect();
        if let Some(last) = shown.last_mut()
            && self.0.lines().nth(lines_max).is_some()
        {
            *last = sanitize("…", width_max);
        }
        shown
    }
}

impl From<String> for Untrusted {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl From<&str> for Untrusted {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl fmt::Debug for Untrusted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\"", self.line())
    }
}

/// Sanitized text: printable characters on one line, of bounded width. Only the sanitizer makes it.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SafeText(String);

impl SafeText {
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The text as an owned string, for widgets that want one.
    #[must_use]
    pub fn into_string(self) -> String {
        self.0
    }

    /// Width in terminal columns.
    #[must_use]
    pub fn width(&self) -> usize {
        unicode_width::UnicodeWidthStr::width(self.0.as_str())
    }
}

impl AsRef<str> for SafeText {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

/// The longest reason that a hint repeats, bytes.
const PASTED_REASON_BYTES_MAX: usize = 200;

/// A text as one word of a shell's command line, quoted where needed: a hint then runs as pasted.
#[must_use]
pub fn shell_word(text: &str) -> String {
    let is_plain = |ch: char| ch.is_ascii_alphanumeric() || "@%+=:,./_-".contains(ch);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The options of a command that name a person and a reason, for a hint. A long reason is replaced by a short one.
#[must_use]
pub fn signing_options(by: &str, reason: &str) -> String {
    let reason = if reason.len() <= PASTED_REASON_BYTES_MAX { reason } else { "the same reason" };
    format!("--as {} --reason {}", shell_word(by), shell_word(reason))
}

impl fmt::Display for SafeText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_is_sanitized_and_serde_keeps_the_text() {
        let text = Untrusted::new("a\u{1b}[31m\u{202e}b");
        assert_eq!(format!("{text:?}"), r#""a\u{1b}[31m\u{202e}b""#);
        let json = serde_json::to_string(&text).unwrap();
        assert_eq!(serde_json::from_str::<Untrusted>(&json).unwrap(), text);
    }

    #[test]
    fn hints_quote_what_a_shell_would_split() {
        assert_eq!(signing_options("mara", "drops"), "--as mara --reason drops");
        assert_eq!(signing_options("mara", "it's wet; $HOME"), r"--as mara --reason 'it'\''s wet; $HOME'");
        assert_eq!(signing_options("mara", &"x".repeat(201)), "--as mara --reason 'the same reason'");
        assert_eq!(shell_word(""), "''");
    }

    #[test]
    fn lines_are_bounded() {
        let text = Untrusted::new("one\ntwo\u{7}\nthree\nfour");
        let shown = |lines_max| text.lines(80, lines_max).iter().map(ToString::to_string).collect::<Vec<_>>();
        assert_eq!(shown(4), ["one", r"two\u{7}", "three", "four"]);
        assert_eq!(shown(2), ["one", "…"]);
        assert!(shown(0).is_empty());
        assert!(Untrusted::new(" \n").is_blank());
    }

    #[test]
    fn invisible_text_is_blank() {
        let unseen = [
            "",
            " \t\n",
            "\u{200b}",
            "\u{200b}\u{200d}\u{feff} ",
            "\u{2060}",
            "\u{ad}",
            "\u{202e}",
            "\u{3164}",
            "\u{2800}",
            "\u{a0}\u{3000}",
            "\u{301}\u{301}",
            "\u{7}\u{1b}",
            "\u{e0041}",
            "\u{fe0f}",
        ];
        for text in unseen {
            assert!(Untrusted::new(text).is_blank() && !is_visible(text), "{text:?}");
        }
        for text in ["x", "\u{200b}ok\u{200b}", "é", "漢", "."] {
            assert!(is_visible(text), "{text:?}");
        }
    }
}
