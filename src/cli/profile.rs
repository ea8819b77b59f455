//! `holdpoint profile show | check`: the numbers a profile holds candidates to, and why.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use super::chosen::{AskedProfile, AskedProfileParser, chosen, read};
use super::output::Table;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName, ReasonedNumber, SiteName, titled};

/// The arguments of `profile`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint profile show human
  holdpoint profile check profiles/human.toml")]
pub struct ProfileArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: ProfileVerb,
}

/// What can be done with profiles.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ProfileVerb {
    /// Prints every number of a profile.
    #[command(after_help = "\
Example:
  holdpoint profile show human --json")]
    Show {
        /// The profile to print: one that comes with the program, one of the store's, or a file.
        #[arg(value_name = "NAME|FILE", value_parser = AskedProfileParser, hide_possible_values = true)]
        profile: AskedProfile,
    },
    /// Says whether a profile and the policies beside it can be meant, and why each number is what it is.
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
    /// Its class.
    name: ProfileName,
    /// Its own name; absent for a profile that comes with the program.
    site: Option<SiteName>,
    digest: Digest,
    policy: Digest,
    numbers: Vec<ReasonedNumber>,
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
pub fn run(context: &CliContext, args: &ProfileArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        ProfileVerb::Show { profile } => {
            let (profile, _) = rules(&chosen(&context.data, Some(profile))?)?;
            let digest = profile.digest().map_err(CliError::internal)?;
            out.answer(&ProfileRow { digest, profile: &profile }, |out| {
                out.line(&format!("digest {digest}"))?;
                print_fields(&serde_json::to_value(&profile).map_err(CliError::internal)?, out)
            })?;
        }
        ProfileVerb::Check { file } => {
            let chosen = read(file)?;
            let (profile, table) = rules(&chosen)?;
            let digest = profile.digest().map_err(CliError::internal)?;
            let numbers = chosen.numbers().map_err(CliError::internal)?;
            let checked = ProfileCheck {
                name: profile.name,
                site: profile.site,
                digest,
                policy: table.digest,
                numbers,
            };
            out.answer(&checked, |out| print_check(&checked, out))?;
        }
    }
    Ok(Exit::Confirmed)
}

fn rules(chosen: &ChosenProfile) -> Result<(Profile, PolicyTable), CliError> {
    chosen.rules().map_err(CliError::internal)
}

fn print_check(checked: &ProfileCheck, out: &mut Output<'_>) -> Result<(), CliError> {
    let title = titled(checked.name, checked.site.as_ref());
    out.line(&format!("the profile {title} is well formed, digest {}", checked.digest))?;
    out.line(&format!("its policies compile, digest {}", checked.policy))?;
    let mut table = Table::new(&["field", "value", "shipped", "reason"]);
    for number in &checked.numbers {
        let shipped = number.shipped.map_or_else(String::new, |shipped| shipped.to_string());
        let reason = number.reason.clone().unwrap_or_else(|| "none given".to_owned());
        table.row([number.path.clone(), number.value.to_string(), shipped, reason]);
    }
    out.table(&table)
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
