//! The clipboard, by OSC 52: the terminal copies, also over a remote connection.

use std::io;

use ratatui::crossterm::Command as _;
use ratatui::crossterm::clipboard::CopyToClipboard;

use super::{EffectOutcome, good};
use crate::run::screen::Screen;
use holdpoint_wording::console::effects as wording;

/// The most bytes of a copy: terminals accept 100,000 bytes of base64, which encodes three bytes in four.
pub const COPY_BYTES_MAX: usize = 74_994;

/// Copies text, cut to the terminals' limit. The terminal does not confirm it.
pub fn copy(screen: &mut Screen, text: &str) -> io::Result<EffectOutcome> {
    let copied = bounded(text);
    screen.send(sequence(copied)?.as_bytes())?;
    Ok(good(if copied.len() < text.len() {
        wording::copied_first(copied.len(), text.len())
    } else {
        wording::copied(text.len())
    }))
}

fn sequence(text: &str) -> io::Result<String> {
    let mut written = String::new();
    CopyToClipboard::to_clipboard_from(text).write_ansi(&mut written).map_err(io::Error::other)?;
    Ok(written)
}

fn bounded(text: &str) -> &str {
    let mut end = COPY_BYTES_MAX.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.get(..end).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_bounded_and_whole_letters() {
        assert_eq!(bounded("grasp@1.1.0"), "grasp@1.1.0");
        let long = format!("a{}", "é".repeat(COPY_BYTES_MAX));
        let copied = bounded(&long);
        assert_eq!(copied.len(), COPY_BYTES_MAX - 1);
        let sequence = sequence(copied).unwrap();
        let payload = sequence.len() - "\u{1b}]52;c;\u{1b}\\".len();
        assert!(payload <= 100_000 && sequence.starts_with("\u{1b}]52;c;"), "{}", sequence.len());
    }
}
