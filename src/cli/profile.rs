//! `holdpoint profile show | check`: the numbers a profile holds candidates to.

use std::io::Read as _;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use super::output::Table;
use super::run::ProfileArg;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::{PROFILE_BYTES_MAX, Profile, ProfileName};

/// The arguments of `profile`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint profile show human
  holdpoint profile check profiles/real.toml")]
pub struct ProfileArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: ProfileVerb,
}

/// What can be done with profiles.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ProfileVerb {
    /// Prints every number of a profile that comes with the program.
    #[command(after_help = "\
Example:
  holdpoint profile show human --json")]
    Show {
        /// The profile to print.
        #[arg(value_enum)]
        profile: ProfileArg,
    },
    /// Parses a profile file and says whether every number is within its range.
    #[command(after_help = "\
Example:
  holdpoint profile check profiles/real.toml")]
    Check {
        /// The profile file to check.
        file: PathBuf,
    },
}

#[derive(Serialize)]
struct ProfileCheck {
    name: ProfileName,
    digest: Digest,
}

#[derive(Serialize)]
struct ProfileRow<'a> {
    digest: Digest,
    profile: &'a Profile,
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub fn run(args: &ProfileArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        ProfileVerb::Show { profile } => {
            let profile = Profile::builtin((*profile).into()).map_err(CliError::internal)?;
            let digest = profile.digest().map_err(CliError::internal)?;
            out.answer(&ProfileRow { digest, profile: &profile }, |out| {
                out.line(&format!("digest {digest}"))?;
                print_fields(&serde_json::to_value(&profile).map_err(CliError::internal)?, out)
            })?;
        }
        ProfileVerb::Check { file } => {
            let name = file.display().to_string();
            let mut text = String::new();
            std::fs::File::open(file)
                .and_then(|file| file.take(PROFILE_BYTES_MAX as u64 + 1).read_to_string(&mut text))
                .map_err(|error| CliError::usage(format!("cannot read the profile {name:?}: {error}")))?;
            let profile = Profile::parse(&name, &text)?;
            let checked =
                ProfileCheck { name: profile.name, digest: profile.digest().map_err(CliError::internal)? };
            out.answer(&checked, |out| {
                out.line(&format!(
                    "the profile {} is well formed, digest {}",
                    checked.name.name(),
                    checked.digest
                ))
            })?;
        }
    }
    Ok(Exit::Confirmed)
}

/// Prints the leaves of a value, one `path value` a row.
pub(super) fn print_fields(value: &Value, out: &mut Output<'_>) -> Result<(), CliError> {
    fn walk(path: &str, value: &Value, table: &mut Table) {
        let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
        match value {
            Value::Object(map) if !map.is_empty() => {
                map.iter().for_each(|(key, value)| walk(&join(key), value, table));
            }
            Value::Array(values) if values.iter().any(Value::is_object) => {
                values.iter().enumerate().for_each(|(i, value)| walk(&join(&i.to_string()), value, table));
            }
            value => table.row([path.to_owned(), plain(value)]),
        }
    }
    let mut table = Table::new(&["field", "value"]);
    walk("", value, &mut table);
    out.table(&table)
}

/// A value for people: words without quotes, lists with commas.
pub(super) fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(plain).collect::<Vec<_>>().join(", "),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::Object(_) => value.to_string(),
    }
}
