//! `holdpoint completions`: prints a completion script.

use clap::{Args, CommandFactory};
use clap_complete::Shell;
use serde::Serialize;

use super::{Cli, CliError, Exit, Output};

/// The arguments of `completions`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint completions bash > ~/.local/share/bash-completion/completions/holdpoint
  holdpoint completions zsh > ~/.zfunc/_holdpoint")]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub shell: Shell,
}

#[derive(Serialize)]
struct Script {
    shell: String,
    script: String,
}

/// Prints the script.
///
/// # Errors
/// Where the output cannot be written.
pub fn run(args: &CompletionsArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "holdpoint", &mut script);
    let script = String::from_utf8(script).map_err(CliError::internal)?;
    let answer = Script { shell: args.shell.to_string(), script };
    // The script is this program's own text and must keep its lines.
    out.answer(&answer, |out| Ok(out.sink().write_all(answer.script.as_bytes())?))?;
    Ok(Exit::Confirmed)
}
