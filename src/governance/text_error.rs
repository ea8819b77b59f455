//! Errors of submitted texts, and the one parser of such texts.
//!
//! Owns the shape of the message (file, line, field, value, what is allowed). Opens no file.

use std::borrow::Cow;

use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use serde::de::DeserializeOwned;

/// A refused text; none of its values is used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum TextError {
    /// More bytes than allowed; it was not parsed.
    #[error("{file}: {bytes} bytes are too many; up to {allowed} are allowed")]
    TooLarge { file: String, bytes: usize, allowed: usize },
    /// Not TOML, or a field is unknown, missing or of the wrong kind.
    #[error("{file}:{line}: {message}")]
    Syntax { file: String, line: usize, message: String },
    /// A field's value lies outside its range or its set.
    #[error(
        "{file}:{line}: the field {field:?} has the value {value:?}, which is not allowed; allowed: {allowed}"
    )]
    Value { file: String, line: usize, field: String, value: String, allowed: String },
}

impl Hint for TextError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::TooLarge { file, .. } | Self::Syntax { file, .. } => {
                ErrorDetails::of_file(ErrorReason::BadFile, file.as_str())
            }
            Self::Value { file, field, .. } => ErrorDetails::of_field(file.as_str(), field.as_str()),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            // The message says what is allowed.
            Self::TooLarge { .. } | Self::Syntax { .. } | Self::Value { .. } => None,
        }
    }
}

impl TextError {
    /// A value that is not allowed, with the line of its field.
    #[must_use]
    pub fn value(file: &str, text: &str, field: &str, value: &str, allowed: &str) -> Self {
        Self::Value {
            file: file.into(),
            line: line_of(text, field),
            field: field.into(),
            value: value.into(),
            allowed: allowed.into(),
        }
    }
}

/// The size from which a number is shown with its exponent.
const EXPONENT_FROM: f64 = 1e16;

/// A number as errors show it: a huge one with its exponent, not with hundreds of digits.
#[must_use]
pub fn number_text(value: f64) -> String {
    if value.abs() >= EXPONENT_FROM { format!("{value:e}") } else { value.to_string() }
}

/// Refuses a text over `bytes_max`, before anything looks into it.
///
/// # Errors
/// [`TextError::TooLarge`].
pub fn check_size(file: &str, text: &str, bytes_max: usize) -> Result<(), TextError> {
    if text.len() <= bytes_max {
        return Ok(());
    }
    Err(TextError::TooLarge { file: file.into(), bytes: text.len(), allowed: bytes_max })
}

/// Parses TOML into a value.
///
/// # Errors
/// [`TextError::Syntax`] with the line and the parser's words.
pub fn parse_toml<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, TextError> {
    toml::from_str(text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start.min(text.len()));
        let line = 1 + text.as_bytes().iter().take(start).filter(|byte| **byte == b'\n').count();
        TextError::Syntax { file: file.into(), line, message: error.message().to_owned() }
    })
}

/// The line (from 1) that sets `path`, or the nearest table above it; 1 if neither is found.
fn line_of(text: &str, path: &str) -> usize {
    let mut table = String::new();
    let mut best = (0, 1);
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let here = if let Some(name) = line.strip_prefix('[') {
            name.trim_matches(|c| c == '[' || c == ']' || c == ' ').clone_into(&mut table);
            table.clone()
        } else if let Some((key, _)) = line.split_once('=') {
            let key = key.trim();
            if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
        } else {
            continue;
        };
        let above = path == here || path.strip_prefix(&here).is_some_and(|rest| rest.starts_with('.'));
        if above && here.len() > best.0 {
            best = (here.len(), index + 1);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_huge_number_is_short() {
        let texts = [1e308, -1e16, 1e15, 0.25, f64::INFINITY, f64::NAN].map(number_text);
        assert_eq!(texts, ["1e308", "-1e16", "1000000000000000", "0.25", "inf", "NaN"]);
    }

    #[test]
    fn lines_are_found_by_path() {
        let text = "name = \"x\"\n[a.b]\nc = 1\n[a]\nd.e = 2\n";
        for (path, line) in [("name", 1), ("a.b.c", 3), ("a.b.z", 2), ("a.d.e", 5), ("q", 1)] {
            assert_eq!(line_of(text, path), line, "{path}");
        }
    }
}
