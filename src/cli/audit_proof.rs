//! `holdpoint audit proof | consistency | check-proof`: proofs of the audit chain that need no store.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};

use super::data::database;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::Checkpoint;
use holdpoint_audit::proof::Proof;
use holdpoint_registry::{prove_consistency, prove_record, store_info, stored_head};
use holdpoint_store::Layout;
use holdpoint_text::Hint;
use holdpoint_wording::program::audit as sentences;

/// The arguments of `audit proof`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ProofArgs {
    /// The number of the record.
    #[arg(value_name = "SEQ", value_parser = clap::value_parser!(u64).range(1..))]
    pub seq: u64,
    /// The file to create [default: the standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The arguments of `audit consistency`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(group = ArgGroup::new("older").required(true))]
pub struct ConsistencyArgs {
    /// The record that the earlier checkpoint covers last.
    #[arg(long, value_name = "SEQ", group = "older")]
    pub from: Option<u64>,
    /// The earlier checkpoint, from a copy kept elsewhere.
    #[arg(long, value_name = "FILE", group = "older")]
    pub against: Option<PathBuf>,
    /// The file to create [default: the standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The arguments of `audit check-proof`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct CheckProofArgs {
    /// A file that `audit proof` or `audit consistency` wrote.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The store's public key [default: that of the store].
    #[arg(long, value_name = "FILE")]
    pub public_key: Option<PathBuf>,
}

/// Writes a proof that a record is in the chain.
///
/// # Errors
/// [`CliError`].
pub(super) fn record(
    context: &CliContext,
    args: &ProofArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let proof = prove_record(&database(&context.data)?, args.seq).map_err(CliError::usage)?;
    write(&proof, args.out.as_deref(), out)
}

/// Writes a proof that the chain extends an earlier checkpoint.
///
/// # Errors
/// [`CliError`].
pub(super) fn consistency(
    context: &CliContext,
    args: &ConsistencyArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let database = database(&context.data)?;
    let older = match (&args.against, args.from) {
        (Some(path), _) => {
            Checkpoint::read(path).map_err(|problem| not_a_checkpoint(context, path, &problem))?
        }
        (None, Some(seq)) => stored_head(&context.data, seq).map_err(CliError::usage)?,
        (None, None) => return Err(CliError::usage("`--from SEQ` or `--against FILE` is needed".to_owned())),
    };
    let proof = prove_consistency(&database, &older).map_err(CliError::usage)?;
    write(&proof, args.out.as_deref(), out)
}

/// A folder in place of a checkpoint is the usual mistake: a witness has a folder for each store.
fn not_a_checkpoint(context: &CliContext, path: &Path, problem: &str) -> CliError {
    if !path.is_dir() {
        return CliError::usage(format!("{path:?} is not a checkpoint: {problem}")).with_bad_file(path);
    }
    let own = store_info(&context.data).map(|info| path.join(info.store_id)).ok().filter(|own| own.is_dir());
    let folder = own.unwrap_or_else(|| path.to_owned());
    let files = fs::read_dir(&folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
    let newest = files.filter(|file| file.extension().is_some_and(|is| is == "json")).max();
    let error =
        CliError::usage(format!("{path:?} is a folder; a checkpoint is a file in it")).with_bad_file(path);
    error.with_hint(match newest {
        Some(file) => {
            format!("`holdpoint audit consistency --against {}` names its newest file", file.display())
        }
        None => "`holdpoint audit witness list` shows which witness has heads of this store".to_owned(),
    })
}

fn write(proof: &Proof, path: Option<&Path>, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let text = proof.text().map_err(CliError::internal)?;
    let Some(path) = path else {
        writeln!(out.sink(), "{text}")?;
        return Ok(Exit::Confirmed);
    };
    let cannot = |error: std::io::Error| {
        CliError::usage(format!("cannot write {path:?}: {error}")).with_unwritable(path, &error)
    };
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(cannot)?;
    writeln!(file, "{text}").and_then(|()| file.sync_all()).map_err(cannot)?;
    let (steps, bytes) = (steps(proof), text.len() + 1);
    let value = serde_json::json!({ "file": path.display().to_string(), "steps": steps, "bytes": bytes });
    out.answer(&value, |out| out.line(&sentences::wrote_proof(steps, bytes, path.display())))?;
    Ok(Exit::Confirmed)
}

fn steps(proof: &Proof) -> usize {
    match proof {
        Proof::Inclusion { path, .. } | Proof::Consistency { path, .. } => path.len(),
    }
}

/// Checks a proof with only a public key.
///
/// # Errors
/// [`CliError`] if the file is not a proof, or there is no key to check it with.
pub(super) fn check(
    context: &CliContext,
    args: &CheckProofArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let own = Layout::new(&context.data).store_public_key();
    let path = match &args.public_key {
        Some(path) => path.clone(),
        None if own.is_file() => own,
        None => {
            return Err(CliError::usage("checking a proof needs the store's public key".to_owned())
                .with_hint("name it with --public-key FILE; it is `keys/store.pub` of the store"));
        }
    };
    let (key, _) = keyfile::read_public(&path).map_err(CliError::usage)?;
    let proof = Proof::read(&args.file).map_err(|error| {
        let error = CliError::usage(error).with_bad_file(&args.file);
        if !args.file.is_dir() {
            return error;
        }
        let hint = format!(
            "name a file that `audit proof` wrote; `holdpoint audit verify --against {}` compares the store with a witness",
            args.file.display()
        );
        error.with_hint(hint)
    })?;
    match proof.check(&key) {
        Ok(()) => {
            let text = summary(&proof);
            let value = serde_json::json!({ "holds": true, "says": text, "heads": proof.heads() });
            out.answer(&value, |out| out.line(&format!("holds: {text}")))?;
            Ok(Exit::Confirmed)
        }
        Err(error) => {
            let problem = error.sentence();
            let value = serde_json::json!({ "holds": false, "problem": problem });
            out.answer(&value, |out| out.line(&problem))?;
            Ok(Exit::Rejected)
        }
    }
}

/// The statement that a valid proof shows.
fn summary(proof: &Proof) -> String {
    match proof {
        Proof::Inclusion { record, head, .. } => {
            sentences::record_is_included((record.seq, &record.kind, &record.hash), &head.store_id, head.seq)
        }
        Proof::Consistency { older, newer, .. } => {
            sentences::chain_begins_with(&newer.store_id, newer.seq, older.seq)
        }
    }
}
