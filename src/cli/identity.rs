//! `holdpoint identity new | list`.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use serde::Serialize;

use super::output::Table;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::{Identity, IdentityInfo, People, keyfile};
use holdpoint_governance::approval::Role;
use holdpoint_registry::Layout;

/// The arguments of `identity`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint identity new mara --role operator
  holdpoint identity list")]
pub struct IdentityArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: IdentityVerb,
}

/// What can be done with identities.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum IdentityVerb {
    /// Makes an identity with a fresh key; keys are never replaced.
    #[command(after_help = "\
Example:
  holdpoint identity new mara --role safety")]
    New {
        /// The person's name, as decisions are signed with it.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// What this person does; profiles say which roles may approve.
        #[arg(long, default_value = "operator", value_parser = roles())]
        role: Role,
    },
    /// Lists the identities of the store.
    #[command(after_help = "\
Example:
  holdpoint identity list --json")]
    List,
}

#[derive(Serialize)]
struct IdentityRow<'a> {
    name: &'a str,
    role: Role,
    public_key: String,
}

impl<'a> IdentityRow<'a> {
    fn of(info: &'a IdentityInfo) -> Self {
        Self { name: &info.name, role: info.role, public_key: keyfile::hex(info.public_key.as_bytes()) }
    }
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &IdentityArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    match &args.verb {
        IdentityVerb::New { name, role } => {
            layout.create().map_err(CliError::usage)?;
            let identity = Identity::create(&folder, name, *role).map_err(CliError::usage)?;
            let shown = IdentityRow::of(identity.info());
            out.answer(&shown, |out| {
                out.line(&format!(
                    "made the identity {} ({}), public key {}",
                    shown.name, shown.role, shown.public_key
                ))
            })?;
        }
        IdentityVerb::List => {
            let people = if folder.is_dir() {
                Identity::list(&folder).map_err(CliError::usage)?
            } else {
                People::default()
            };
            for error in &people.without_role {
                CliError::usage(error).print(&mut std::io::stderr().lock());
            }
            let shown: Vec<IdentityRow<'_>> = people.known.iter().map(IdentityRow::of).collect();
            out.answer(&shown, |out| {
                if shown.is_empty() {
                    return out.line(&format!("no identities in {}", folder.display()));
                }
                let mut table = Table::new(&["name", "role", "public key"]);
                for identity in &shown {
                    table.row([identity.name, identity.role.name(), &identity.public_key]);
                }
                out.table(&table)
            })?;
        }
    }
    Ok(Exit::Confirmed)
}

/// The roles there are; another one is refused with the list.
fn roles() -> impl TypedValueParser<Value = Role> {
    PossibleValuesParser::new(Role::ALL.map(Role::name)).try_map(|name| name.parse::<Role>())
}
