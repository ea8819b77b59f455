//! The console's settings: flags before the file, the file before the environment, the environment before the
//! defaults.
//!
//! Owns the settings file and the order of precedence. Must not look at a terminal.

use serde::Deserialize;

use super::look::ColorChoice;
use holdpoint_governance::TextError;
use holdpoint_governance::text_error;

/// The largest settings file, bytes.
pub const FILE_BYTES_MAX: usize = 64 * 1024;

/// What the command line says; what it leaves open the file says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CommandLineFlags {
    /// Nothing can be changed from this console.
    pub read_only: bool,
    pub operator: Option<String>,
    pub theme: Option<String>,
    pub color: Option<ColorChoice>,
    /// Letters and signs of ASCII alone.
    pub ascii: bool,
    pub mouse: bool,
    /// Begin without the tour.
    pub no_tour: bool,
}

/// The settings file: `config.toml`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsFile {
    pub theme: Option<String>,
    pub color: Option<ColorChoice>,
    /// Letters and signs of ASCII alone.
    pub ascii: Option<bool>,
    pub mouse: Option<bool>,
    /// Begin with the tour.
    pub tour: Option<bool>,
}

/// The settings in force.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Nothing can be changed from this console.
    pub read_only: bool,
    /// The operator's name; the console asks for it if absent.
    pub operator: Option<String>,
    /// The theme; by the terminal's background if absent.
    pub theme: Option<String>,
    /// Colors. Absent if neither flag nor file set them, so that `NO_COLOR` counts.
    pub color: Option<ColorChoice>,
    /// Letters and signs of ASCII alone.
    pub ascii: bool,
    pub mouse: bool,
    /// Begin with the tour.
    pub tour: bool,
}

impl SettingsFile {
    /// Reads the text of a settings file; `name` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file and line: a key that is not known, a value that is not allowed.
    pub fn parse(name: &str, text: &str) -> Result<Self, TextError> {
        text_error::check_size(name, text, FILE_BYTES_MAX)?;
        text_error::parse_toml(name, text)
    }
}

impl Options {
    /// Flags over the file over the defaults.
    #[must_use]
    pub fn new(flags: CommandLineFlags, file: SettingsFile) -> Self {
        Self {
            read_only: flags.read_only,
            operator: flags.operator,
            theme: flags.theme.or(file.theme),
            color: flags.color.or(file.color),
            ascii: flags.ascii || file.ascii.unwrap_or(false),
            mouse: flags.mouse || file.mouse.unwrap_or(false),
            tour: !flags.no_tour && file.tour.unwrap_or(true),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let text = "theme = \"dusk\"\ncolor = \"never\"\nascii = true\nmouse = true\ntour = false\n";
        let file = SettingsFile::parse("config.toml", text).unwrap();
        let by_file = Options::new(CommandLineFlags::default(), file.clone());
        assert_eq!((by_file.theme.as_deref(), by_file.color), (Some("dusk"), Some(ColorChoice::Never)));
        assert!(by_file.ascii && by_file.mouse && !by_file.tour && !by_file.read_only);
        let flags = CommandLineFlags {
            theme: Some("mono".to_owned()),
            color: Some(ColorChoice::Always),
            read_only: true,
            ..CommandLineFlags::default()
        };
        let by_flags = Options::new(flags, file);
        assert_eq!((by_flags.theme.as_deref(), by_flags.color), (Some("mono"), Some(ColorChoice::Always)));
        assert!(by_flags.read_only);
        let plain = Options::new(CommandLineFlags::default(), SettingsFile::default());
        assert_eq!((plain.theme, plain.color, plain.tour), (None, None, true));
        let quiet = Options::new(
            CommandLineFlags { no_tour: true, ..CommandLineFlags::default() },
            SettingsFile::default(),
        );
        assert!(!quiet.tour);
    }

    #[test]
    fn problems_name_file_line_and_key() {
        for (text, line, expected) in [
            ("ascii = true\ntheem = \"x\"", 2, "theem"),
            ("color = \"sometimes\"", 1, "sometimes"),
            ("\n\nmouse = 3", 3, "boolean"),
        ] {
            let error = SettingsFile::parse("config.toml", text).unwrap_err().to_string();
            assert!(error.contains(&format!("config.toml:{line}")) && error.contains(expected), "{error}");
        }
    }
}
