//! `holdpoint audit witness add | list | remove`: folders elsewhere that receive each checkpoint.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

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
use holdpoint_audit::witness::witness_heads;
use holdpoint_governance::profile::ProfileName;
use holdpoint_record::caller;
use holdpoint_registry::{
    Store, WitnessRequester, add_witness, remove_witness, store_info, witnesses, witnesses_are_signed,
};
use holdpoint_store::FIRST_ADMINISTRATOR;
use holdpoint_text::file::kind_of;
use holdpoint_text::{ErrorDetails, ErrorReason, Untrusted};
use holdpoint_wording::program::audit as sentences;

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
    /// Lists the folders, and whether they are writable and have heads.
    #[command(after_help = "\
Exits with 1 if a witness cannot be written or has no head.

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
            let folder = new_folder(folder, &witnesses(&database).map_err(CliError::usage)?)?;
            let store = take_store(&context.data)?;
            let by = witnessed_by(context, &store, (&folder, true), signs)?;
            add_witness(&store, &folder, by, wall_ms()).map_err(CliError::usage)?;
            ("added", folder)
        }
        WitnessVerb::Remove { folder, signs } => {
            let folder = recorded_folder(folder, &witnesses(&database).map_err(CliError::usage)?)?;
            let store = take_store(&context.data)?;
            let by = witnessed_by(context, &store, (&folder, false), signs)?;
            remove_witness(&store, &folder, by, wall_ms()).map_err(CliError::usage)?;
            ("removed", folder)
        }
        WitnessVerb::List => {
            let store_id = store_info(&context.data).map_err(CliError::usage)?.store_id;
            let mut table = TextTable::new(&["folder", "heads", "standing"]);
            let mut exit = Exit::Confirmed;
            for folder in witnesses(&database).map_err(CliError::usage)? {
                let (heads, status) = match witness_heads(&folder, &store_id) {
                    Ok(heads) => (Some(heads), "ok".to_owned()),
                    Err(problem) => {
                        exit = Exit::Rejected;
                        (None, problem)
                    }
                };
                if out.is_json() {
                    out.json(&json!({ "folder": folder, "heads": heads, "standing": status }))?;
                }
                table.row([folder, heads.map_or_else(String::new, |heads| heads.to_string()), status]);
            }
            match (out.is_json(), table.is_empty()) {
                (true, _) => {}
                (false, true) => out.line(sentences::NO_WITNESSES)?,
                (false, false) => out.table(&table)?,
            }
            return Ok(exit);
        }
    };
    out.answer(&json!({ action: folder }), |out| out.line(&format!("{action} the witness {folder}")))?;
    Ok(Exit::Confirmed)
}

/// The folder of a new witness without links and `..`, so that a folder has one name on record.
fn new_folder(path: &Path, recorded: &BTreeSet<String>) -> Result<String, CliError> {
    let named = absolute(path)?;
    let found = match fs::metadata(path) {
        Ok(found) => found,
        // The store refuses an address, with a hint.
        Err(_) if named.contains("://") || named.contains('@') => return Ok(named),
        Err(error) => {
            return Err(unusable(path, &error)
                .with_hint("name an existing folder, such as the mount of another machine's disk"));
        }
    };
    if !found.is_dir() {
        let text =
            format!("{path:?} is {}; a witness is a folder, which receives the heads", kind_of(&found));
        let parent = Path::new(&named).parent().unwrap_or(Path::new("/"));
        let hint = format!(
            "`holdpoint audit witness add {0}` adds its folder; `holdpoint audit verify --against {named}` compares the \
             store with the file",
            parent.display()
        );
        return Err(CliError::usage(text).with_hint(hint).with_bad_file(path));
    }
    let folder = resolved(path)?;
    let is_it = |one: &&String| **one == folder || resolved(Path::new(one)).is_ok_and(|one| one == folder);
    match recorded.iter().find(is_it) {
        None => Ok(folder),
        Some(one) => {
            Err(CliError::usage(format!("{path:?} is a witness already: it is recorded as {one:?}"))
                .with_hint("`holdpoint audit witness list` shows all witnesses")
                .with_details(ErrorDetails::of_path(ErrorReason::Exists, path)))
        }
    }
}

/// A witness as the store recorded it: as named, or the same folder without links and `..`.
fn recorded_folder(path: &Path, recorded: &BTreeSet<String>) -> Result<String, CliError> {
    let named = absolute(path)?;
    if recorded.contains(&named) {
        return Ok(named);
    }
    // A folder that is gone keeps its name.
    Ok(resolved(path).ok().filter(|folder| recorded.contains(folder)).unwrap_or(named))
}

/// The path without links and `..`.
fn resolved(path: &Path) -> Result<String, CliError> {
    absolute(&fs::canonicalize(path).map_err(|error| unusable(path, &error))?)
}

fn unusable(path: &Path, error: &io::Error) -> CliError {
    CliError::usage(format!("cannot use {path:?} as a witness: {error}")).with_bad_file(path)
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
        let admin = persons.administrators().next().map_or(FIRST_ADMINISTRATOR, |admin| admin.name.as_str());
        let text = format!(
            "the store was last used under {profile}, so an administrator must sign a change of its witnesses"
        );
        let hint = if present {
            format!("`holdpoint audit witness add {folder} --by {admin} --reason 'the reason'` signs it")
        } else {
            format!("`holdpoint audit witness remove {folder} --by {admin} --reason 'the reason'` signs it")
        };
        return Err(CliError::from_engine_fault(text).with_hint(hint).with_details(ErrorReason::NotAllowed));
    };
    let signer =
        passphrase::unlock(passphrase::stored_identity(context, by)?, signs.passphrase_file.as_deref())?;
    let end = (store.store_id(), head.hash);
    let signed =
        SignedWitnessAct::by(&signer, (folder, present), end, reason.raw()).map_err(CliError::internal)?;
    signed.check(&persons, (folder, present), head.hash).map_err(CliError::from_engine_fault)?;
    if profile.is_some_and(ProfileName::is_beside_people) {
        signed.check_guarded(&persons).map_err(CliError::from_engine_fault)?;
    }
    Ok((requester, Some(Box::new(signed))))
}
