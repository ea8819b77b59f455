//! The verifier: judges whether a store's history can be trusted, and names the first record that cannot.
//!
//! Needs the database file and, to judge checkpoints, the store's public key. Reads `checkpoints/` and `telemetry.db`
//! beside the file if they exist. Never writes.

use std::fs;
use std::path::{Path, PathBuf};

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;

use crate::chain::audit::{self, head};
use crate::chain::chain_signature::{self, SigningFault};
use crate::chain::compare::{check_approvals, compare};
use crate::chain::fold::{ChainFault, Fold, FoldError};
use crate::chain::invariants::{check_acknowledged, check_registry};
use crate::chain::person_rows;
use crate::chain::structure;
use crate::chain::telemetry_seals::{BatchState, absent};
use crate::database::migrate::{STORE, TELEMETRY};
use crate::database::open::open_reader;
use crate::database::schema_shape::first_difference;
use crate::database::store_id;
use crate::telemetry::telemetry_file::check_batch;
use crate::telemetry::telemetry_quarantine::wrong_shape;
use crate::terms::row_limit;
use crate::terms::sqlite_error::sqlite_error;
use crate::verification::authorizations::check_authorizations;
use holdpoint_audit::checkpoint::{BadCheckpointFile, Checkpoint, StoredCheckpoint, read_all};
use holdpoint_audit::head_copies::{ChainPoint, HeadCopy, HeadFault, check_copy, read_copies, read_witness};
use holdpoint_audit::history_error::HistoryError;
use holdpoint_audit::witness::folder_of;
use holdpoint_governance::ids::Digest;
use holdpoint_store::{MissingBatches, VerifyError, VerifyReport};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatabaseLocation {
    /// In its store: keys, checkpoints and telemetry must be beside it, and its witnesses are read.
    Store,
    /// Elsewhere: missing companions may not have been copied, and it is older than the witnesses' heads.
    Copy,
}

/// Further inputs of a verification.
#[derive(Clone, Copy)]
pub struct VerifyOptions<'a> {
    /// The store's public key; without one no signature is checked.
    pub key: Option<&'a VerifyingKey>,
    /// Files and folders with signed heads that were kept elsewhere.
    pub against: &'a [PathBuf],
    /// Whether it is the store in its place, or a copy of one.
    pub place: DatabaseLocation,
    /// Gets the progress: the step, the finished part, and the total.
    pub tell: &'a dyn Fn(&'static str, u64, u64),
}

/// Files of a witness that are no heads and are named.
const STRAYS_NAMED_MAX: usize = 3;
/// Where a store has its checkpoints and its keys, beside its database.
const CHECKPOINTS: &str = "checkpoints";
const KEYS: &str = "keys";

fn bad_file(BadCheckpointFile { file, problem }: BadCheckpointFile) -> HistoryError {
    HistoryError::Checkpoint { file, problem }
}

fn unreadable(source: rusqlite::Error) -> VerifyError {
    VerifyError::Damaged(row_limit::error_message(&source))
}

/// Verifies the store in its place that has this database file.
///
/// # Errors
/// As [`verify_against`].
pub fn verify(database: &Path, public_key: Option<&VerifyingKey>) -> Result<VerifyReport, VerifyError> {
    verify_against(
        database,
        &VerifyOptions { key: public_key, against: &[], place: DatabaseLocation::Store, tell: &|_, _, _| {} },
    )
}

/// Verifies a copy of a store, which may have been copied without what lay beside it.
///
/// # Errors
/// As [`verify_against`].
pub fn verify_copy(database: &Path, public_key: Option<&VerifyingKey>) -> Result<VerifyReport, VerifyError> {
    verify_against(
        database,
        &VerifyOptions { key: public_key, against: &[], place: DatabaseLocation::Copy, tell: &|_, _, _| {} },
    )
}

/// Verifies the store in this database file, also against heads that were kept elsewhere.
///
/// # Errors
/// [`VerifyError`], the first thing found: file, chain, checkpoints, copies, end, state, invariants, approvals, telemetry.
pub fn verify_against(database: &Path, options: &VerifyOptions<'_>) -> Result<VerifyReport, VerifyError> {
    let public_key = options.key;
    let folder = database.parent().unwrap_or(Path::new("."));
    // Before the records: an engine may be writing both.
    let mut stored = read_all(&folder.join(CHECKPOINTS)).map_err(bad_file)?;
    let connection = open_reader(database, &STORE)?;
    // One moment of the store: an engine may be writing to it.
    connection.execute_batch("BEGIN").map_err(unreadable)?;
    if let Some(problem) = row_limit::first_too_long(&connection).map_err(unreadable)? {
        return Err(VerifyError::Damaged(problem));
    }
    let sizes = stored.iter().map(|entry| entry.checkpoint.seq).collect();
    (options.tell)("records", 0, head(&connection).map_err(unreadable)?.seq);
    // The structure of the file is independent of the records: both are checked in parallel.
    let (fold, file) = std::thread::scope(|scope| {
        let file = scope.spawn(|| structure::check_file(database));
        (Fold::read_noting(&connection, sizes), file.join())
    });
    let mut fold = fold.map_err(|error| match error {
        FoldError::Fault(fault) => of_fault(fault),
        FoldError::Read { seq, source } => {
            HistoryError::Record { seq, problem: row_limit::error_message(&source) }.into()
        }
    })?;
    file.unwrap_or_else(|_| Err("looking at its structure failed".to_owned()))
        .map_err(VerifyError::Damaged)?;
    structure::check_indexes(&connection, &fold).map_err(VerifyError::Damaged)?;
    let store_id = store_id::read(&connection, database)?;
    if let Ok(Some(end)) = chain_signature::read(&connection)
        && end.number() > stored.last().map_or(0, |entry| entry.checkpoint.number()) + 1
    {
        stored = read_all(&folder.join(CHECKPOINTS)).map_err(bad_file)?;
        stored.retain(|entry| entry.checkpoint.number() <= end.number());
    }
    if let Some(key) = public_key {
        holdpoint_audit::store_id::check_key(&store_id, key).map_err(HistoryError::Unsigned)?;
    }
    let checkpoints = check_checkpoints((&stored, &connection), &fold, &store_id, public_key)?;
    let by = (store_id.as_str(), public_key);
    let mut copies = Vec::new();
    for path in options.against {
        copies.extend(read_copies(path, &store_id, &chain_signature::read_elsewhere).map_err(bad_copy)?);
    }
    let mut copy_count = check_copies(&copies, &mut fold, by, |_| false)?;
    let in_place = options.place == DatabaseLocation::Store;
    let (witness_heads, witnesses_silent) =
        if in_place { heads_of_witnesses(&fold, &store_id) } else { (Vec::new(), Vec::new()) };
    // An engine may have written since, and its witnesses may have later heads.
    let since = |copy: &HeadCopy| is_on_record(database, &copy.checkpoint);
    copy_count += check_copies(&witness_heads, &mut fold, by, since)?;
    let fold = fold;
    // A copied database has neither checkpoints nor keys beside it.
    let alone = !in_place && stored.is_empty() && !folder.join(KEYS).is_dir();
    let signed = match chain_signature::read(&connection) {
        Ok(None) if alone => Ok(()),
        Ok(_) | Err(_) if alone => chain_signature::check_end(&fold, &connection, &stored, by).map(drop),
        Ok(_) | Err(_) => chain_signature::check(&fold, &connection, &stored, by),
    };
    signed.map_err(|found| match found {
        SigningFault::Chain { seq, problem } => HistoryError::Record { seq, problem },
        SigningFault::Signature(problem) => HistoryError::Unsigned(problem),
    })?;
    if let Some(fault) = compare(&fold, &connection).map_err(unreadable)? {
        return Err(of_fault(fault));
    }
    let mut violations = check_registry(&connection).map_err(unreadable)?;
    violations.extend(check_acknowledged(&connection).map_err(unreadable)?);
    if let Some(violation) = violations.first() {
        return Err(VerifyError::Invariant(violation.to_string()));
    }
    let approvals = check_approvals(&connection, &store_id, public_key).map_err(unreadable)??;
    let persons = person_rows::read(&connection, &store_id)
        .map_err(unreadable)?
        .map_err(|(name, problem)| HistoryError::Person { name, problem })?;
    check_authorizations(&connection, &persons).map_err(unreadable)??;
    if let Some(problem) = first_difference(&connection, &STORE).map_err(unreadable)? {
        return Err(VerifyError::Damaged(problem));
    }
    let mut report = VerifyReport {
        store_id,
        records: fold.end.seq,
        head: fold.end.hash,
        root: fold.tree.root(),
        checkpoints,
        copies: copy_count,
        witnesses_silent,
        key_given: public_key.is_some(),
        approvals,
        persons: persons.all().count() as u64,
        taken_unsigned: fold.taken_unsigned.clone(),
        confirmed: persons.confirmed().count() as u64,
        batches: 0,
        batches_pruned: 0,
        batches_missed: 0,
        batches_unseen: 0,
        batches_missing: None,
    };
    check_telemetry(&folder.join("telemetry.db"), alone, (&fold, &mut report), options.tell)?;
    Ok(report)
}

fn of_fault(fault: ChainFault) -> VerifyError {
    match fault {
        ChainFault::Record { seq, problem } => HistoryError::Record { seq, problem }.into(),
        ChainFault::Row { table, key, problem } => VerifyError::State { table, key, problem },
    }
}

/// Every checkpoint names an existing record with that hash, and this key signed it.
fn check_checkpoints(
    (kept, connection): (&[StoredCheckpoint], &Connection),
    fold: &Fold,
    store_id: &str,
    public_key: Option<&VerifyingKey>,
) -> Result<u64, HistoryError> {
    let mut good = 0;
    for StoredCheckpoint { file, checkpoint } in kept {
        let bad = |problem: String| HistoryError::Checkpoint { file: file.clone(), problem };
        checkpoint.check_origin(store_id, public_key).map_err(bad)?;
        match fold.hash(checkpoint.seq) {
            Some(hash) if hash == checkpoint.head => {
                let wall_ms = audit::wall_ms_of(connection, checkpoint.seq);
                let wall_ms = wall_ms.map_err(|error| bad(error.to_string()))?;
                checkpoint.check_record(fold.root(checkpoint.seq), wall_ms).map_err(bad)?;
                good += 1;
            }
            Some(_) => {
                let problem = format!("the checkpoint {file:?} differs: history was rewritten");
                return Err(HistoryError::Record { seq: checkpoint.seq, problem });
            }
            None => {
                let problem = format!("it is missing, although the checkpoint {file:?} was made after it");
                return Err(HistoryError::Record { seq: fold.end.seq + 1, problem });
            }
        }
    }
    Ok(good)
}

/// This store signed every head that was kept elsewhere, and its chain begins with it. Returns their number.
fn check_copies(
    copies: &[HeadCopy],
    fold: &mut Fold,
    by: (&str, Option<&VerifyingKey>),
    since: impl Fn(&HeadCopy) -> bool,
) -> Result<u64, HistoryError> {
    fold.note_roots(copies.iter().map(|copy| copy.checkpoint.seq).collect());
    let fold = &*fold;
    let chain_at = |seq: u64| Some(ChainPoint { hash: fold.hash(seq)?, root: fold.root(seq) });
    for copy in copies {
        let checked = check_copy(&copy.checkpoint, by, fold.end.seq, chain_at);
        if let Err(fault) = checked
            && !(copy.checkpoint.seq > fold.end.seq && since(copy))
        {
            return Err(HistoryError::Copy { file: copy.file.clone(), fault });
        }
    }
    Ok(copies.len() as u64)
}

/// The heads of the store's witnesses, and the unreadable witnesses.
fn heads_of_witnesses(fold: &Fold, store_id: &str) -> (Vec<HeadCopy>, Vec<String>) {
    let (mut copies, mut silent) = (Vec::new(), Vec::new());
    for witness in &fold.witnesses {
        let problem_line =
            |BadCheckpointFile { file, problem }: BadCheckpointFile| format!("{file}: {problem}");
        match read_witness(&folder_of(witness, store_id)) {
            Ok((heads, strays)) => {
                copies.extend(heads);
                let more = strays.len().saturating_sub(STRAYS_NAMED_MAX);
                silent.extend(strays.into_iter().take(STRAYS_NAMED_MAX).map(problem_line));
                if more > 0 {
                    silent.push(format!("{witness}: {more} files more that are no heads"));
                }
            }
            Err(unreadable) => silent.push(problem_line(unreadable)),
        }
    }
    (copies, silent)
}

/// Whether a head is of the present chain.
fn is_on_record(database: &Path, checkpoint: &Checkpoint) -> bool {
    let hash = open_reader(database, &STORE).and_then(|connection| {
        connection
            .query_row("SELECT hash FROM audit WHERE seq = ?1", [checkpoint.seq], |row| row.get(0))
            .map_err(sqlite_error("read the audit chain"))
    });
    hash.is_ok_and(|hash| Digest::from_bytes(hash) == checkpoint.head)
}

fn bad_copy(BadCheckpointFile { file, problem }: BadCheckpointFile) -> HistoryError {
    HistoryError::Copy { file, fault: HeadFault::Unreadable(problem) }
}

fn check_telemetry(
    path: &Path,
    alone: bool,
    (fold, report): (&Fold, &mut VerifyReport),
    tell: &dyn Fn(&'static str, u64, u64),
) -> Result<(), VerifyError> {
    let is_there = fs::symlink_metadata(path).is_ok();
    if fold.batches.is_empty() && !is_there {
        return Ok(());
    }
    let connection = if is_there { Some(open_reader(path, &TELEMETRY)?) } else { None };
    let wrong = connection.as_ref().map(|connection| wrong_shape(connection, &TELEMETRY));
    if let Some(problem) = wrong.transpose().map_err(unreadable)?.flatten() {
        return Err(VerifyError::TelemetryFile(problem));
    }
    for (nth, sealed) in (0..).zip(&fold.batches) {
        tell("telemetry batches", nth, fold.batches.len() as u64);
        let bad = |problem: String| VerifyError::Telemetry { batch: sealed.batch, seq: sealed.seq, problem };
        let account = &fold.telemetry;
        let state = match &connection {
            Some(connection) => check_batch(connection, sealed.batch, sealed.digest, account)
                .map_err(|error| bad(error.to_string()))?,
            None => absent(account, sealed.batch, None),
        };
        match state {
            BatchState::Matches => {
                report.batches += 1;
                continue;
            }
            BatchState::Pruned => report.batches_pruned += 1,
            BatchState::Missed => report.batches_missed += 1,
            BatchState::Bad(_) if alone && connection.is_none() => report.batches_unseen += 1,
            BatchState::Bad(problem) => return Err(bad(problem.to_owned())),
        }
        report.batches_missing =
            Some(MissingBatches::with(report.batches_missing, (sealed.batch, sealed.seq)));
    }
    Ok(())
}
