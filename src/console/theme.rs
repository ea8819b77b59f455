//! Colors, named only here: themes by role, and the look of each role at each color depth.
//!
//! Must not know what is drawn, or read files and the environment; the caller passes texts.

mod file;
mod paint;
mod role;
pub mod state_mark;
mod themes;

use std::collections::BTreeMap;

use ratatui::style::Style;

pub use file::{FILE_BYTES_MAX, ThemeError};
pub use paint::{Paint, ThemeColor, escape};
pub use role::ThemeRole;
pub use state_mark::StateMark;
pub use themes::{OWN_MAX, Themes};

/// How many colors a terminal shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ColorDepth {
    /// None: bold, dim, reverse and underline alone.
    Mono,
    /// The sixteen of every terminal.
    Ansi16,
    /// The 256 of an indexed palette.
    Indexed256,
    True,
}

impl ColorDepth {
    pub const ALL: [Self; 4] = [Self::Mono, Self::Ansi16, Self::Indexed256, Self::True];

    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Mono => "mono",
            Self::Ansi16 => "16 colors",
            Self::Indexed256 => "256 colors",
            Self::True => "true color",
        }
    }
}

/// The default theme, unless the background is known to be light.
pub const DEFAULT: &str = "calm-dark";

/// The default theme on a light background.
pub const DEFAULT_LIGHT: &str = "calm-light";

const BUILTIN: [(&str, &str); 5] = [
    ("calm-dark", include_str!("../../themes/calm-dark.toml")),
    ("calm-light", include_str!("../../themes/calm-light.toml")),
    ("mono", include_str!("../../themes/mono.toml")),
    ("high-contrast", include_str!("../../themes/high-contrast.toml")),
    ("deuteranopia", include_str!("../../themes/deuteranopia.toml")),
];

/// Names of the built-in themes, the default one first.
#[must_use]
pub fn names() -> Vec<&'static str> {
    BUILTIN.iter().map(|(name, _)| *name).collect()
}

/// A look for every role.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Theme {
    name: String,
    paints: BTreeMap<ThemeRole, Paint>,
}

impl Theme {
    /// The terminal's own text for every role.
    fn plain(name: &str) -> Self {
        Self { name: name.to_owned(), paints: BTreeMap::new() }
    }

    /// A built-in theme.
    ///
    /// # Errors
    /// [`ThemeError::Unknown`], or the problem of its text.
    pub fn builtin(name: &str) -> Result<Self, ThemeError> {
        let unknown = || ThemeError::Unknown { name: name.to_owned(), allowed: names().join(", ") };
        let (_, text) = BUILTIN.iter().find(|(known, _)| *known == name).ok_or_else(unknown)?;
        file::parse(name, &format!("themes/{name}.toml"), text)
    }

    /// A theme from a file's text; `name` is the file's name, with or without folder and extension.
    ///
    /// # Errors
    /// [`ThemeError::File`] with file, line, key and the allowed values.
    pub fn with_file(name: &str, text: &str) -> Result<Self, ThemeError> {
        let stem = std::path::Path::new(name).file_stem().and_then(|stem| stem.to_str()).unwrap_or(name);
        file::parse(stem, name, text)
    }

    fn set(&mut self, role: ThemeRole, paint: Paint) {
        self.paints.insert(role, paint);
    }

    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How a role looks at a depth.
    #[must_use]
    pub fn style(&self, role: ThemeRole, depth: ColorDepth) -> Style {
        self.paints.get(&role).copied().unwrap_or_default().style(depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn builtin_themes_name_every_role() {
        for name in names() {
            let theme = Theme::builtin(name).unwrap();
            assert_eq!(theme.name(), name);
            let missing: Vec<_> =
                ThemeRole::ALL.iter().filter(|role| !theme.paints.contains_key(*role)).collect();
            assert!(missing.is_empty(), "{name}: {missing:?}");
        }
    }

    #[test]
    fn theme_problems_name_file_line_key_and_allowed_values() {
        let table = [
            (
                "inherits = \"none\"",
                1,
                "inherits: there is no built-in theme \"none\"; allowed are calm-dark",
            ),
            ("[roles]\nreddish = {}", 2, "there is no role \"reddish\"; allowed are text, muted"),
            (
                "[roles]\n\ntext = { fg = \"puce\" }",
                3,
                "roles.text.fg: \"puce\" is no color; allowed are default",
            ),
            ("[roles]\ntext = { fg = 256 }", 2, "roles.text.fg: 256 is no color"),
            ("[roles]\ntext = { bg = \"red\" }", 2, "roles.text.bg: a background needs a foreground"),
            ("[roles]\ntext = { blink = true }", 2, "unknown field `blink`"),
            ("colors = 1", 1, "unknown field `colors`"),
        ];
        for (text, line, what) in table {
            let error = Theme::with_file("/home/x/themes/mine.toml", text).unwrap_err().to_string();
            assert!(error.starts_with(&format!("/home/x/themes/mine.toml:{line}: ")), "{error}");
            assert!(error.contains(what), "{error}");
        }
        let long = "#".repeat(FILE_BYTES_MAX + 1);
        assert!(Theme::with_file("long", &long).unwrap_err().to_string().contains("65537 bytes"));
    }

    #[test]
    fn a_file_adds_to_what_it_inherits() {
        let text = "inherits = \"calm-dark\"\n[roles]\ncritical = { fg = \"#102030\", underline = true }";
        let theme = Theme::with_file("mine.toml", text).unwrap();
        let parent = Theme::builtin("calm-dark").unwrap();
        assert_eq!(theme.name(), "mine");
        assert_ne!(
            theme.style(ThemeRole::Critical, ColorDepth::True),
            parent.style(ThemeRole::Critical, ColorDepth::True)
        );
        assert_eq!(
            theme.style(ThemeRole::High, ColorDepth::True),
            parent.style(ThemeRole::High, ColorDepth::True)
        );
    }
}
