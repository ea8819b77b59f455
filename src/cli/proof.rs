//! `holdpoint audit proof | consistency | check-proof`: proofs of the audit chain that need no store.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};

use super::data::database;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile;
use holdpoint_registry::{Checkpoint, Layout, Proof, ProofError, kept_head, prove_consistency, prove_record};
use holdpoint_text::Hint;

/// The arguments of `audit proof`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct ProofArgs {
    /// The record.
    #[arg(value_name = "SEQ", value_parser = clap::value_parser!(u64).range(1..))]
    pub seq: u64,
    /// A new file [default: the standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The arguments of `audit consistency`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(group = ArgGroup::new("older").required(true))]
pub struct ConsistencyArgs {
    /// The record at which the earlier checkpoint was made.
    #[arg(long, value_name = "SEQ", group = "older")]
    pub from: Option<u64>,
    /// The earlier checkpoint, as it was kept elsewhere.
    #[arg(long, value_name = "FILE", group = "older")]
    pub against: Option<PathBuf>,
    /// A new file [default: the standard output].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The arguments of `audit check-proof`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct CheckProofArgs {
    /// What `audit proof` or `audit consistency` wrote.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The store's public key [default: that of the store].
    #[arg(long, value_name = "FILE")]
    pub public_key: Option<PathBuf>,
}

/// Proves that a record is in the chain.
///
/// # Errors
/// [`CliError`].
pub(super) fn record(context: &CliContext, args: &ProofArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let proof = prove_record(&database(&context.data)?, args.seq).map_err(CliError::usage)?;
    write(&proof, args.out.as_deref(), out)
}

/// Proves that the chain goes on from an earlier head.
///
/// # Errors
/// [`CliError`].
pub(super) fn consistency(
    context: &CliContext,
    args: &ConsistencyArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    let database = database(&context.data)?;
    let older = match (&args.against, args.from) {
        (Some(path), _) => Checkpoint::read(path)
            .map_err(|problem| CliError::usage(format!("{path:?} is no checkpoint: {problem}")))?,
        (None, Some(seq)) => kept_head(&context.data, seq).map_err(CliError::usage)?,
        (None, None) => return Err(CliError::usage("`--from SEQ` or `--against FILE` is needed".to_owned())),
    };
    let proof = prove_consistency(&database, &older).map_err(CliError::usage)?;
    write(&proof, args.out.as_deref(), out)
}

fn write(proof: &Proof, path: Option<&Path>, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let text = proof.text().map_err(CliError::internal)?;
    let Some(path) = path else {
        writeln!(out.sink(), "{text}")?;
        return Ok(Exit::Confirmed);
    };
    let cannot = |error: std::io::Error| CliError::usage(format!("cannot write {path:?}: {error}"));
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(cannot)?;
    writeln!(file, "{text}").and_then(|()| file.sync_all()).map_err(cannot)?;
    let (steps, bytes) = (steps(proof), text.len() + 1);
    let value = serde_json::json!({ "file": path.display().to_string(), "steps": steps, "bytes": bytes });
    out.answer(&value, |out| {
        out.line(&format!("wrote a proof of {steps} steps, {bytes} bytes, to {}", path.display()))
    })?;
    Ok(Exit::Confirmed)
}

fn steps(proof: &Proof) -> usize {
    match proof {
        Proof::Inclusion { path, .. } | Proof::Consistency { path, .. } => path.len(),
    }
}

/// Checks a proof with nothing but a public key.
///
/// # Errors
/// [`CliError`] if the file is no proof, or there is no key to check it with.
pub(super) fn check(
    context: &CliContext,
    args: &CheckProofArgs,
    out: &mut Output<'_>,
) -> Result<Exit, CliError> {
    let own = Layout::new(&context.data).store_public_key();
    let path = match &args.public_key {
        Some(path) => path.clone(),
        None if own.is_file() => own,
        None => {
            return Err(CliError::usage("a proof is checked with the store's public key".to_owned())
                .with_hint("name it with --public-key FILE; it is `keys/store.pub` of the store"));
        }
    };
    let (key, _) = keyfile::read_public(&path).map_err(CliError::usage)?;
    let proof = Proof::read(&args.file).map_err(CliError::usage)?;
    match proof.check(&key) {
        Ok(()) => {
            let said = said(&proof);
            let value = serde_json::json!({ "holds": true, "says": said, "heads": proof.heads() });
            out.answer(&value, |out| out.line(&format!("holds: {said}")))?;
            Ok(Exit::Confirmed)
        }
        Err(error @ (ProofError::Wrong(_) | ProofError::NoProof(_) | ProofError::Impossible { .. })) => {
            let problem = error.sentence();
            let value = serde_json::json!({ "holds": false, "problem": problem });
            out.answer(&value, |out| out.line(&problem))?;
            Ok(Exit::Rejected)
        }
        Err(error @ ProofError::Unreadable(_)) => Err(CliError::usage(error)),
    }
}

/// What a proof that holds shows.
fn said(proof: &Proof) -> String {
    match proof {
        Proof::Inclusion { record, head, .. } => format!(
            "record {} ({}, {}) is in the chain of the store {} that was signed at record {}",
            record.seq, record.kind, record.hash, head.store_id, head.seq
        ),
        Proof::Consistency { older, newer, .. } => format!(
            "the chain of the store {} that was signed at record {} begins with the one signed at record {}",
            newer.store_id, newer.seq, older.seq
        ),
    }
}
