//! `holdpoint profile show | check | allow`: the numbers a profile holds candidates to and why, and an administrator's
//! authorization of a change of the profile that a store is used under.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use super::chosen::{AskedProfile, AskedProfileParser, chosen, read};
use super::decide::{parse_identity, parse_reason};
use super::output::Table;
use super::passphrase;
use super::prune::{take_store, wall_ms};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::{RulesChange, SignedProfileAct};
use holdpoint_engine::caller;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::loosened::{Before, Loosened, Rules, told};
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName, ReasonedNumber, SiteName, titled};
use holdpoint_registry::allow_profile;
use holdpoint_text::Untrusted;

/// The arguments of `profile`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint profile show human
  holdpoint profile check profiles/human.toml
  holdpoint profile allow sim --by admin --reason 'the cell is taken apart'")]
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
    /// Has an administrator sign that the next engine may use the store under a changed profile.
    #[command(after_help = "\
Under `real` and `human` no profile comes into force by an option alone where
the store was used under another one, or where a field is looser than in the
profile of that class that comes with the program. Shows the fields that get
looser, then signs; the authorization is on record with them, and counts for
the start right after it. No engine may have the store meanwhile. Where it is,
or was, used under `human` the administrator's key needs a passphrase.

Without PROFILE it is the one that the store was last used under, as this
program has it: an update of the program may change it.

Examples:
  holdpoint profile allow --by admin --reason 'version 0.2, read and tried'
  holdpoint profile allow line-4.toml --by admin --reason 'a longer timeout'
  holdpoint profile allow sim --by admin --reason 'the cell is taken apart'")]
    Allow(AllowArgs),
}

/// The arguments of `profile allow`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct AllowArgs {
    /// The profile: one that comes with the program, one of the store's, or a file [default: the last one].
    #[arg(value_name = "NAME|FILE", value_parser = AskedProfileParser, hide_possible_values = true)]
    profile: Option<AskedProfile>,
    /// The administrator who signs.
    #[arg(long, value_name = "ADMIN", value_parser = parse_identity)]
    by: String,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    reason: Untrusted,
    /// Takes the passphrase of the administrator's key from this file (mode 0600) and not from the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` names one as well.
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
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
    /// What is looser than in the profile of its class that comes with the program, and takes an authorization.
    loosened: Vec<Loosened>,
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
            let loosened = Rules::of(&profile, &table).map_err(CliError::internal)?.loosened(Before::Nothing);
            let checked = ProfileCheck {
                name: profile.name,
                site: profile.site,
                digest,
                policy: table.digest,
                numbers,
                loosened,
            };
            out.answer(&checked, |out| print_check(&checked, out))?;
        }
        ProfileVerb::Allow(args) => allow(context, args, out)?,
    }
    Ok(Exit::Confirmed)
}

/// An authorization that was put on record.
#[derive(Serialize)]
struct Authorization<'a> {
    allowed: ProfileName,
    site: Option<SiteName>,
    by: &'a str,
    from: Option<Digest>,
    to: Digest,
    loosened: &'a [Loosened],
}

/// Shows what gets looser under a profile, and puts an administrator's authorization of it on record.
fn allow(context: &CliContext, args: &AllowArgs, out: &mut Output<'_>) -> Result<(), CliError> {
    let (profile, table) = rules(&chosen(&context.data, args.profile.as_ref())?)?;
    let (class, title) = (profile.name, titled(profile.name, profile.site.as_ref()));
    let store = take_store(&context.data)?;
    let course = &store.opening().profiles;
    let rules = course.next(&Rules::of(&profile, &table).map_err(CliError::internal)?, false);
    if !course.needs(class, &rules) {
        return Err(CliError::usage(format!("the profile {title} takes no authorization here"))
            .with_hint("start with it: `--profile` is enough"));
    }
    // A store of an earlier version gets its first administrator, as at a start.
    store.first_administrator(wall_ms()).map_err(CliError::usage)?;
    let views = store.views().map_err(CliError::usage)?;
    let (persons, head) = (views.persons().map_err(CliError::usage)?, views.head().map_err(CliError::usage)?);
    drop(views);
    let change = course.change_to(&rules);
    if !out.is_json() {
        show_change(&title, &change, out)?;
    }
    let signer = passphrase::unlock(passphrase::kept(context, &args.by)?, args.passphrase_file.as_deref())?;
    let end = (store.store_id(), head.hash);
    let signed = SignedProfileAct::by(&signer, (class, change.clone()), end, args.reason.raw())
        .map_err(CliError::internal)?;
    signed.check(&persons, class, head.hash).map_err(CliError::held)?;
    if [Some(class), course.last().map(|last| last.class)].contains(&Some(ProfileName::Human)) {
        signed.check_guarded(&persons).map_err(CliError::held)?;
    }
    let asks = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
    allow_profile(&store, class, (asks, signed), wall_ms()).map_err(CliError::usage)?;
    let RulesChange { from, loosened, to } = &change;
    let (by, from, to) = (args.by.as_str(), *from, *to);
    let allowed = Authorization { allowed: class, site: profile.site, by, from, to, loosened };
    out.answer(&allowed, |out| {
        out.line(&format!("the profile {title} is allowed by {by} for the start that is next"))
    })
}

/// What an administrator is about to sign.
fn show_change(title: &str, change: &RulesChange, out: &mut Output<'_>) -> Result<(), CliError> {
    let RulesChange { from, loosened, to } = change;
    let from = from.map_or_else(|| "none on record".to_owned(), |from| from.to_string());
    out.line(&format!("profile {title}, rules {to}, before {from}"))?;
    if loosened.is_empty() {
        return out.line("no field is looser");
    }
    out.line(&format!("looser: {}", loosened.len()))?;
    let mut table = Table::new(&["field", "before", "shipped", "now"]);
    for Loosened { before, field, now, shipped } in loosened {
        table
            .row([field, before, shipped, now].map(|text| Untrusted::new(text.clone()).line().into_string()));
    }
    out.table(&table)
}

fn rules(chosen: &ChosenProfile) -> Result<(Profile, PolicyTable), CliError> {
    chosen.rules().map_err(CliError::internal)
}

fn print_check(checked: &ProfileCheck, out: &mut Output<'_>) -> Result<(), CliError> {
    let title = titled(checked.name, checked.site.as_ref());
    out.line(&format!("the profile {title} is well formed, digest {}", checked.digest))?;
    out.line(&format!("its policies compile, digest {}", checked.policy))?;
    if !checked.loosened.is_empty() {
        let told = told(&checked.loosened);
        out.line(&format!("{told}; an administrator has to sign that: `holdpoint profile allow`"))?;
    }
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
