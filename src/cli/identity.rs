//! `holdpoint identity new | enroll | confirm | revoke | list | passphrase`.
//!
//! A key counts only after an administrator's signed act, which the running engine or the store accepts
//! (`identity/admin_acts.rs`). A key that is not enrolled decides nothing.

mod admin_acts;
mod identity_rows;

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use self::identity_rows::IdentityRow;
use super::passphrase;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile::{KeyEncoding, Protection};
use holdpoint_approvals::{Identity, IdentityError, IdentityInfo, KdfCost, Passphrase, PassphraseCause};
use holdpoint_governance::approval::Role;
use holdpoint_store::Layout;
use holdpoint_wording::program::identity as sentences;
use holdpoint_wording::program::identity::PassphraseChange;

/// The arguments of `identity`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint identity new mara --role operator
  holdpoint identity enroll mara --by admin --reason 'joins the night shift'
  holdpoint identity confirm mara --by admin --reason 'she works here'
  holdpoint identity revoke mara --by admin --reason 'lost her laptop'
  holdpoint identity passphrase mara
  holdpoint identity list")]
pub struct IdentityArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: IdentityVerb,
}

/// The verbs of `identity`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum IdentityVerb {
    /// Creates an identity with a new key and enrolls it; keys are never replaced.
    #[command(after_help = "\
The verb asks twice for the key's passphrase at the terminal. A passphrase
cannot be recovered. The profile `human` accepts no approval of a key without
one. --by names the administrator who enrolls the key. Without --by the
store's first administrator enrolls it, if that administrator's key has no
passphrase and the store was not last used under `human`. Otherwise the key is
not enrolled yet.

Examples:
  holdpoint identity new mara --role safety
  holdpoint identity new mara --passphrase-file mara.txt
  holdpoint identity new robot-test --unprotected")]
    New {
        /// The person's name; decisions are signed with it.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// The person's role; profiles state which roles may approve.
        #[arg(long, default_value = "operator", value_parser = roles())]
        role: Role,
        /// Reads the passphrase of the key from this file: one line, a regular file of mode 0600.
        #[arg(long, value_name = "FILE")]
        passphrase_file: Option<PathBuf>,
        /// Creates a key without a passphrase: any process that can read the file can sign.
        #[arg(long, conflicts_with = "passphrase_file")]
        unprotected: bool,
        /// The administrator who enrolls the key.
        #[arg(long, value_name = "ADMIN", value_parser = super::decide::parse_identity)]
        by: Option<String>,
        /// Reads the passphrase of the administrator's key from this file.
        #[arg(long, value_name = "FILE", requires = "by")]
        by_passphrase_file: Option<PathBuf>,
    },
    /// Lets an administrator enroll a person's key: later signatures of the key count.
    #[command(
        name = "enroll",
        alias = "enrol",
        after_help = "\
The key is the one of that name in keys/identities, or a public key from
elsewhere. A name or a key is enrolled only once, even after a revocation.

Examples:
  holdpoint identity enroll mara --by admin --reason 'joins the night shift'
  holdpoint identity enroll mara --public-key mara.pub --role safety --by admin --reason 'her own machine'
  holdpoint identity enroll mara --ssh-agent mara@desk --role safety --by admin --reason 'her own key'"
    )]
    Enrol {
        /// The person's name; decisions are signed with it.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// A public key from elsewhere: its file, or 64 hexadecimal digits.
        #[arg(long, value_name = "FILE|HEX")]
        public_key: Option<String>,
        /// The ed25519 key of the ssh-agent at `SSH_AUTH_SOCK` that signs: its comment or fingerprint, as `ssh-add
        /// -l` lists them [default: the agent's only key].
        #[arg(long, value_name = "COMMENT|FINGERPRINT", num_args = 0..=1, conflicts_with = "public_key",
            requires = "role")]
        ssh_agent: Option<Option<String>>,
        /// The person's role [default: the role of the identity].
        #[arg(long, value_parser = roles())]
        role: Option<Role>,
        #[command(flatten)]
        act: admin_acts::ActArgs,
    },
    /// Lets an administrator verify a person who was enrolled by an unencrypted key: `human` then counts the
    /// person.
    #[command(after_help = "\
The administrator's key needs a passphrase or an ssh-agent, and the
administrator is the store's first one or is verified: see the column
\"confirmed by\" of `holdpoint identity list`. Before you confirm, compare the
public key with the one that the person shows you.

Example:
  holdpoint identity confirm mara --by admin --reason 'she works here'")]
    Confirm {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        #[command(flatten)]
        act: admin_acts::ActArgs,
    },
    /// Lets an administrator revoke a person's key permanently: its past and future signatures do not count.
    #[command(after_help = "\
Example:
  holdpoint identity revoke mara --by admin --reason 'lost her laptop'")]
    Revoke {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        #[command(flatten)]
        act: admin_acts::ActArgs,
    },
    /// Sets, changes or removes the passphrase of a key; the key stays the same.
    #[command(after_help = "\
The verb replaces the key file in one step. The old file may remain on the
disk or in a backup: treat a key that another person may have read without a
passphrase as disclosed.

Examples:
  holdpoint identity passphrase mara
  holdpoint identity passphrase mara --remove
  holdpoint identity passphrase mara --passphrase-file old.txt --new-passphrase-file new.txt")]
    Passphrase {
        /// The person's name.
        #[arg(value_parser = super::decide::parse_identity)]
        name: String,
        /// Reads the present passphrase, if there is one, from this file.
        #[arg(long, value_name = "FILE")]
        passphrase_file: Option<PathBuf>,
        /// Reads the new passphrase from this file.
        #[arg(long, value_name = "FILE")]
        new_passphrase_file: Option<PathBuf>,
        /// Removes the passphrase of the key.
        #[arg(long, conflicts_with = "new_passphrase_file")]
        remove: bool,
    },
    /// Lists the store's persons, enrolled and revoked, and the keys that are not enrolled.
    #[command(after_help = "\
Example:
  holdpoint identity list --json")]
    List,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &IdentityArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    let folder = layout.identities();
    match &args.verb {
        IdentityVerb::New { name, role, passphrase_file, unprotected, by, by_passphrase_file } => {
            let secret = || {
                if *unprotected {
                    Ok(None)
                } else {
                    new_passphrase(name, passphrase_file.as_deref()).map(Some)
                }
            };
            let enroller = || admin_acts::Enroller::of(context, by.as_deref(), by_passphrase_file.as_deref());
            let (info, enrolled) = create(&layout, (name, *role), secret, enroller)?;
            let protection = Identity::protection(&folder, name).ok();
            let shown = IdentityRow::for_new_key(&info, protection, enrolled.status());
            out.answer(&shown, |out| {
                out.line(&sentences::created(
                    &shown.name,
                    &shown.role,
                    shown.protection(),
                    &shown.public_key,
                ))?;
                out.line(&enrolled.sentence(name))
            })?;
        }
        IdentityVerb::Passphrase { name, passphrase_file, new_passphrase_file, remove } => {
            let locked = passphrase::stored_identity(context, name)?;
            let before = locked.protection();
            let identity = passphrase::unlock(locked, passphrase_file.as_deref())?;
            let replacement = if *remove {
                None
            } else {
                Some(replacement_passphrase(name, new_passphrase_file.as_deref())?)
            };
            let encoding = replacement
                .as_ref()
                .map_or(KeyEncoding::Plain, |phrase| KeyEncoding::Sealed(phrase, KdfCost::USUAL));
            identity.rewrite_key(&folder, encoding).map_err(CliError::usage)?;
            let shown = IdentityRow::of(identity.info(), Identity::protection(&folder, name).ok());
            out.answer(&shown, |out| {
                let change = match (before, *remove) {
                    (Protection::Passphrase, false) => PassphraseChange::Replaced,
                    (Protection::None | Protection::Elsewhere, false) => PassphraseChange::Set,
                    (_, true) => PassphraseChange::Removed,
                };
                out.line(&sentences::passphrase(change, name))
            })?;
        }
        IdentityVerb::Enrol { name, public_key, ssh_agent, role, act } => {
            let key = match (public_key, ssh_agent, role) {
                (Some(source), _, _) => admin_acts::KeyToEnrol::Given(source),
                (None, Some(named), Some(role)) => admin_acts::KeyToEnrol::Agent(named.as_deref(), *role),
                (None, _, _) => admin_acts::KeyToEnrol::Here,
            };
            admin_acts::enrol(context, (name, key, *role), act, out)?;
        }
        IdentityVerb::Confirm { name, act } => admin_acts::confirm(context, name, act, out)?,
        IdentityVerb::Revoke { name, act } => admin_acts::revoke(context, name, act, out)?,
        IdentityVerb::List => return identity_rows::list(context, out),
    }
    Ok(Exit::Confirmed)
}

/// Creates an identity and enrolls it.
fn create(
    layout: &Layout,
    (name, role): (&str, Role),
    secret: impl FnOnce() -> Result<Option<Passphrase>, CliError>,
    enroller: impl FnOnce() -> Result<admin_acts::Enroller, CliError>,
) -> Result<(IdentityInfo, admin_acts::Enrollment), CliError> {
    let folder = layout.identities();
    if Identity::find(&folder, name).is_ok() {
        return Err(CliError::usage(IdentityError::Exists(name.to_owned())));
    }
    let passphrase = secret()?;
    let encoding =
        passphrase.as_ref().map_or(KeyEncoding::Plain, |phrase| KeyEncoding::Sealed(phrase, KdfCost::USUAL));
    layout.create().map_err(CliError::usage)?;
    let enroller = enroller()?;
    let identity = Identity::create_encoded(&folder, name, role, encoding).map_err(CliError::usage)?;
    let info = identity.info().clone();
    Ok((info, enroller.enrol(identity)?))
}

/// Creates an identity of the default role without a passphrase, as `identity new --unprotected` does.
///
/// # Errors
/// [`CliError`].
#[cfg(feature = "console")]
pub(super) fn make_unprotected(context: &CliContext, name: &str) -> Result<(), CliError> {
    let name = super::decide::parse_identity(name).map_err(CliError::usage)?;
    let layout = Layout::new(&context.data);
    let enroller = || admin_acts::Enroller::of(context, None, None);
    create(&layout, (&name, Role::Operator), || Ok(None), enroller).map(drop)
}

/// The passphrase of a new key.
fn new_passphrase(name: &str, file: Option<&Path>) -> Result<Passphrase, CliError> {
    passphrase::fresh(name, file)?.ok_or_else(|| {
        CliError::usage("a new key needs a passphrase, and there is no terminal to enter it")
            .with_hint(
                "--passphrase-file FILE names a file that contains it; --unprotected creates a key without one",
            )
            .with_details(passphrase::details(PassphraseCause::Needed))
    })
}

/// The new passphrase of an existing key.
fn replacement_passphrase(name: &str, file: Option<&Path>) -> Result<Passphrase, CliError> {
    passphrase::fresh(name, file)?.ok_or_else(|| {
        CliError::usage("there is no terminal to enter the new passphrase")
            .with_hint(
                "--new-passphrase-file FILE names a file that contains it; --remove removes the passphrase",
            )
            .with_details(passphrase::details(PassphraseCause::Needed))
    })
}

/// The roles; the error for another one lists them.
fn roles() -> impl TypedValueParser<Value = Role> {
    PossibleValuesParser::new(Role::ALL.map(Role::name)).try_map(|name| name.parse::<Role>())
}
