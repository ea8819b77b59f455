//! `holdpoint audit witness add | list | remove`: folders elsewhere that get every checkpoint.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::json;

use super::data::database;
use super::decide::{parse_identity, parse_reason};
use super::output::Table;
use super::passphrase;
use super::prune::{take_store, wall_ms};
use super::verify::absolute;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::SignedWitnessAct;
use holdpoint_engine::caller;
use holdpoint_governance::profile::ProfileName;
use holdpoint_registry::{
    Store, WitnessedBy, add_witness, look_at_witness, remove_witness, store_info, witnesses,
    witnesses_are_signed,
};
use holdpoint_text::Untrusted;

/// The arguments of `audit witness`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct WitnessArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: WitnessVerb,
}

/// The administrator who answers for a witness.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct WitnessSigns {
    /// The administrator who signs; one has to where the store was last used under `real` or `human`.
    #[arg(long, value_name = "ADMIN", requires = "reason", value_parser = parse_identity)]
    by: Option<String>,
    /// Why; goes into the audit log.
    #[arg(long, value_name = "TEXT", requires = "by", value_parser = parse_reason)]
    reason: Option<Untrusted>,
    /// Takes the passphrase of the administrator's key from this file (mode 0600) and not from the terminal. The
    /// variable `HOLDPOINT_PASSPHRASE_FILE` names one as well.
    #[arg(long, value_name = "FILE", requires = "by")]
    passphrase_file: Option<PathBuf>,
}

/// What can be done with witnesses.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum WitnessVerb {
    /// Adds a folder, on record. Every checkpoint goes there from then on; no engine may have the store meanwhile.
    #[command(after_help = "\
Name a folder that this machine's users cannot write at will: a mount of NFS or sshfs from another machine, a
folder that is synchronised there, or a clone that git pushes. This program speaks to no network itself.

Example:
  holdpoint audit witness add /mnt/witness
  holdpoint audit witness add /mnt/witness --by admin --reason 'the safe in building 2'")]
    Add {
        /// A folder that is there.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        #[command(flatten)]
        signs: WitnessSigns,
    },
    /// Lists the folders, and whether they can be written.
    #[command(after_help = "\
Example:
  holdpoint audit witness list --json")]
    List,
    /// Removes a folder, on record. What it has stays there.
    #[command(after_help = "\
Example:
  holdpoint audit witness remove /mnt/witness")]
    Remove {
        /// As `list` names it.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
        #[command(flatten)]
        signs: WitnessSigns,
    },
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub(super) fn run(context: &CliContext, args: &WitnessArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let database = database(&context.data)?;
    let (word, folder) = match &args.verb {
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
            let mut table = Table::new(&["folder", "heads", "standing"]);
            for folder in witnesses(&database).map_err(CliError::usage)? {
                let (heads, standing) = match look_at_witness(&folder, &store_id) {
                    Ok(heads) => (Some(heads), "ok".to_owned()),
                    Err(problem) => (None, problem),
                };
                if out.is_json() {
                    out.json(&json!({ "folder": folder, "heads": heads, "standing": standing }))?;
                }
                table.row([folder, heads.map_or_else(String::new, |heads| heads.to_string()), standing]);
            }
            match (out.is_json(), table.is_empty()) {
                (true, _) => {}
                (false, true) => out.line("no witnesses; `holdpoint audit witness add DIR` adds one")?,
                (false, false) => out.table(&table)?,
            }
            return Ok(Exit::Confirmed);
        }
    };
    out.answer(&json!({ word: folder }), |out| out.line(&format!("{word} the witness {folder}")))?;
    Ok(Exit::Confirmed)
}

/// Who asks for it as the system says, and the administrator's signed word where one is named or needed.
fn witnessed_by(
    context: &CliContext,
    store: &Store,
    (folder, present): (&str, bool),
    signs: &WitnessSigns,
) -> Result<WitnessedBy, CliError> {
    let asks = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
    let views = store.views().map_err(CliError::usage)?;
    let profile = views.context().map_err(CliError::usage)?.map(|(profile, _, _)| profile);
    let (persons, head) = (views.persons().map_err(CliError::usage)?, views.head().map_err(CliError::usage)?);
    drop(views);
    let (Some(by), Some(reason)) = (&signs.by, &signs.reason) else {
        let Some(profile) = profile.filter(|profile| witnesses_are_signed(*profile)) else {
            return Ok((asks, None));
        };
        let admin = persons.administrators().next().map_or("ADMIN", |admin| admin.name.as_str());
        let text = format!(
            "the store was last used under {profile}, where an administrator signs which witnesses it has"
        );
        let hint = format!(
            "--by {admin} --reason TEXT has it signed; `holdpoint identity list` names the administrators"
        );
        return Err(CliError::held(text).with_hint(hint));
    };
    let signer = passphrase::unlock(passphrase::kept(context, by)?, signs.passphrase_file.as_deref())?;
    let end = (store.store_id(), head.hash);
    let signed =
        SignedWitnessAct::by(&signer, (folder, present), end, reason.raw()).map_err(CliError::internal)?;
    signed.check(&persons, (folder, present), head.hash).map_err(CliError::held)?;
    if profile == Some(ProfileName::Human) {
        signed.check_guarded(&persons).map_err(CliError::held)?;
    }
    Ok((asks, Some(Box::new(signed))))
}
