//! `holdpoint man`: the manual pages, generated from the command line's definition.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_mangen::Man;
use serde::Serialize;

use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_wording::program::run::wrote_pages;

/// The arguments of `man`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint man > holdpoint.1
  holdpoint man --out ~/.local/share/man/man1")]
pub struct ManArgs {
    /// Writes one page for the program and one for each verb into this folder, and creates the folder if necessary
    /// [default: prints the program's page].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Serialize)]
struct ManPage {
    name: String,
    roff: String,
}

/// Prints the program's page, or writes all of them.
///
/// # Errors
/// If the folder or the output cannot be written.
pub fn run(program: Command, args: &ManArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.out {
        None => {
            let page = page(&built(program))?;
            // The page is this program's own text and keeps its lines.
            out.answer(&page, |out| Ok(out.sink().write_all(page.roff.as_bytes())?))?;
        }
        Some(folder) => {
            let names = write(program, folder)?;
            out.answer(&serde_json::json!({ "folder": folder, "pages": names }), |out| {
                out.line(&wrote_pages(names.len(), folder.display()))
            })?;
        }
    }
    Ok(Exit::Confirmed)
}

/// The command with the full names of its verbs; `help` needs no page.
fn built(program: Command) -> Command {
    let mut command = program.disable_help_subcommand(true);
    command.build();
    command
}

fn page(command: &Command) -> Result<ManPage, CliError> {
    let source = concat!("holdpoint ", env!("CARGO_PKG_VERSION"));
    let man = Man::new(command.clone()).source(source).manual("Holdpoint");
    let mut roff = Vec::new();
    man.render(&mut roff).map_err(CliError::internal)?;
    Ok(ManPage { name: man.get_filename(), roff: String::from_utf8(roff).map_err(CliError::internal)? })
}

/// Writes all pages; returns their names.
fn write(program: Command, folder: &Path) -> Result<Vec<String>, CliError> {
    fn walk(command: &Command, pages: &mut Vec<ManPage>) -> Result<(), CliError> {
        pages.push(page(command)?);
        command.get_subcommands().filter(|verb| !verb.is_hide_set()).try_for_each(|verb| walk(verb, pages))
    }
    let mut pages = Vec::new();
    walk(&built(program), &mut pages)?;
    let cannot = |error: std::io::Error| {
        CliError::usage(format!("cannot write into {folder:?}: {error}")).with_unwritable(folder, &error)
    };
    fs::create_dir_all(folder).map_err(cannot)?;
    for ManPage { name, roff } in &pages {
        File::create(folder.join(name))
            .and_then(|mut file| file.write_all(roff.as_bytes()))
            .map_err(cannot)?;
    }
    Ok(pages.into_iter().map(|page| page.name).collect())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn a_page_has_every_section_and_verb() {
        let mut bytes = Vec::new();
        run(Cli::command(), &ManArgs::default(), &mut CommandOutput::to(&mut bytes, false)).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        for heading in ["NAME", "SYNOPSIS", "OPTIONS", "SUBCOMMANDS", "VERSION"] {
            assert!(text.contains(&format!(".SH {heading}\n")), "{heading}");
        }
        for verb in built(Cli::command()).get_subcommands().filter(|verb| !verb.is_hide_set()) {
            assert!(
                text.contains(&format!("holdpoint\\-{}(1)", verb.get_name().replace('-', "\\-"))),
                "{verb}"
            );
        }
        assert!(!text.contains("holdpoint\\-help(1)"));
    }

    #[test]
    fn man_page_is_written_for_every_verb() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("man1");
        let names = write(Cli::command(), &folder).unwrap();
        for name in ["holdpoint.1", "holdpoint-run.1", "holdpoint-audit.1", "holdpoint-audit-verify.1"] {
            assert!(names.iter().any(|there| there == name), "{name} is not in {names:?}");
            let text = fs::read_to_string(folder.join(name)).unwrap();
            assert!(text.contains(".SH SYNOPSIS"), "{name}");
            assert!(
                text.contains(concat!("\"holdpoint ", env!("CARGO_PKG_VERSION"), "\" Holdpoint")),
                "{text}"
            );
        }
        assert_eq!(fs::read_dir(&folder).unwrap().count(), names.len());
        // Again over the existing pages, but not into a file.
        assert_eq!(write(Cli::command(), &folder).unwrap(), names);
        assert_eq!(write(Cli::command(), &folder.join("holdpoint.1")).unwrap_err().exit(), Exit::Usage);
    }
}
