//! Whether the terminal's background is dark or light, if that is cheap to find out.
//!
//! Asks before keys are read, and never drops typed keys. The answer is optional: without it the default theme uses
//! the terminal's own colors.

use std::time::Duration;

use terminal_colorsaurus::{QueryOptions, ThemeMode, theme_mode};

/// How long the terminal has to answer: about half of the time to the first frame.
const ANSWER_MAX: Duration = Duration::from_millis(80);

/// Whether the background is light; absent if unknown. Input and output are a terminal when this is called.
#[must_use]
pub fn is_light() -> Option<bool> {
    let variable = std::env::var("COLORFGBG").ok();
    variable.as_deref().and_then(from_variable).or_else(query)
}

/// `COLORFGBG` is `foreground;background` in the sixteen colors; `default` says nothing.
fn from_variable(value: &str) -> Option<bool> {
    let background: u8 = value.rsplit(';').next()?.parse().ok()?;
    match background {
        7 | 9..=15 => Some(true),
        0..=6 | 8 => Some(false),
        _ => None,
    }
}

/// Asks the terminal, unless a key was already typed: the answer would be mixed with it.
fn query() -> Option<bool> {
    let typed = rustix::io::ioctl_fionread(rustix::stdio::stdin()).ok()?;
    if typed > 0 {
        return None;
    }
    let mut options = QueryOptions::default();
    options.timeout = ANSWER_MAX;
    theme_mode(options).ok().map(|mode| mode == ThemeMode::Light)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_is_read_from_the_variable() {
        for (value, light) in [
            ("15;0", Some(false)),
            ("0;15", Some(true)),
            ("0;default;15", Some(true)),
            ("12;8", Some(false)),
            ("0;7", Some(true)),
            ("0;default", None),
            ("0;200", None),
            ("", None),
        ] {
            assert_eq!(from_variable(value), light, "{value:?}");
        }
    }
}
