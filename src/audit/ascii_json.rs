//! JSON with everything but printable ASCII as `\u` escapes, so that a line is safe on a terminal.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::Formatter;

/// Writes a value.
///
/// # Errors
/// If it has no JSON form, or cannot be written.
pub fn write_ascii_json(out: impl Write, value: &impl Serialize) -> serde_json::Result<()> {
    value.serialize(&mut serde_json::Serializer::with_formatter(out, AsciiFormatter))
}

/// A value's text.
///
/// # Errors
/// If it has no JSON form.
pub fn ascii_json(value: &impl Serialize) -> serde_json::Result<String> {
    let mut text = Vec::new();
    write_ascii_json(&mut text, value)?;
    String::from_utf8(text).map_err(serde::ser::Error::custom)
}

struct AsciiFormatter;

impl Formatter for AsciiFormatter {
    fn write_string_fragment<W: ?Sized + Write>(&mut self, out: &mut W, fragment: &str) -> io::Result<()> {
        let is_plain = |character: char| matches!(character, ' '..='~');
        for piece in fragment.split_inclusive(|character| !is_plain(character)) {
            let last = piece.chars().next_back().filter(|character| !is_plain(*character));
            let plain = piece.len() - last.map_or(0, char::len_utf8);
            out.write_all(&piece.as_bytes()[..plain])?;
            for unit in last.iter().flat_map(|last| last.encode_utf16(&mut [0; 2]).to_vec()) {
                write!(out, "\\u{unit:04x}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escaped_json_keeps_its_value() {
        for value in ["plain", "\u{9b}31m", "\u{202e}evil", "é", "😀", "\u{7f}", "\u{1b}[2J"] {
            let text = ascii_json(&value).unwrap();
            assert!(text.bytes().all(|b| (b' '..=b'~').contains(&b)), "{text}");
            assert_eq!(serde_json::from_str::<String>(&text).unwrap(), value);
        }
    }
}
