//! `holdpoint identity new | list | passphrase`.

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use serde::Serialize;

use super::output::Table;
use super::passphrase;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::{Keep, Protection};
use holdpoint_approvals::{Cost, Identity, IdentityError, IdentityInfo, Passphrase, People, keyfile};
use holdpoint_governance::approval::Role;
use holdpoint_registry::Layout;

/// The arguments of `identity`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint identity new mara --role operator
  holdpoint identity passphrase mara
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
The passphrase of the key is asked for twice at the terminal. Nobody can
recover it. The profile `human` takes no approval of a key without one.

Examples:
  holdpoint identity new mara --role safety
  holdpoint identity new mara --passphrase-file mara.txt
  holdpoint identity new robot-test --unprotected")]
    New {
        /// The person's name, as decisions are signed with it.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// What this person does; profiles say which roles may approve.
        #[arg(long, default_value = "operator", value_parser = roles())]
        role: Role,
        /// Takes the passphrase of the key from this file: one line, regular, of mode 0600.
        #[arg(long, value_name = "FILE")]
        passphrase_file: Option<PathBuf>,
        /// Makes a key without a passphrase: who can read its file can sign.
        #[arg(long, conflicts_with = "passphrase_file")]
        unprotected: bool,
    },
    /// Sets, changes or removes the passphrase of a key; the key stays the same.
    #[command(after_help = "\
The key file is replaced in one step. What it was before may still be
found on the disk or in a backup: a key that somebody may have read
without a passphrase is no secret any more.

Examples:
  holdpoint identity passphrase mara
  holdpoint identity passphrase mara --remove
  holdpoint identity passphrase mara --passphrase-file old.txt --new-passphrase-file new.txt")]
    Passphrase {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// Takes the present passphrase, if there is one, from this file.
        #[arg(long, value_name = "FILE")]
        passphrase_file: Option<PathBuf>,
        /// Takes the new passphrase from this file.
        #[arg(long, value_name = "FILE")]
        new_passphrase_file: Option<PathBuf>,
        /// Leaves the key without a passphrase.
        #[arg(long, conflicts_with = "new_passphrase_file")]
        remove: bool,
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
    /// Absent if the key file cannot be read.
    protection: Option<Protection>,
}

impl<'a> IdentityRow<'a> {
    fn of(info: &'a IdentityInfo, protection: Option<Protection>) -> Self {
        let public_key = keyfile::hex(info.public_key.as_bytes());
        Self { name: &info.name, role: info.role, public_key, protection }
    }

    fn protection(&self) -> &'static str {
        self.protection.map_or("unreadable", Protection::name)
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
        IdentityVerb::New { name, role, passphrase_file, unprotected } => {
            if Identity::find(&folder, name).is_ok() {
                return Err(CliError::usage(IdentityError::Exists(name.clone())));
            }
            let passphrase = if *unprotected { None } else { Some(asked_for(passphrase_file.as_deref())?) };
            let keep = passphrase.as_ref().map_or(Keep::Plain, |words| Keep::Sealed(words, Cost::USUAL));
            layout.create().map_err(CliError::usage)?;
            let identity = Identity::create_kept(&folder, name, *role, keep).map_err(CliError::usage)?;
            let shown = IdentityRow::of(identity.info(), Identity::protection(&folder, name).ok());
            out.answer(&shown, |out| {
                out.line(&format!(
                    "made the identity {} ({}, {}), public key {}",
                    shown.name,
                    shown.role,
                    shown.protection(),
                    shown.public_key
                ))
            })?;
        }
        IdentityVerb::Passphrase { name, passphrase_file, new_passphrase_file, remove } => {
            let kept = passphrase::kept(context, name)?;
            let before = kept.protection();
            let identity = passphrase::unlock(kept, passphrase_file.as_deref())?;
            let words = if *remove { None } else { Some(asked_for_anew(new_passphrase_file.as_deref())?) };
            let keep = words.as_ref().map_or(Keep::Plain, |words| Keep::Sealed(words, Cost::USUAL));
            identity.keep(&folder, keep).map_err(CliError::usage)?;
            let shown = IdentityRow::of(identity.info(), Identity::protection(&folder, name).ok());
            out.answer(&shown, |out| {
                out.line(&match (before, *remove) {
                    (Protection::Passphrase, false) => {
                        format!("the key of {name} has another passphrase now")
                    }
                    (Protection::None | Protection::Elsewhere, false) => {
                        format!("the key of {name} has a passphrase now")
                    }
                    (_, true) => format!(
                        "the key of {name} has no passphrase now; the profile human takes no approval of it"
                    ),
                })
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
            let mut shown: Vec<IdentityRow<'_>> = Vec::new();
            for info in &people.known {
                let protection = Identity::protection(&folder, &info.name);
                if let Err(error) = &protection {
                    CliError::usage(error).print(&mut std::io::stderr().lock());
                }
                shown.push(IdentityRow::of(info, protection.ok()));
            }
            out.answer(&shown, |out| {
                if shown.is_empty() {
                    return out.line(&format!("no identities in {}", folder.display()));
                }
                let mut table = Table::new(&["name", "role", "protection", "public key"]);
                for identity in &shown {
                    table.row([
                        identity.name,
                        identity.role.name(),
                        identity.protection(),
                        &identity.public_key,
                    ]);
                }
                out.table(&table)
            })?;
        }
    }
    Ok(Exit::Confirmed)
}

/// The passphrase of a new key.
fn asked_for(file: Option<&Path>) -> Result<Passphrase, CliError> {
    passphrase::fresh(file)?.ok_or_else(|| {
        CliError::usage("a new key needs a passphrase, and there is no terminal to type it at").with_hint(
            "--passphrase-file FILE names a file that has it; --unprotected makes a key without one",
        )
    })
}

/// The passphrase that a key gets in place of what it has.
fn asked_for_anew(file: Option<&Path>) -> Result<Passphrase, CliError> {
    passphrase::fresh(file)?.ok_or_else(|| {
        CliError::usage("there is no terminal to type the new passphrase at").with_hint(
            "--new-passphrase-file FILE names a file that has it; --remove leaves the key without one",
        )
    })
}

/// The roles there are; another one is refused with the list.
fn roles() -> impl TypedValueParser<Value = Role> {
    PossibleValuesParser::new(Role::ALL.map(Role::name)).try_map(|name| name.parse::<Role>())
}
