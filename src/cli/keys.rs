//! `holdpoint keys`: the console's keys, as text, as JSON, or as the guide's table.
//!
//! Generated from the actions and the keymap in force, so it always matches the keys.

use clap::Args;
use serde::Serialize;

use super::console;
use super::output::TextTable;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_console::action::{Action, Scope};
use holdpoint_console::keymap::Keymap;
use holdpoint_wording::console::keymap::EFFECT_COLUMN;

/// The arguments of `keys`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint keys
  holdpoint keys --markdown

To change keys, edit $XDG_CONFIG_HOME/holdpoint/keys.toml (else ~/.config/holdpoint/keys.toml):
  unbind = [\"T\"]
  [keys]
  quit = [\"ctrl-q\"]")]
pub struct KeysArgs {
    /// Prints the default keys as the Markdown table of the guide.
    #[arg(long)]
    pub markdown: bool,
}

/// A row of the table.
#[derive(Serialize)]
struct KeyRow {
    action: &'static str,
    scope: &'static str,
    keys: Vec<String>,
    help: &'static str,
}

fn rows(keymap: &Keymap) -> Vec<KeyRow> {
    let of = |scope: Scope| Action::ALL.iter().copied().filter(move |action| action.scope() == scope);
    let row = |action: Action| KeyRow {
        action: action.name(),
        scope: action.scope().title(),
        keys: keymap.keys(action),
        help: action.help(),
    };
    Scope::ALL.into_iter().flat_map(of).map(row).collect()
}

/// The default keys as a Markdown table.
#[must_use]
pub fn markdown() -> String {
    let mut text = format!("| where | keys | action | {EFFECT_COLUMN} |\n| --- | --- | --- | --- |\n");
    for row in rows(&Keymap::default()) {
        // A bar would end the cell, and a backquote the code; no default key is either.
        let keys: Vec<String> = row.keys.iter().map(|key| format!("`{key}`")).collect();
        let keys = if keys.is_empty() { format!("`:{}`", row.action) } else { keys.join(" ") };
        text.push_str(&format!("| {} | {keys} | {} | {} |\n", row.scope, row.action, row.help));
    }
    text
}

/// Prints the keys.
///
/// # Errors
/// Every problem of the operator's keymap file; if the output cannot be written.
pub fn run(args: &KeysArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    if args.markdown {
        let text = markdown();
        // The table is this program's own text and keeps its lines.
        out.answer(&text, |out| Ok(out.sink().write_all(text.as_bytes())?))?;
        return Ok(Exit::Confirmed);
    }
    let rows = rows(&console::keymap()?);
    out.answer(&rows, |out| {
        let mut table = TextTable::new(&["where", "keys", "action", EFFECT_COLUMN]);
        for row in &rows {
            let keys = if row.keys.is_empty() { format!(":{}", row.action) } else { row.keys.join(" ") };
            table.row([row.scope, &keys, row.action, row.help]);
        }
        out.table(&table)
    })?;
    Ok(Exit::Confirmed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_action_has_a_row_with_its_key_and_command() {
        let text = markdown();
        assert_eq!(text.lines().count(), Action::ALL.len() + 2);
        for line in text.lines() {
            assert_eq!(line.matches('|').count(), 5, "{line}");
        }
        let prompt = Action::Approve.scope().title();
        assert!(text.contains(&format!("| {prompt} | `Y` | approve | Approve")), "{text}");
        assert!(text.contains("| `:demo` | demo |"), "{text}");
    }
}
