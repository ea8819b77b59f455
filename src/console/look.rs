//! The look of the screen: theme, color depth and glyphs, chosen from values that the caller read.
//!
//! Must not read the environment or ask the terminal.

use ratatui::style::Style;
use serde::Deserialize;

use super::theme::{self, StateMark};
pub use super::theme::{ColorDepth, Theme, ThemeError, ThemeRole};

/// Which signs are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Glyphs {
    /// Lines, blocks, braille and the signs of [`Glyph`].
    Unicode,
    /// Letters and signs of ASCII alone.
    Ascii,
}

macro_rules! glyphs {
    ($($name:ident = $unicode:literal or $ascii:literal;)*) => {
        /// A sign, one column wide.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Glyph { $($name,)* }

        impl Glyph {
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// How it is drawn.
            #[must_use]
            pub const fn text(self, glyphs: Glyphs) -> &'static str {
                match (self, glyphs) {
                    $((Self::$name, Glyphs::Unicode) => $unicode,
                    (Self::$name, Glyphs::Ascii) => $ascii,)*
                }
            }
        }
    };
}

glyphs! {
    // States.
    Good = "✔" or "+";
    Bad = "✖" or "x";
    Running = "◌" or "~";
    Waiting = "◷" or "@";
    Warning = "⚠" or "!";
    Paused = "‖" or "=";
    Unknown = "?" or "?";
    Neutral = "•" or "-";
    Ahead = "·" or ".";
    Returned = "↩" or "r";
    Latched = "■" or "#";
    Marked = "★" or "M";
    // Alarms' priorities.
    Critical = "▲" or "^";
    High = "◆" or "*";
    Low = "●" or "o";
    // Profiles.
    Sim = "◇" or "%";
    Real = "◈" or "$";
    Human = "▣" or "&";
    // Lines and places.
    Horizontal = "─" or "-";
    Vertical = "│" or "|";
    Corner = "┌" or "+";
    CornerRight = "┐" or "+";
    CornerLow = "└" or "+";
    CornerLowRight = "┘" or "+";
    Here = "▸" or ">";
    Open = "▾" or "v";
    Closed = "▸" or ">";
    Up = "↑" or "^";
    Down = "↓" or "v";
    Arrow = "→" or ">";
    Ellipsis = "…" or "~";
    // Bars.
    Full = "█" or "#";
    Empty = "░" or ".";
    Limit = "┃" or "|";
    Cursor = "▏" or "_";
}

/// Whether colors are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ColorChoice {
    /// As the terminal and `NO_COLOR` say.
    #[default]
    Auto,
    /// Colors, whatever `NO_COLOR` says.
    Always,
    Never,
}

/// The inputs for choosing a look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LookOptions {
    /// The requested theme.
    pub theme: Option<String>,
    /// The requested use of colors.
    pub color: ColorChoice,
    /// Whether ASCII is requested.
    pub ascii: bool,
    /// Whether `NO_COLOR` is set and not empty.
    pub no_color: bool,
    /// The environment's `TERM`.
    pub term: Option<String>,
    /// The environment's `COLORTERM`.
    pub colorterm: Option<String>,
    /// Whether the background is light; absent if the terminal does not tell.
    pub light_background: Option<bool>,
}

/// How the screen looks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Look {
    theme: Theme,
    depth: ColorDepth,
    glyphs: Glyphs,
}

impl Look {
    /// A look of these parts.
    #[must_use]
    pub const fn new(theme: Theme, depth: ColorDepth, glyphs: Glyphs) -> Self {
        Self { theme, depth, glyphs }
    }

    /// The look for the requested options and the terminal.
    ///
    /// # Errors
    /// [`ThemeError`] if there is no such built-in theme.
    pub fn detect(options: &LookOptions) -> Result<Self, ThemeError> {
        let fitting =
            if options.light_background == Some(true) { theme::DEFAULT_LIGHT } else { theme::DEFAULT };
        let theme = Theme::builtin(options.theme.as_deref().unwrap_or(fitting))?;
        // The console of the Linux kernel has few glyphs of its own.
        let plain = matches!(options.term.as_deref(), Some("linux" | "vt100" | "vt220" | "dumb"));
        let glyphs = if options.ascii || plain { Glyphs::Ascii } else { Glyphs::Unicode };
        Ok(Self::new(theme, options.depth(), glyphs))
    }

    /// The same look in another theme.
    #[must_use]
    pub fn with_theme(&self, theme: Theme) -> Self {
        Self { theme, ..self.clone() }
    }

    /// The style of a role.
    #[must_use]
    pub fn style(&self, role: ThemeRole) -> Style {
        self.theme.style(role, self.depth)
    }

    #[must_use]
    pub const fn glyph(&self, glyph: Glyph) -> &'static str {
        glyph.text(self.glyphs)
    }

    /// A mark's sign and word, `✔ active`.
    #[must_use]
    pub fn mark_label(&self, mark: StateMark) -> String {
        format!("{} {}", self.glyph(mark.glyph), mark.label)
    }

    /// Whether ASCII alone is drawn.
    #[must_use]
    pub const fn ascii(&self) -> bool {
        matches!(self.glyphs, Glyphs::Ascii)
    }

    #[must_use]
    pub const fn theme(&self) -> &Theme {
        &self.theme
    }

    /// The color depth.
    #[must_use]
    pub const fn depth(&self) -> ColorDepth {
        self.depth
    }
}

impl LookOptions {
    /// Flags win over `NO_COLOR`, and `NO_COLOR` over the terminal's capabilities.
    fn depth(&self) -> ColorDepth {
        let term = self.term.as_deref().unwrap_or("");
        let capability = match self.colorterm.as_deref() {
            Some("truecolor" | "24bit") => ColorDepth::True,
            _ if term.ends_with("-direct") => ColorDepth::True,
            _ if term.contains("256color") => ColorDepth::Indexed256,
            _ if matches!(term, "" | "dumb" | "vt100" | "vt220") => ColorDepth::Mono,
            _ => ColorDepth::Ansi16,
        };
        match self.color {
            ColorChoice::Never => ColorDepth::Mono,
            ColorChoice::Always => capability.max(ColorDepth::Ansi16),
            ColorChoice::Auto if self.no_color => ColorDepth::Mono,
            ColorChoice::Auto => capability,
        }
    }
}

#[cfg(test)]
mod tests {
    use unicode_width::UnicodeWidthStr as _;

    use super::*;

    #[test]
    fn depth_follows_flags_then_no_color_then_the_terminal() {
        use ColorChoice::{Always, Auto, Never};
        let table = [
            (Auto, false, "xterm", None, ColorDepth::Ansi16),
            (Auto, false, "xterm-256color", None, ColorDepth::Indexed256),
            (Auto, false, "xterm-256color", Some("truecolor"), ColorDepth::True),
            (Auto, false, "xterm-direct", None, ColorDepth::True),
            (Auto, false, "dumb", None, ColorDepth::Mono),
            (Auto, false, "", None, ColorDepth::Mono),
            (Auto, true, "xterm-256color", Some("24bit"), ColorDepth::Mono),
            (Always, true, "xterm-256color", None, ColorDepth::Indexed256),
            (Always, false, "dumb", None, ColorDepth::Ansi16),
            (Never, false, "xterm-256color", Some("truecolor"), ColorDepth::Mono),
        ];
        for (color, no_color, term, colorterm, depth) in table {
            let options = LookOptions {
                color,
                no_color,
                term: Some(term.to_owned()),
                colorterm: colorterm.map(str::to_owned),
                ..LookOptions::default()
            };
            assert_eq!(Look::detect(&options).unwrap().depth(), depth, "{options:?}");
        }
    }

    #[test]
    fn the_background_chooses_a_theme_unless_options_name_one() {
        let light = LookOptions { light_background: Some(true), ..LookOptions::default() };
        assert_eq!(Look::detect(&light).unwrap().theme().name(), "calm-light");
        let mono = LookOptions { theme: Some("mono".to_owned()), ..light };
        assert_eq!(Look::detect(&mono).unwrap().theme().name(), "mono");
        let unknown = LookOptions { theme: Some("loud".to_owned()), ..mono };
        let error = Look::detect(&unknown).unwrap_err();
        assert!(
            matches!(&error, ThemeError::Unknown { name, allowed }
                if name == "loud" && allowed.starts_with("calm-dark, calm-light, mono")),
            "{error}"
        );
    }

    #[test]
    fn every_glyph_is_one_column_wide_and_has_an_ascii_form() {
        for glyph in Glyph::ALL {
            assert_eq!(glyph.text(Glyphs::Unicode).width(), 1, "{glyph:?}");
            let ascii = glyph.text(Glyphs::Ascii);
            assert!(ascii.len() == 1 && ascii.is_ascii(), "{glyph:?}");
        }
    }
}
