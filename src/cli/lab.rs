//! `holdpoint lab`: says how to start the laboratory, which is a program of its own.

use clap::Args;

use crate::error::CliError;
use holdpoint_text::shell_word;

/// The arguments of `lab`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(
    disable_help_flag = true,
    after_help = "\
Example:
  holdpoint lab pool show manifests/pool"
)]
pub struct LabArgs {
    /// What the laboratory shall do, in its own words.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "WORD")]
    pub words: Vec<String>,
}

impl LabArgs {
    /// The command that starts the laboratory with these words, or the verb that this program has for them.
    #[must_use]
    pub fn error(&self) -> CliError {
        let words: Vec<&str> = self.words.iter().map(String::as_str).collect();
        match words.as_slice() {
            ["metrics", ..] => CliError::usage("`metrics` is a verb of this program")
                .with_hint("`holdpoint metrics` computes them"),
            ["bench"] | ["bench", "--quick" | "--json", ..] => {
                CliError::usage("`bench` is a verb of this program")
                    .with_hint("`holdpoint bench` times the engine")
            }
            words => {
                let line = words.iter().fold(String::new(), |line, word| line + " " + &shell_word(word));
                CliError::usage("the laboratory is a program of its own, `holdpoint-lab`").with_hint(format!(
                    "in the sources, `cargo run --release -p holdpoint-lab --{line}` starts it"
                ))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Exit;

    #[test]
    fn the_hint_names_the_program_that_has_the_verb() {
        for (words, command) in [
            (&[][..], "`cargo run --release -p holdpoint-lab --`"),
            (&["experiment", "e2", "--out", "a b"], "-p holdpoint-lab -- experiment e2 --out 'a b'`"),
            (&["bench", "stats"], "`cargo run --release -p holdpoint-lab -- bench stats`"),
            (&["bench", "--quick"], "`holdpoint bench`"),
            (&["metrics", "--since", "24h"], "`holdpoint metrics`"),
        ] {
            let error = LabArgs { words: words.iter().map(ToString::to_string).collect() }.error();
            assert_eq!(error.exit(), Exit::Usage);
            assert!(error.hint().unwrap().raw().contains(command), "{words:?}: {:?}", error.hint());
        }
    }
}
