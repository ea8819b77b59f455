//! The requirements of an existing store before it is used: a whole chain, tables that match it, the shape of a
//! released schema, and the invariants. Reads only.

use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;

use crate::chain::chain_signature::{self, SigningFault};
use crate::chain::compare::{check_approvals, compare};
use crate::chain::fold::{ChainFault, Fold, FoldError, ReadProgress};
use crate::chain::invariants::check_registry;
use crate::chain::person_rows;
use crate::chain::row_images::ChainedTable;
use crate::chain::snapshot;
use crate::chain::structure;
use crate::database::migrate::STORE;
use crate::database::open::{damaged, not_the_chain, open_reader, quick_check, refused};
use crate::database::schema_shape::first_difference;
use crate::database::store_id;
use crate::terms::row_limit::{error_message, first_too_long, is_reached};
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::replay::columns_otherwise;
use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::{StoredCheckpoint, read_all};
use holdpoint_audit::head_copies::ChainPoint;
use holdpoint_audit::witness::{WitnessProblems, compare_witnesses};
use holdpoint_governance::ids::Digest;
use holdpoint_store::{Layout, RefusalCause, StoreError};

/// The most records that are applied again only to name the different columns of a row.
const RECORDS_REPLAYED_MAX: u64 = 20_000;

/// Checks an existing store. Returns the fold of its chain.
///
/// # Errors
/// [`StoreError::Refused`] with the first thing that is wrong.
pub(crate) fn check_existing(
    layout: &Layout,
    key: &VerifyingKey,
    problems: &WitnessProblems,
    watch: ReadProgress<'_>,
) -> Result<Fold, StoreError> {
    let database = layout.database();
    let connection = open_reader(&database, &STORE)?;
    check_lengths(&connection, &database)?;
    let store_id = store_id::read(&connection, &database)?;
    let known = snapshot::read(&layout.checkpoints(), &connection, &store_id, key);
    let fold = checked_chain(&connection, &database, known, watch)?;
    if fold.end.seq > 0 {
        check_key(&store_id, key, &database)?;
    }
    let checkpoints = stored_checkpoints(layout)?;
    check_newest_checkpoint(&fold, layout, &checkpoints, (&store_id, key))?;
    check_signed(&fold, &connection, layout, &checkpoints, (&store_id, key))?;
    check_tables(&fold, &connection, &database, &store_id)?;
    let chain_at = |seq: u64| chain_at(&fold, &connection, seq);
    compare_witnesses(fold.witnesses.iter(), (&store_id, key), fold.end.seq, chain_at, problems).map_err(
        |(file, fault)| {
            let problem = format!("the head of a witness in {file:?} contradicts it: {fault}");
            refused(&database, &problem, RefusalCause::Witness)
        },
    )?;
    Ok(fold)
}

/// The chain's record at a number, also one that a snapshot replaces.
fn chain_at(fold: &Fold, connection: &Connection, seq: u64) -> Option<ChainPoint> {
    let hash = fold.hash(seq).or_else(|| {
        let row = connection.query_row("SELECT hash FROM audit WHERE seq = ?1", [seq], |row| row.get(0));
        row.ok().map(Digest::from_bytes)
    })?;
    // The writer sends the newest head at once; of the end the root is at hand.
    let root = (seq == fold.end.seq).then(|| fold.tree.root());
    Some(ChainPoint { hash, root })
}

/// How much of a store is compared with its signatures before it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VerificationDepth {
    /// Every row, and the records since the newest snapshot: enough to read the tables.
    Rows,
    /// Every record: to export or count records.
    Records,
}

/// Opens a store for display or decisions, after checking it against its signed chain.
///
/// # Errors
/// [`StoreError::Refused`] if it does not match, or if it cannot be opened.
pub(crate) fn open_checked(database: &Path, reading: VerificationDepth) -> Result<Connection, StoreError> {
    let connection = open_reader(database, &STORE)?;
    let begin = |sql| connection.execute_batch(sql).map_err(sqlite_error("read the registry"));
    // One moment of the store: an engine may be writing to it.
    begin("BEGIN")?;
    check_lengths(&connection, database)?;
    let store_id = store_id::read(&connection, database)?;
    let layout = Layout::new(database.parent().unwrap_or(Path::new(".")));
    let key = keyfile::read_public(&layout.store_public_key()).ok();
    let key = key.map(|(key, _)| key);
    if let Some(key) = &key {
        check_key(&store_id, key, database)?;
    }
    let known = key
        .filter(|_| reading == VerificationDepth::Rows)
        .and_then(|key| snapshot::read(&layout.checkpoints(), &connection, &store_id, &key));
    let fold = checked_chain(&connection, database, known, &mut |_| ())?;
    // An engine may be writing checkpoints: its start and `verify` check that none is missing.
    if layout.store_public_key().is_file() {
        let checkpoints = stored_checkpoints(&layout)?;
        chain_signature::check_end(&fold, &connection, &checkpoints, (&store_id, key.as_ref()))
            .map_err(|found| refused_unsigned(database, found))?;
    }
    if reading != VerificationDepth::Records {
        check_tables(&fold, &connection, database, &store_id)?;
    }
    begin("COMMIT")?;
    Ok(connection)
}

/// No row beside the chain is longer than it may be.
fn check_lengths(connection: &Connection, database: &Path) -> Result<(), StoreError> {
    let found = first_too_long(connection).map_err(sqlite_error("read the registry"))?;
    found.map_or(Ok(()), |problem| Err(not_the_chain(database, &problem)))
}

/// The chain, whole or from a snapshot on, and its end.
fn checked_chain(
    connection: &Connection,
    database: &Path,
    known: Option<Fold>,
    watch: ReadProgress<'_>,
) -> Result<Fold, StoreError> {
    let mut fold = known.unwrap_or_else(Fold::empty);
    fold.read_records(connection, watch).map_err(refused_chain(connection, database))?;
    fold.check_end(connection).map_err(refused_chain(connection, database))?;
    Ok(fold)
}

/// The records of the chain, each linked to the one before.
pub(crate) fn checked_records(connection: &Connection, database: &Path) -> Result<Fold, StoreError> {
    let mut fold = Fold::empty();
    fold.read_records(connection, &mut |_| ()).map_err(refused_chain(connection, database))?;
    Ok(fold)
}

/// The message for an unsound chain.
pub(crate) fn refused_chain(
    connection: &Connection,
    database: &Path,
) -> impl FnOnce(FoldError) -> StoreError {
    move |error| match error {
        FoldError::Fault(fault @ ChainFault::Row { .. }) => not_the_chain(database, &fault.to_string()),
        FoldError::Fault(fault @ ChainFault::Record { .. }) => damaged(database, &fault.to_string()),
        FoldError::Read { seq, source } => {
            let problem = if is_reached(&source) { None } else { quick_check(connection).err() };
            let unreadable = || format!("audit record {seq} cannot be read: {}", error_message(&source));
            damaged(database, &problem.unwrap_or_else(unreadable))
        }
    }
}

/// The tables match the chain, and the schema is a released one.
pub(crate) fn check_tables(
    fold: &Fold,
    connection: &Connection,
    database: &Path,
    store_id: &str,
) -> Result<(), StoreError> {
    let unreadable = |error: rusqlite::Error| {
        not_the_chain(database, &format!("it cannot be read: {}", error_message(&error)))
    };
    if let Some(fault) = compare(fold, connection).map_err(unreadable)? {
        return Err(not_the_chain(database, &fault_description(fold, connection, &fault)));
    }
    if let Err(error) = check_approvals(connection, store_id, None).map_err(unreadable)? {
        return Err(not_the_chain(database, &error.to_string()));
    }
    if let Err((name, problem)) = person_rows::read(connection, store_id).map_err(unreadable)? {
        return Err(not_the_chain(database, &format!("the person {name} is bad: {problem}")));
    }
    if let Some(problem) = first_difference(connection, &STORE).map_err(unreadable)? {
        return Err(not_the_chain(database, &problem));
    }
    structure::check_at_start(connection, fold)
        .map_err(|problem| not_the_chain(database, &format!("it is damaged: {problem}")))?;
    let broken = check_registry(connection).map_err(unreadable)?;
    broken.first().map_or(Ok(()), |violation| Err(damaged(database, &violation.to_string())))
}

/// A fault with the different columns, as far as the chain shows them.
fn fault_description(fold: &Fold, connection: &Connection, fault: &ChainFault) -> String {
    let columns = match fault {
        ChainFault::Row { table, key, .. } if fold.end.seq <= RECORDS_REPLAYED_MAX => {
            ChainedTable::named(table).map(|table| columns_otherwise(fold, connection, table, key))
        }
        ChainFault::Row { .. } | ChainFault::Record { .. } => None,
    };
    match columns.as_deref() {
        None | Some([]) => fault.to_string(),
        Some(columns) => format!("{fault} ({})", columns.join(", ")),
    }
}

pub(crate) fn stored_checkpoints(layout: &Layout) -> Result<Vec<StoredCheckpoint>, StoreError> {
    let folder = layout.checkpoints();
    read_all(&folder).map_err(|bad| refused(&folder.join(bad.file), &bad.problem, RefusalCause::Checkpoint))
}

/// The newest checkpoint is of this store, and of this chain.
pub(crate) fn check_newest_checkpoint(
    fold: &Fold,
    layout: &Layout,
    checkpoints: &[StoredCheckpoint],
    (store_id, key): (&str, &VerifyingKey),
) -> Result<(), StoreError> {
    let Some(StoredCheckpoint { file, checkpoint }) = checkpoints.last() else { return Ok(()) };
    if checkpoint.store_id != store_id || !checkpoint.is_signed_by(key) {
        return Err(damaged(&layout.checkpoints().join(file), "it was not signed by this store"));
    }
    if fold.hash(checkpoint.seq) != Some(checkpoint.head) {
        let problem = format!("audit record {} is missing or is not the one in {file}", checkpoint.seq);
        return Err(damaged(&layout.database(), &problem));
    }
    Ok(())
}

/// The chain ends at its signed end, and no checkpoint is missing.
pub(crate) fn check_signed(
    fold: &Fold,
    connection: &Connection,
    layout: &Layout,
    checkpoints: &[StoredCheckpoint],
    (store_id, key): (&str, &VerifyingKey),
) -> Result<(), StoreError> {
    chain_signature::check(fold, connection, checkpoints, (store_id, Some(key)))
        .map_err(|found| refused_unsigned(&layout.database(), found))
}

fn refused_unsigned(database: &Path, found: SigningFault) -> StoreError {
    match found {
        SigningFault::Chain { seq, problem } => {
            damaged(database, &ChainFault::Record { seq, problem }.to_string())
        }
        SigningFault::Signature(problem) => refused(database, &problem, RefusalCause::Unsigned),
    }
}

/// The key is the store's own, as far as its id shows.
pub(crate) fn check_key(store_id: &str, key: &VerifyingKey, database: &Path) -> Result<(), StoreError> {
    holdpoint_audit::store_id::check_key(store_id, key)
        .map_err(|problem| refused(database, &problem, RefusalCause::ForeignKey))
}
