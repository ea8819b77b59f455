//! `holdpoint completions`: prints a completion script, which completes the store's versions and families too.
//!
//! clap writes the scripts from the command line's definition. For the name of a version or a family, the script
//! runs `completions --list versions` at each tab.

use std::path::Path;

use clap::builder::PossibleValuesParser;
use clap::{Arg, Args, Command, ValueEnum};
use clap_complete::Shell;
use serde::Serialize;

use super::data;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::ids::Family;
use holdpoint_registry::Views;
use holdpoint_store::Layout;

/// The arguments of `completions`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint completions bash > ~/.local/share/bash-completion/completions/holdpoint
  holdpoint completions zsh > ~/.zfunc/_holdpoint
  holdpoint completions fish > ~/.config/fish/completions/holdpoint.fish

In bash, zsh and fish the script also completes versions and families of the store, or of the
one that --data DIR on the line names.")]
pub struct CompletionsArgs {
    /// The shell to write the script for.
    #[arg(value_enum, required_unless_present = "list")]
    pub shell: Option<Shell>,
    /// Names that a script asks for at a tab: names in the store, one a line; none without a store.
    #[arg(long, hide = true, value_enum, value_name = "NAMES", conflicts_with = "shell")]
    pub list: Option<StoredNames>,
}

/// The kinds of names that a script can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StoredNames {
    /// Every version, as in `align@1.1.0`.
    Versions,
    /// Every family, as in `align`.
    Families,
    /// Families and versions together.
    Subjects,
}

impl StoredNames {
    /// The kind of name an argument takes, by its value name in the help.
    fn of(arg: &Arg) -> Option<Self> {
        if !arg.get_possible_values().is_empty() {
            return None;
        }
        match arg.get_value_names()?.first()?.as_str() {
            "FAMILY@VERSION" | "UPGRADE" => Some(Self::Versions),
            "FAMILY" => Some(Self::Families),
            "FAMILY[@VERSION]" | "FAMILY[@VERSION]|FOLDER" => Some(Self::Subjects),
            _ => None,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Versions => "versions",
            Self::Families => "families",
            Self::Subjects => "subjects",
        }
    }

    /// The placeholder in clap's script that [`script`] replaces with the call.
    const fn marker(self) -> &'static str {
        match self {
            Self::Versions => "holdpoint_stored_versions",
            Self::Families => "holdpoint_stored_families",
            Self::Subjects => "holdpoint_stored_subjects",
        }
    }
}

#[derive(Serialize)]
struct ShellScript {
    shell: String,
    script: String,
}

/// Prints the script, or the names that a script asks for.
///
/// # Errors
/// If the output cannot be written, or the store's folder is unknown.
pub fn run(
    program: Command,
    data: Option<&Path>,
    args: &CompletionsArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    if let Some(shell) = args.shell {
        let answer = ShellScript { shell: shell.to_string(), script: script(program, shell)? };
        // The script is this program's own text and keeps its lines.
        out.answer(&answer, |out| Ok(out.sink().write_all(answer.script.as_bytes())?))?;
    } else if let Some(names) = args.list {
        let names = stored(&data::folder(data)?, names);
        out.answer(&names, |out| names.iter().try_for_each(|name| out.line(name)))?;
    }
    Ok(Exit::Confirmed)
}

/// The names in a store; none if it cannot be read, because a tab cannot show an error.
fn stored(data: &Path, names: StoredNames) -> Vec<String> {
    let database = Layout::new(data).database();
    // Opening creates no store.
    let views = database.is_file().then(|| Views::open(&database).ok()).flatten();
    let Some(views) = views else { return Vec::new() };
    // A shell expands completions, so anything but a valid family name is left out.
    let families: Vec<Family> = views
        .families()
        .unwrap_or_default()
        .into_iter()
        .filter_map(|status| Family::new(status.name).ok())
        .collect();
    let versions = || {
        let of = |family| views.family_in_order(family).unwrap_or_default();
        families.iter().flat_map(of).map(|version| version.to_string())
    };
    let families = || families.iter().map(ToString::to_string);
    match names {
        StoredNames::Versions => versions().collect(),
        StoredNames::Families => families().collect(),
        StoredNames::Subjects => families().chain(versions()).collect(),
    }
}

/// The script for a shell.
fn script(program: Command, shell: Shell) -> Result<String, CliError> {
    let places = places(&program);
    let mut command = program;
    match shell {
        Shell::Bash | Shell::Zsh | Shell::Fish => command = marked(command),
        // Elvish and PowerShell complete only fixed words.
        _ => {}
    }
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, "holdpoint", &mut script);
    let script = String::from_utf8(script).map_err(CliError::internal)?;
    Ok(match shell {
        Shell::Bash => bash(script),
        Shell::Zsh => zsh(script),
        Shell::Fish => fish(script, places),
        _ => script,
    })
}

/// The command with a marker as the only value of each argument that takes a stored name.
fn marked(command: Command) -> Command {
    command
        .mut_args(|arg| match StoredNames::of(&arg) {
            Some(names) => arg.value_parser(PossibleValuesParser::new([names.marker()])),
            None => arg,
        })
        .mut_subcommands(marked)
}

fn with_calls(script: String, of: impl Fn(StoredNames) -> (String, String)) -> String {
    StoredNames::value_variants().iter().fold(script, |script, names| {
        let (marker, call) = of(*names);
        script.replace(&marker, &call)
    })
}

fn bash(script: String) -> String {
    let called =
        |names: StoredNames| (names.marker().to_owned(), format!("$(_holdpoint_stored {})", names.name()));
    let script =
        with_calls(script, called).replace("complete -F _holdpoint ", "complete -F _holdpoint_whole ");
    format!("{}\n{script}", include_str!("completions/stored.bash"))
}

fn zsh(script: String) -> String {
    let called =
        |names: StoredNames| (format!("({})", names.marker()), format!("_holdpoint_{}", names.name()));
    // The first line names the command that the file completes, and must stay first.
    let (first, rest) = script.split_once('\n').unwrap_or((&script, ""));
    let helpers = include_str!("completions/stored.zsh");
    with_calls(format!("{first}\n\n{helpers}{rest}"), called)
}

/// clap's script for fish completes only the values of options; this adds the positional arguments.
fn fish(script: String, places: Vec<NameArgument>) -> String {
    let called = |names: StoredNames| {
        (format!("{}\\t''", names.marker()), format!("(__holdpoint_stored {})", names.name()))
    };
    let mut script = format!("{}\n{}", include_str!("completions/stored.fish"), with_calls(script, called));
    for NameArgument { verbs, option, names, or_path } in places {
        let seen = match verbs.as_slice() {
            [verb] if option.is_none() => format!("__fish_holdpoint_using_subcommand {verb}"),
            [verb, inner] if option.is_none() => {
                format!("__fish_holdpoint_using_subcommand {verb}; and __fish_seen_subcommand_from {inner}")
            }
            _ => continue,
        };
        let files = if or_path { "" } else { " -f" };
        let call = format!("(__holdpoint_stored {})", names.name());
        script.push_str(&format!("complete -c holdpoint -n \"{seen}\"{files} -a \"{call}\"\n"));
    }
    script
}

/// An argument that takes a stored name.
struct NameArgument {
    verbs: Vec<String>,
    option: Option<String>,
    names: StoredNames,
    /// The argument may be a folder or a file, too.
    or_path: bool,
}

/// All such arguments, verb by verb.
fn places(command: &Command) -> Vec<NameArgument> {
    fn walk(command: &Command, verbs: &[String], found: &mut Vec<NameArgument>) {
        for arg in command.get_arguments() {
            let option = arg.get_long().map(str::to_owned);
            let named =
                |name: &str| arg.get_value_names().is_some_and(|names| names.iter().any(|one| one == name));
            let or_path = named("FAMILY[@VERSION]|FOLDER") || named("UPGRADE");
            found.extend(StoredNames::of(arg).map(|names| NameArgument {
                verbs: verbs.to_vec(),
                option,
                names,
                or_path,
            }));
        }
        for verb in command.get_subcommands() {
            let verbs: Vec<String> = verbs.iter().cloned().chain([verb.get_name().to_owned()]).collect();
            walk(verb, &verbs, found);
        }
    }
    let mut found = Vec::new();
    walk(command, &[], &mut found);
    found
}

#[cfg(test)]
mod tests;
