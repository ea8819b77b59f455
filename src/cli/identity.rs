//! `holdpoint identity new | enrol | confirm | revoke | list | passphrase`.
//!
//! A key is somebody's by an administrator's signed act, which the running engine takes, or the store itself
//! (`identity/acts.rs`). A key that nobody enrolled decides nothing.

mod acts;
mod listed;

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use self::listed::ListedIdentity;
use super::decide::parse_identity;
use super::passphrase;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::{Keep, Protection};
use holdpoint_approvals::{Cost, Identity, IdentityError, IdentityInfo, Passphrase};
use holdpoint_governance::approval::Role;
use holdpoint_registry::Layout;

/// The arguments of `identity`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint identity new mara --role operator
  holdpoint identity enrol mara --by admin --reason 'joins the night shift'
  holdpoint identity confirm mara --by admin --reason 'she works here'
  holdpoint identity revoke mara --by admin --reason 'lost her laptop'
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
    /// Makes an identity with a fresh key and has it enrolled; keys are never replaced.
    #[command(after_help = "\
The passphrase of the key is asked for twice at the terminal. Nobody can
recover it. The profile `human` takes no approval of a key without one.
An administrator enrols the key: --by names one. Without it the store's
first administrator does, as long as that key has no passphrase and the
store was not last used under `human`; else the key is not enrolled yet.

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
        /// The administrator who enrols it.
        #[arg(long, value_name = "ADMIN", value_parser = super::decide::parse_identity)]
        by: Option<String>,
        /// Takes the passphrase of the administrator's key from this file.
        #[arg(long, value_name = "FILE", requires = "by")]
        by_passphrase_file: Option<PathBuf>,
    },
    /// Has a person's key enrolled by an administrator: from then on what it signs may count.
    #[command(after_help = "\
The key is the one of that name in keys/identities, or a public key from
elsewhere. A name and a key are enrolled once, also after a revocation.

Examples:
  holdpoint identity enrol mara --by admin --reason 'joins the night shift'
  holdpoint identity enrol mara --public-key mara.pub --role safety --by admin --reason 'her own machine'
  holdpoint identity enrol mara --ssh-agent mara@desk --role safety --by admin --reason 'her own key'")]
    Enrol {
        /// The person's name, as decisions are signed with it.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// A public key from elsewhere: its file, or 64 hexadecimal digits.
        #[arg(long, value_name = "FILE|HEX")]
        public_key: Option<String>,
        /// An ed25519 key that the ssh-agent at `SSH_AUTH_SOCK` holds and signs with: its comment or fingerprint, as
        /// `ssh-add -l` lists them, or none if it holds one alone.
        #[arg(long, value_name = "COMMENT|FINGERPRINT", num_args = 0..=1, conflicts_with = "public_key",
            requires = "role")]
        ssh_agent: Option<Option<String>>,
        /// What this person does; as the identity was made if absent.
        #[arg(long, value_parser = roles())]
        role: Option<Role>,
        #[command(flatten)]
        act: acts::ActArgs,
    },
    /// Has an administrator vouch for a person who was enrolled by a key without a passphrase: `human` counts them then.
    #[command(after_help = "\
The administrator's key needs a passphrase, or lies with an ssh-agent, and
the administrator is the store's first one or is confirmed: see the column
\"confirmed by\" of `holdpoint identity list`. Compare the public key with
what the person shows you before you confirm it.

Example:
  holdpoint identity confirm mara --by admin --reason 'she works here'")]
    Confirm {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        #[command(flatten)]
        act: acts::ActArgs,
    },
    /// Has a person's key revoked by an administrator, for good: nothing that it signed or will sign counts.
    #[command(after_help = "\
Example:
  holdpoint identity revoke mara --by admin --reason 'lost her laptop'")]
    Revoke {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        #[command(flatten)]
        act: acts::ActArgs,
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
    /// Lists the persons of the store, enrolled and revoked, and the keys that nobody enrolled.
    #[command(after_help = "\
Example:
  holdpoint identity list --json")]
    List,
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &IdentityArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    match &args.verb {
        IdentityVerb::New { name, role, passphrase_file, unprotected, by, by_passphrase_file } => {
            let secret =
                || if *unprotected { Ok(None) } else { asked_for(passphrase_file.as_deref()).map(Some) };
            let enroller = || acts::Enroller::of(context, by.as_deref(), by_passphrase_file.as_deref());
            let (info, enrolled) = create(&layout, (name, *role), secret, enroller)?;
            let protection = Identity::protection(&folder, name).ok();
            let shown = ListedIdentity::made(&info, protection, enrolled.standing());
            out.answer(&shown, |out| {
                out.line(&format!(
                    "made the identity {} ({}, {}), public key {}",
                    shown.name,
                    shown.role,
                    shown.protection(),
                    shown.public_key
                ))?;
                out.line(&enrolled.sentence(name))
            })?;
        }
        IdentityVerb::Passphrase { name, passphrase_file, new_passphrase_file, remove } => {
            let kept = passphrase::kept(context, name)?;
            let before = kept.protection();
            let identity = passphrase::unlock(kept, passphrase_file.as_deref())?;
            let words = if *remove { None } else { Some(asked_for_anew(new_passphrase_file.as_deref())?) };
            let keep = words.as_ref().map_or(Keep::Plain, |words| Keep::Sealed(words, Cost::USUAL));
            identity.keep(&folder, keep).map_err(CliError::usage)?;
            let shown = ListedIdentity::of(identity.info(), Identity::protection(&folder, name).ok());
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
        IdentityVerb::Enrol { name, public_key, ssh_agent, role, act } => {
            let key = match (public_key, ssh_agent, role) {
                (Some(given), _, _) => acts::EnrolledKey::Given(given),
                (None, Some(named), Some(role)) => acts::EnrolledKey::Agent(named.as_deref(), *role),
                (None, _, _) => acts::EnrolledKey::Here,
            };
            acts::enrol(context, (name, key, *role), act, out)?;
        }
        IdentityVerb::Confirm { name, act } => acts::confirm(context, name, act, out)?,
        IdentityVerb::Revoke { name, act } => acts::revoke(context, name, act, out)?,
        IdentityVerb::List => return listed::list(context, out),
    }
    Ok(Exit::Confirmed)
}

/// Makes an identity and enrolls it.
fn create(
    layout: &Layout,
    (name, role): (&str, Role),
    secret: impl FnOnce() -> Result<Option<Passphrase>, CliError>,
    enroller: impl FnOnce() -> Result<acts::Enroller, CliError>,
) -> Result<(IdentityInfo, acts::Enrolment), CliError> {
    let folder = layout.identities();
    if Identity::find(&folder, name).is_ok() {
        return Err(CliError::usage(IdentityError::Exists(name.to_owned())));
    }
    let passphrase = secret()?;
    let keep = passphrase.as_ref().map_or(Keep::Plain, |words| Keep::Sealed(words, Cost::USUAL));
    layout.create().map_err(CliError::usage)?;
    let enroller = enroller()?;
    let identity = Identity::create_kept(&folder, name, role, keep).map_err(CliError::usage)?;
    let info = identity.info().clone();
    Ok((info, enroller.enrol(identity)?))
}

/// Makes an identity of the default role without a passphrase, as `identity new --unprotected` does.
///
/// # Errors
/// [`CliError`].
pub(super) fn make_unprotected(context: &CliContext, name: &str) -> Result<(), CliError> {
    let name = parse_identity(name).map_err(CliError::usage)?;
    let layout = Layout::new(&context.data);
    let enroller = || acts::Enroller::of(context, None, None);
    create(&layout, (&name, Role::Operator), || Ok(None), enroller).map(drop)
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
