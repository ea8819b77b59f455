//! `holdpoint audit witness add | list | remove`: folders elsewhere that get every checkpoint.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use serde_json::json;

use super::data::database;
use super::output::Table;
use super::prune::{now_secs, take_store};
use super::verify::absolute;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_engine::caller;
use holdpoint_registry::{add_witness, look_at_witness, remove_witness, store_info, witnesses};

/// The arguments of `audit witness`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct WitnessArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: WitnessVerb,
}

/// What can be done with witnesses.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum WitnessVerb {
    /// Adds a folder, on record. Every checkpoint goes there from then on; no engine may have the store meanwhile.
    #[command(after_help = "\
Name a folder that this machine's users cannot write at will: a mount of NFS or sshfs from another machine, a
folder that is synchronised there, or a clone that git pushes. This program speaks to no network itself.

Example:
  holdpoint audit witness add /mnt/witness")]
    Add {
        /// A folder that is there.
        #[arg(value_name = "DIR")]
        folder: PathBuf,
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
    },
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub(super) fn run(context: &CliContext, args: &WitnessArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let by = || serde_json::to_string(&caller::own()).map_err(CliError::internal);
    let wall_ms = i64::try_from(now_secs().saturating_mul(1_000)).unwrap_or(i64::MAX);
    let database = database(&context.data)?;
    let (word, folder) = match &args.verb {
        WitnessVerb::Add { folder } => {
            let folder = absolute(folder)?;
            add_witness(&take_store(&context.data)?, &folder, by()?, wall_ms).map_err(CliError::usage)?;
            ("added", folder)
        }
        WitnessVerb::Remove { folder } => {
            let folder = absolute(folder)?;
            remove_witness(&take_store(&context.data)?, &folder, by()?, wall_ms).map_err(CliError::usage)?;
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
