//! Theme files: roles with colors and modifiers, on top of the theme they inherit from.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

use ratatui::style::Modifier;
use serde::Deserialize;
use toml::Spanned;

use super::paint::{NAMES, Paint, ThemeColor};
use super::{Theme, ThemeRole, names};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_wording::console::shared;
use holdpoint_wording::console::theme as wording;

/// The largest theme file, bytes.
pub const FILE_BYTES_MAX: usize = 64 * 1024;

/// Reported problems of one file at most.
const PROBLEMS_MAX: usize = 8;

/// A problem with a theme.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ThemeError {
    /// No theme of that name.
    #[error("{}", wording::no_such_theme(.name, .allowed))]
    Unknown {
        name: String,
        /// The existing names.
        allowed: String,
    },
    /// An operator has more own themes than allowed.
    #[error("{}", wording::one_too_many(.name, .allowed))]
    TooMany {
        /// The first theme beyond the limit.
        name: String,
        /// The limit.
        allowed: usize,
    },
    /// A file with an error.
    #[error("{file}:{line}: {what}")]
    File {
        file: String,
        /// The line, from 1.
        line: usize,
        /// The key, its problem, and the allowed values; one line each.
        what: String,
    },
}

impl Hint for ThemeError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Unknown { .. } => ErrorReason::NotFound.into(),
            Self::TooMany { .. } => ErrorReason::BadFile.into(),
            Self::File { file, .. } => ErrorDetails::of_file(ErrorReason::BadFile, file.as_str()),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Unknown { .. } => Some(wording::THEME_LIST.into()),
            Self::TooMany { .. } | Self::File { .. } => None,
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThemeFile {
    inherits: Option<Spanned<String>>,
    #[serde(default)]
    roles: BTreeMap<Spanned<String>, ThemeEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThemeEntry {
    fg: Option<Spanned<ThemeValue>>,
    bg: Option<Spanned<ThemeValue>>,
    #[serde(default)]
    bold: bool,
    #[serde(default)]
    dim: bool,
    #[serde(default)]
    reverse: bool,
    #[serde(default)]
    underline: bool,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum ThemeValue {
    Number(u64),
    Text(String),
}

/// A theme from a file's text. A role that the file does not name looks as in the inherited theme.
///
/// # Errors
/// The first problem with file and line; further ones follow in its text.
pub fn parse(name: &str, file: &str, text: &str) -> Result<Theme, ThemeError> {
    let line = |range: &Range<usize>| {
        text.get(..range.start.min(text.len())).unwrap_or("").matches('\n').count() + 1
    };
    let fail = |line: usize, what: String| ThemeError::File { file: file.to_owned(), line, what };
    if text.len() > FILE_BYTES_MAX {
        return Err(fail(1, shared::file_too_large(text.len(), FILE_BYTES_MAX)));
    }
    let parsed: ThemeFile = toml::from_str(text)
        .map_err(|error| fail(line(&error.span().unwrap_or(0..0)), error.message().to_owned()))?;
    let mut theme = match &parsed.inherits {
        None => Theme::plain(name),
        Some(parent) => Theme::builtin(parent.get_ref()).map_err(|_| {
            let what = wording::no_builtin(parent.get_ref(), &names().join(", "));
            fail(line(&parent.span()), what)
        })?,
    };
    name.clone_into(&mut theme.name);
    let mut problems: Vec<(usize, String)> = Vec::new();
    for (role_name, entry) in &parsed.roles {
        let Some(role) = ThemeRole::parse(role_name.get_ref()) else {
            let allowed: Vec<&str> = ThemeRole::ALL.iter().map(|role| role.name()).collect();
            let what = wording::no_such_role(role_name.get_ref(), &allowed.join(", "));
            problems.push((line(&role_name.span()), what));
            continue;
        };
        match entry.paint() {
            Ok(paint) => theme.set(role, paint),
            Err((span, what)) => problems.push((line(&span), format!("roles.{}.{what}", role.name()))),
        }
    }
    problems.sort();
    problems.truncate(PROBLEMS_MAX);
    match problems.split_first() {
        None => Ok(theme),
        Some(((first, what), rest)) => {
            let more = rest.iter().map(|(line, what)| format!("\n{file}:{line}: {what}"));
            Err(fail(*first, std::iter::once(what.clone()).chain(more).collect()))
        }
    }
}

impl ThemeEntry {
    fn paint(&self) -> Result<Paint, (Range<usize>, String)> {
        let color = |key: &str, value: &Option<Spanned<ThemeValue>>| {
            let Some(value) = value else { return Ok(None) };
            let parsed = match value.get_ref() {
                ThemeValue::Text(text) if text == "default" => return Ok(None),
                ThemeValue::Text(text) => ThemeColor::parse(text),
                ThemeValue::Number(number) => u8::try_from(*number).ok().map(ThemeColor::Indexed),
            };
            let shown = match value.get_ref() {
                ThemeValue::Text(text) => format!("{text:?}"),
                ThemeValue::Number(number) => number.to_string(),
            };
            let what = wording::no_color(key, &shown, &NAMES.join(", "));
            parsed.map(Some).ok_or((value.span(), what))
        };
        let flags = [
            (self.bold, Modifier::BOLD),
            (self.dim, Modifier::DIM),
            (self.reverse, Modifier::REVERSED),
            (self.underline, Modifier::UNDERLINED),
        ];
        let on = flags.into_iter().filter_map(|(on, modifier)| on.then_some(modifier));
        let paint = Paint {
            foreground: color("fg", &self.fg)?,
            background: color("bg", &self.bg)?,
            modifiers: on.fold(Modifier::empty(), |all, one| all | one),
        };
        // On a terminal whose own colors are unknown, letters on a set background may be invisible.
        if paint.background.is_some() && paint.foreground.is_none() {
            let span = self.bg.as_ref().map_or(0..0, Spanned::span);
            return Err((span, wording::NEEDS_FOREGROUND.to_owned()));
        }
        Ok(paint)
    }
}
