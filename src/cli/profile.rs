//! `holdpoint profile show | check | allow`: a profile's limits with their reasons, and an administrator's
//! authorization of a change of the store's profile.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde::Serialize;
use serde_json::Value;

use super::decide::{parse_identity, parse_reason};
use super::output::TextTable;
use super::passphrase;
use super::profile_choice::{RequestedProfile, RequestedProfileParser, chosen, read};
use super::prune::{take_store, wall_ms};
use super::site_choice;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::{RulesChange, SignedProfileAct};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::{PolicyProblem, PolicyTable};
use holdpoint_governance::profile::fields::in_full;
use holdpoint_governance::profile::{Profile, ProfileName, ReasonedNumber, SiteName, titled};
use holdpoint_governance::profile_downgrade::{
    DowngradedField, PreviousProfile, ProfileRules, downgrade_summary,
};
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_record::caller;
use holdpoint_registry::allow_profile;
use holdpoint_text::{ErrorReason, Untrusted, shell_word};
use holdpoint_wording::program::profile as sentences;

/// The arguments of `profile`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint profile show human
  holdpoint profile check profiles/human.toml
  holdpoint profile allow sim --by admin --reason 'the cell is taken apart'")]
pub struct ProfileArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: ProfileVerb,
}

/// The verbs of `profile`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ProfileVerb {
    /// Prints every number of a profile.
    #[command(after_help = "\
Example:
  holdpoint profile show human --json")]
    Show {
        /// The profile to print: a built-in one, one of the store's, or a file.
        #[arg(value_name = "NAME|FILE", value_parser = RequestedProfileParser, hide_possible_values = true)]
        profile: RequestedProfile,
    },
    /// Validates a profile and its policies, and prints the reason for each number.
    #[command(after_help = "\
Example:
  holdpoint profile check profiles/real.toml")]
    Check {
        /// The profile file to check.
        file: PathBuf,
    },
    /// Signs, as an administrator, that the next engine may use the store under a changed profile.
    #[command(after_help = "\
Under `real` and `human` an option alone does not change the profile: if the
store was used under another profile, or if a field is less strict than in the
built-in profile of that class, the start needs an authorization. The verb
shows the fields that get less strict, signs, and records the authorization.
It counts only for the next start. No engine may have the store open. If the
store is or was used under `human`, the administrator's key needs a passphrase.

Without PROFILE the verb authorizes the profile that the store was last used
under, as this program has it: an update of the program may change it.

Examples:
  holdpoint profile allow --by admin --reason 'version 0.2, read and tried'
  holdpoint profile allow line-4.toml --by admin --reason 'a longer timeout'
  holdpoint profile allow sim --by admin --reason 'the cell is taken apart'")]
    Allow(AllowArgs),
}

/// The arguments of `profile allow`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct AllowArgs {
    /// The profile: a built-in one, one of the store's, or a file [default: the last one].
    #[arg(value_name = "NAME|FILE", value_parser = RequestedProfileParser, hide_possible_values = true)]
    profile: Option<RequestedProfile>,
    /// The administrator who signs.
    #[arg(long, value_name = "ADMIN", value_parser = parse_identity)]
    by: String,
    /// The reason; stored in the audit log.
    #[arg(long, value_name = "TEXT", value_parser = parse_reason)]
    reason: Untrusted,
    /// Reads the passphrase of the administrator's key from this file (mode 0600) instead of the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` can name the file, too.
    #[arg(long, value_name = "FILE")]
    passphrase_file: Option<PathBuf>,
}

#[derive(Serialize)]
struct ProfileCheck {
    /// Its class.
    name: ProfileName,
    /// Its own name; absent for a built-in profile.
    site: Option<SiteName>,
    digest: Digest,
    policy: Digest,
    /// Policies that cannot be evaluated, or have no effect.
    policy_problems: Vec<PolicyProblem>,
    numbers: Vec<ReasonedNumber>,
    /// Fields that are less strict than in the built-in profile of the class, and need an authorization.
    loosened: Vec<DowngradedField>,
}

#[derive(Serialize)]
struct ProfileRow {
    digest: Digest,
    /// With every number, also those that the digest leaves out.
    profile: Value,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &ProfileArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        ProfileVerb::Show { profile } => {
            let (profile, _) = rules(&chosen(&context.data, Some(profile))?)?;
            let digest = profile.digest().map_err(CliError::internal)?;
            let row = ProfileRow { digest, profile: in_full(&profile) };
            out.answer(&row, |out| {
                out.line(&format!("digest {digest}"))?;
                print_fields(&row.profile, out)
            })?;
        }
        ProfileVerb::Check { file } => {
            let chosen = read(file)?;
            site_choice::check_zones(&context.data, None, &|cell| chosen.unknown_zone(cell))?;
            let (profile, table) = rules(&chosen)?;
            let digest = profile.digest().map_err(CliError::internal)?;
            let numbers = chosen.numbers().map_err(CliError::internal)?;
            let loosened = ProfileRules::of(&profile, &table)
                .map_err(CliError::internal)?
                .downgraded_fields(PreviousProfile::Nothing);
            let checked = ProfileCheck {
                name: profile.name,
                site: profile.site,
                digest,
                policy: table.digest,
                policy_problems: chosen.policy_problems().map_err(CliError::internal)?,
                numbers,
                loosened,
            };
            out.answer(&checked, |out| print_check(&checked, file, out))?;
        }
        ProfileVerb::Allow(args) => allow(context, args, out)?,
    }
    Ok(Exit::Confirmed)
}

/// A recorded authorization.
#[derive(Serialize)]
struct ProfileAuthorization<'a> {
    allowed: ProfileName,
    site: Option<SiteName>,
    by: &'a str,
    from: Option<Digest>,
    to: Digest,
    loosened: &'a [DowngradedField],
}

/// Shows the fields that get less strict under a profile, and records an administrator's authorization.
fn allow(context: &CliContext, args: &AllowArgs, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let (profile, table) = rules(&chosen(&context.data, args.profile.as_ref())?)?;
    let (class, title) = (profile.name, titled(profile.name, profile.site.as_ref()));
    let store = take_store(&context.data)?;
    let course = &store.opening().profiles;
    let rules = course.next(&ProfileRules::of(&profile, &table).map_err(CliError::internal)?, false);
    if !course.needs(class, &rules) {
        return Err(CliError::usage(format!("the profile {title} needs no authorization here"))
            .with_hint("start with it: `--profile` is enough")
            .with_details(ErrorReason::NotNow));
    }
    // A store of an earlier version gets its first administrator, as at a start.
    store.first_administrator(wall_ms()).map_err(CliError::usage)?;
    let views = store.views().map_err(CliError::usage)?;
    let (persons, head) = (views.persons().map_err(CliError::usage)?, views.head().map_err(CliError::usage)?);
    drop(views);
    let change = course.change_to(&rules);
    if !out.is_json() {
        show_change(&title, &change, out)?;
        out.require_reader()?;
    }
    let signer =
        passphrase::unlock(passphrase::stored_identity(context, &args.by)?, args.passphrase_file.as_deref())?;
    let end = (store.store_id(), head.hash);
    let signed = SignedProfileAct::by(&signer, (class, change.clone()), end, args.reason.raw())
        .map_err(CliError::internal)?;
    signed.check(&persons, class, head.hash).map_err(CliError::from_engine_fault)?;
    if class.is_beside_people() || course.last().is_some_and(|last| last.class.is_beside_people()) {
        signed.check_guarded(&persons).map_err(CliError::from_engine_fault)?;
    }
    let requester = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
    allow_profile(&store, class, (requester, signed), wall_ms()).map_err(CliError::usage)?;
    let RulesChange { from, loosened, to } = &change;
    let (by, from, to) = (args.by.as_str(), *from, *to);
    let allowed = ProfileAuthorization { allowed: class, site: profile.site, by, from, to, loosened };
    out.answer(&allowed, |out| out.line(&sentences::allowed(by, &title)))
}

/// The content of the authorization.
fn show_change(title: &str, change: &RulesChange, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let RulesChange { from, loosened, to } = change;
    out.line(&sentences::rules(title, to, *from))?;
    if loosened.is_empty() {
        return out.line(sentences::NOT_LESS_STRICT);
    }
    out.line(&sentences::less_strict(loosened.len()))?;
    let mut table = TextTable::new(&["field", "before", "shipped", "now"]);
    for DowngradedField { before, field, now, shipped } in loosened {
        table
            .row([field, before, shipped, now].map(|text| Untrusted::new(text.clone()).line().into_string()));
    }
    out.table(&table)
}

fn rules(chosen: &ChosenProfile) -> Result<(Profile, PolicyTable), CliError> {
    chosen.rules().map_err(CliError::internal)
}

fn print_check(checked: &ProfileCheck, file: &Path, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let title = titled(checked.name, checked.site.as_ref());
    out.line(&sentences::well_formed(&title, checked.digest))?;
    out.line(&sentences::policies_compile(checked.policy))?;
    for problem in &checked.policy_problems {
        out.line(&policy_problem_line(problem))?;
    }
    if !checked.loosened.is_empty() {
        let summary = downgrade_summary(&checked.loosened);
        let named = shell_word(&file.display().to_string());
        out.line(&sentences::needs_signature(summary, &named))?;
    }
    let mut table = TextTable::new(&["field", "value", "shipped", "reason"]);
    for number in &checked.numbers {
        let shipped = number.shipped.map_or_else(String::new, |shipped| shipped.to_string());
        let reason = number.reason.clone().unwrap_or_else(|| sentences::NO_REASON.to_owned());
        table.row([number.path.clone(), number.value.to_string(), shipped, reason]);
    }
    out.table(&table)
}

/// What is wrong with the policies of a profile; the texts are those of its files.
pub(super) fn policy_problem_line(of: &PolicyProblem) -> String {
    format!("policies   {}", Untrusted::new(holdpoint_wording::check::policy_problem(of)).line())
}

/// Prints the leaves of a value, one `path value` a row.
pub(super) fn print_fields(value: &Value, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    fn walk(path: &str, value: &Value, table: &mut TextTable) {
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
    let mut table = TextTable::new(&["field", "value"]);
    walk("", value, &mut table);
    out.table(&table)
}

/// A value for people: strings without quotes, lists with commas.
pub(super) fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(plain).collect::<Vec<_>>().join(", "),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::Object(_) => value.to_string(),
    }
}
