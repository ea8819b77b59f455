//! `holdpoint theme list | preview`: the themes, role by role and state by state.
//!
//! Needs no terminal. Prints styles on request or to a terminal; without them every state still has its sign and
//! word.

use std::fmt::Write as _;
use std::io::IsTerminal as _;

use clap::{Args, Subcommand, ValueEnum};
use serde::Serialize;

use super::settings::themes;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_console::look::{ColorChoice, ColorDepth, Look, LookOptions, ThemeRole};
use holdpoint_console::theme::{StateMark, Themes, escape};

/// The arguments of `theme`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint theme list
  holdpoint theme preview deuteranopia
  holdpoint theme preview --all --color always")]
pub struct ThemeArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: ThemeVerb,
}

/// The verbs of `theme`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ThemeVerb {
    /// Lists the built-in themes and your own.
    #[command(after_help = "\
Example:
  holdpoint theme list")]
    List,
    /// Prints every role and every state with sample, word and sign.
    #[command(after_help = "\
Examples:
  holdpoint theme preview high-contrast
  holdpoint theme preview --all --color always")]
    Preview {
        /// The theme [default: the one that fits this terminal].
        name: Option<String>,
        /// Shows all themes.
        #[arg(long, conflicts_with = "name")]
        all: bool,
        /// Whether to use colors.
        #[arg(long, value_enum, default_value_t = Color::Auto)]
        color: Color,
        /// Uses ASCII signs only.
        #[arg(long)]
        ascii: bool,
    },
}

/// Whether to use colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Color {
    /// As the terminal and `NO_COLOR` indicate.
    Auto,
    /// Always colors.
    Always,
    /// No colors.
    Never,
}

#[derive(Serialize)]
struct ThemeRow {
    name: String,
    default: bool,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`] with exit 2 for a theme that does not exist.
pub fn run(args: &ThemeArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let themes = themes()?;
    match &args.verb {
        ThemeVerb::List => list(&themes, out)?,
        ThemeVerb::Preview { name, all, color, ascii } => {
            let chosen: Vec<Option<String>> =
                if *all { themes.names().into_iter().map(Some).collect() } else { vec![name.clone()] };
            for theme in chosen {
                let look = look(theme, &themes, *color, *ascii)?;
                preview(&look, out)?;
            }
        }
    }
    Ok(Exit::Confirmed)
}

fn list(themes: &Themes, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    for (place, name) in themes.names().into_iter().enumerate() {
        let default = place == 0;
        out.answer(&ThemeRow { name: name.clone(), default }, |out| {
            out.line(&if default { format!("{name} (default)") } else { name.clone() })
        })?;
    }
    Ok(())
}

fn look(theme: Option<String>, themes: &Themes, color: Color, ascii: bool) -> Result<Look, CliError> {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let chosen = theme.map(|name| themes.get(&name)).transpose();
    let chosen = chosen.map_err(CliError::usage)?;
    let options = LookOptions {
        theme: None,
        color: match color {
            Color::Auto if !std::io::stdout().is_terminal() => ColorChoice::Never,
            Color::Auto => ColorChoice::Auto,
            Color::Always => ColorChoice::Always,
            Color::Never => ColorChoice::Never,
        },
        ascii,
        no_color: set("NO_COLOR").is_some(),
        term: set("TERM"),
        colorterm: set("COLORTERM"),
        light_background: None,
    };
    let look = Look::detect(&options).map_err(CliError::usage)?;
    Ok(chosen.map_or(look.clone(), |theme| look.with_theme(theme)))
}

fn preview(look: &Look, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    if out.is_json() {
        let roles: Vec<_> = ThemeRole::ALL.iter().map(|role| (role.name(), role.help())).collect();
        return out.json(&serde_json::json!({ "theme": look.theme().name(), "roles": roles }));
    }
    let mut text = format!("{} ({})\n", look.theme().name(), look.depth().label());
    let plain = look.depth() == ColorDepth::Mono && !std::io::stdout().is_terminal();
    let sample = |role: ThemeRole, label: &str| {
        if plain { label.to_owned() } else { format!("{}{label}\u{1b}[0m", escape(look.style(role))) }
    };
    for role in ThemeRole::ALL {
        let padded = format!("{:<14}", role.name());
        // Writing into a string cannot fail.
        let _ = writeln!(text, "  {}  {}", sample(*role, &padded), role.help());
    }
    for (kind, mark) in StateMark::samples() {
        let _ = writeln!(text, "  {kind:<12} {}", sample(mark.role, &look.mark_label(mark)));
    }
    text.push('\n');
    Ok(out.sink().write_all(text.as_bytes())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_console::theme::names;

    fn printed(verb: ThemeVerb) -> String {
        let mut bytes = Vec::new();
        run(&ThemeArgs { verb }, &mut CommandOutput::to(&mut bytes, false)).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    fn preview_of(all: bool, color: Color) -> String {
        printed(ThemeVerb::Preview { name: None, all, color, ascii: false })
    }

    #[test]
    fn every_theme_role_and_state_is_shown() {
        let list = printed(ThemeVerb::List);
        assert_eq!(list.lines().count(), names().len());
        let text = preview_of(true, Color::Never);
        for name in names() {
            assert!(text.contains(&format!("{name} (mono)")), "{name}");
        }
        for role in ThemeRole::ALL {
            assert!(text.contains(role.name()) && text.contains(role.help()), "{role:?}");
        }
        for (_, mark) in StateMark::samples() {
            assert!(text.contains(mark.label), "{mark:?}");
        }
    }

    #[test]
    fn only_requested_colors_are_written() {
        assert!(preview_of(false, Color::Always).contains("\u{1b}["));
        let never = printed(ThemeVerb::Preview {
            name: Some("high-contrast".to_owned()),
            all: false,
            color: Color::Never,
            ascii: true,
        });
        assert!(never.is_ascii() && !never.contains("\u{1b}[3"), "{never}");
    }

    #[test]
    fn an_unknown_theme_is_a_usage_error() {
        let verb = ThemeVerb::Preview {
            name: Some("loud".to_owned()),
            all: false,
            color: Color::Auto,
            ascii: false,
        };
        let error = run(&ThemeArgs { verb }, &mut CommandOutput::to(Vec::new(), false)).unwrap_err();
        assert_eq!(error.exit(), Exit::Usage);
        assert!(error.to_string().contains("\"loud\"") && error.to_string().contains("calm-dark"), "{error}");
    }
}
