//! Numbers in description files: finite, or refused while parsing, so that the error carries the line.

use std::path::Path;

use holdpoint_text::file::read_text as read_file;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use crate::error::CellError;
use crate::rng::Stream;

/// The largest description file that is read, bytes.
const FILE_MAX_BYTES: u64 = 1 << 20;

/// A closed interval `[min, max]` of finite numbers, written as a two-element array.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "[f64; 2]")]
pub struct Range {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl Range {
    /// The interval of one value.
    #[must_use]
    pub const fn exactly(value: f64) -> Self {
        Self { min: value, max: value }
    }

    /// A uniform draw. Always takes one number from the stream.
    pub fn sample(&self, stream: &mut Stream) -> f64 {
        stream.uniform(self.min, self.max)
    }

    /// Both ends multiplied.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { min: self.min * factor, max: self.max * factor }
    }

    /// Both ends moved.
    #[must_use]
    pub fn shifted(&self, by: f64) -> Self {
        Self { min: self.min + by, max: self.max + by }
    }

    /// The interval widened about its middle.
    #[must_use]
    pub fn widened(&self, factor: f64) -> Self {
        let (middle, half) = (0.5 * (self.min + self.max), 0.5 * (self.max - self.min));
        Self { min: middle - factor * half, max: middle + factor * half }
    }
}

impl From<Range> for [f64; 2] {
    fn from(range: Range) -> Self {
        [range.min, range.max]
    }
}

impl<'de> Deserialize<'de> for Range {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let [min, max] = <[f64; 2]>::deserialize(deserializer)?;
        if !min.is_finite() || !max.is_finite() {
            return Err(D::Error::custom(format!("range \"[{min}, {max}]\" is not finite")));
        }
        if min > max {
            return Err(D::Error::custom(format!(
                "range \"[{min}, {max}]\" has its ends the wrong way round"
            )));
        }
        Ok(Self { min, max })
    }
}

/// Parses a TOML text strictly; the error names the file, the line and the column.
///
/// # Errors
/// [`CellError`] where the text is not of the type.
pub fn parse_toml<T: serde::de::DeserializeOwned>(file: &str, text: &str) -> Result<T, CellError> {
    toml::from_str(text).map_err(|error| {
        let line = error.span().map_or(1, |span| {
            1 + text.as_bytes().iter().take(span.start).filter(|byte| **byte == b'\n').count()
        });
        let source = text.lines().nth(line - 1).unwrap_or_default().trim();
        CellError::file(file, format!("line {line}, \"{source}\""), error.message().to_owned())
    })
}

/// Reads a description file.
///
/// # Errors
/// [`CellError::File`] if it cannot be read.
pub fn read_text(path: &Path) -> Result<String, CellError> {
    let name = path.display().to_string();
    let fail = |error: std::io::Error| CellError::file(&name, "file", format!("cannot be read: {error}"));
    read_file(path, FILE_MAX_BYTES).map_err(fail)
}
