//! `holdpoint audit witness add | list | remove`: folders elsewhere that receive each checkpoint.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::json;

use super::data::database;
use super::decide::{parse_identity, parse_reason};
use super::output::TextTable;
use super::passphrase;
use super::prune::{take_store, wall_ms};
use super::verify::absolute;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::SignedWitnessAct;
use holdpoint_engine::caller;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{
    Store, WitnessRequester, add_witness, check_witness, remove_witness, store_info, witnesses,
    witnesses_are_signed,
};
use holdpoint_text::{ErrorReason, Untrusted};

/// The arguments of `audit witness`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct WitnessArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: WitnessVerb,
}

/// The administrator who signs the change of a witness.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct WitnessSigningArgs {
    /// The administrator who signs; required if the store was last used under `real` or `human`.
    #[arg(long, value_name = "ADMIN", requires = "reason", value_parser = parse_identity)]
    by: Option<String>,
    /// The reason; stored in the audit log.
    #[arg(long, value_name = "TEXT", requires = "by", value_parser = parse_reason)]
    reason: Option<Untrusted>,
    /// Reads the passphrase of the administrator's key from this file (mode 0600) instead of the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` can name the file, too.
    #[arg(long, value_name = "FILE", requires = "by")]
    passphrase_file: Option<PathBuf>,
}

/// The verbs of `witness`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum WitnessVerb {
    /// Adds a folder and records it. It receives each later checkpoint; no engine may have the store open.
    #[command(after_help = "\
Name a folder that this machine's users cannot write at will: an NFS or sshfs mount of another
machine, a synchronized folder, or a clone that git pushes. This program itself uses no network.

Example:
  holdpoint audit witness add /mnt/witness
  holdpoint audit witness add /mnt/witness --by admin --reason 'the safe in building 2'")]
    Add {
        /// An existing folder.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        #[command(flatten)]
        signs: WitnessSigningArgs,
    },
    /// Lists the folders, and whether they are writable.
    #[command(after_help = "\
Example:
  holdpoint audit witness list --json")]
    List,
    /// Removes a folder from the witnesses and records it. The folder keeps its files.
    #[command(after_help = "\
Example:
  holdpoint audit witness remove /mnt/witness")]
    Remove {
        /// The folder, as `list` prints it.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        #[command(flatten)]
        signs: WitnessSigningArgs,
    },
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub(super) fn run(
    context: &CliContext,
    args: &WitnessArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let database = database(&context.data)?;
    let (action, folder) = match &args.verb {
        WitnessVerb::Add { folder, signs } => {
            let folder = absolute(folder)?;
            let store = take_store(&context.data)?;
            let by = witnessed_by(context, &store, (&folder, true), signs)?;
            add_witness(&store, &folder, by, wall_ms()).map_err(CliError::usage)?;
            ("added", folder)
        }
        WitnessVerb::Remove { folder, signs } => {
            let folder = absolute(folder)?;
            let store = take_store(&context.data)?;
            let by = witnessed_by(context, &store, (&folder, false), signs)?;
            remove_witness(&store, &folder, by, wall_ms()).map_err(CliError::usage)?;
            ("removed", folder)
        }
        WitnessVerb::List => {
            let store_id = store_info(&context.data).map_err(CliError::usage)?.store_id;
            let mut table = TextTable::new(&["folder", "heads", "standing"]);
            for folder in witnesses(&database).map_err(CliError::usage)? {
                let (heads, status) = match check_witness(&folder, &store_id) {
                    Ok(heads) => (Some(heads), "ok".to_owned()),
                    Err(problem) => (None, problem),
                };
                if out.is_json() {
                    out.json(&json!({ "folder": folder, "heads": heads, "standing": status }))?;
                }
                table.row([folder, heads.map_or_else(String::new, |heads| heads.to_string()), status]);
            }
            match (out.is_json(), table.is_empty()) {
                (true, _) => {}
                (false, true) => out.line("no witnesses; `holdpoint audit witness add DIR` adds one")?,
                (false, false) => out.table(&table)?,
            }
            return Ok(Exit::Confirmed);
        }
    };
    out.answer(&json!({ action: folder }), |out| out.line(&format!("{action} the witness {folder}")))?;
    Ok(Exit::Confirmed)
}

/// The requester according to the system, and the administrator's signature if it is requested or required.
fn witnessed_by(
    context: &CliContext,
    store: &Store,
    (folder, present): (&str, bool),
    signs: &WitnessSigningArgs,
) -> Result<WitnessRequester, CliError> {
    let requester = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
    let views = store.views().map_err(CliError::usage)?;
    let profile = views.context().map_err(CliError::usage)?.map(|(profile, _, _)| profile);
    let (persons, head) = (views.persons().map_err(CliError::usage)?, views.head().map_err(CliError::usage)?);
    drop(views);
    let (Some(by), Some(reason)) = (&signs.by, &signs.reason) else {
        let Some(profile) = profile.filter(|profile| witnesses_are_signed(*profile)) else {
            return Ok((requester, None));
        };
        let admin = persons.administrators().next().map_or("ADMIN", |admin| admin.name.as_str());
        let text = format!(
            "the store was last used under {profile}, so an administrator must sign a change of its witnesses"
        );
        let hint =
            format!("add `--by {admin} --reason TEXT`; `holdpoint identity list` names the administrators");
        return Err(CliError::from_engine_fault(text).with_hint(hint).with_details(ErrorReason::NotAllowed));
    };
    let signer =
        passphrase::unlock(passphrase::stored_identity(context, by)?, signs.passphrase_file.as_deref())?;
    let end = (store.store_id(), head.hash);
    let signed =
        SignedWitnessAct::by(&signer, (folder, present), end, reason.raw()).map_err(CliError::internal)?;
    signed.check(&persons, (folder, present), head.hash).map_err(CliError::from_engine_fault)?;
    if profile == Some(ProfileName::Human) {
        signed.check_guarded(&persons).map_err(CliError::from_engine_fault)?;
    }
    Ok((requester, Some(Box::new(signed))))
}
