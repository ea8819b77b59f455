//! Rebuilds a store's tables from its audit chain, after an edit or damage.
//!
//! The chain is the truth: it must be whole, and reach the newest checkpoint. The original code applies every record
//! again, into a database beside the damaged one. Texts that a record does not repeat (long ones, and all texts of old
//! records) come from the damaged row. They count only if the row then has the digest in its record. Measurements
//! (`evidence.json`) and signatures (`approval.signed`) may be lost: a mark replaces them, which counts neither as
//! evidence nor as approval, and the rebuild's record names them. Any other loss is refused by name, and nothing is
//! changed.
//!
//! The damaged file is kept under another name. Only then the rebuilt one replaces it, in one step.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use rusqlite::{Connection, params};
use serde_json::{Value, json};

use crate::chain::audit;
use crate::chain::chain_signature;
use crate::chain::compare::{compare, differing};
use crate::chain::fold::Fold;
use crate::chain::row_images::{ChainedTable, RowName, differing_columns, row_digest};
use crate::chain::structure;
use crate::database::migrate::STORE;
use crate::database::open::{
    damaged, make, not_the_chain, open_reader, refused, remove_database, truncate_log,
};
use crate::terms::row_limit;
use crate::terms::sqlite_error::sqlite_error;
use crate::transaction::rebuild_losses::{lost_mark, text_of};
use crate::transaction::replay::{ReapplyError, replay};
use crate::verification::authorizations::first_unauthorized;
use crate::verification::check::{
    check_key, check_newest_checkpoint, check_signed, check_tables, checked_records, refused_chain,
    stored_checkpoints,
};
use holdpoint_approvals::keyfile;
use holdpoint_audit::chain::Head;
use holdpoint_audit::checkpoint::{
    Checkpoint, CheckpointLink, StoredCheckpoint, check_links, check_newest, count_earlier,
};
use holdpoint_audit::files::sync_folder;
use holdpoint_audit::merkle::Frontier;
use holdpoint_audit::rebuild_report::{DifferingRow, RebuildRecordChange, RebuildReport};
use holdpoint_governance::ids::canonical_json;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{EngineLock, Layout, Receipt, RefusalCause, StoreError};

/// Unsigned records that a refusal names.
const UNSIGNED_NAMED_MAX: usize = 8;
/// The start of the name of a command whose row was lost.
const LOST_COMMAND: &str = "rebuilt";

/// How a rebuild treats unsigned records at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnsignedRecords {
    /// Refuses, and names them.
    Refuse,
    /// Takes them unchanged, and records that they were unsigned.
    Take,
}

/// Rebuilds the tables of a store from its chain. `by` is the requesting system user, JSON text. Returns a summary;
/// `None` if there was nothing to repair.
///
/// # Errors
/// [`StoreError`] if an engine has the store, its chain is not whole, or a row cannot be rebuilt; nothing was changed.
pub fn rebuild(
    folder: &Path,
    unsigned_records: UnsignedRecords,
    by: &str,
    wall_ms: i64,
) -> Result<Option<RebuildReport>, StoreError> {
    let layout = Layout::new(folder);
    let database = layout.database();
    fs::symlink_metadata(&database).map_err(StoreError::io("read", &database))?;
    let requester: Value =
        serde_json::from_str(by).map_err(|error| StoreError::invalid("caller", by, error))?;
    let _lock = EngineLock::take(&layout)?;
    let secret = layout.store_key();
    let key = keyfile::read_secret(&secret).map_err(|source| StoreError::Key { path: secret, source })?;
    let damaged_store = open_reader(&database, &STORE)?;
    row_limit::lift(&damaged_store).map_err(sqlite_error("read the damaged database"))?;
    let fold = checked_records(&damaged_store, &database)?;
    let checkpoints = stored_checkpoints(&layout)?;
    let store_id = match checkpoints.last() {
        Some(StoredCheckpoint { checkpoint, .. }) => checkpoint.store_id.clone(),
        None => crate::database::store_id::read(&damaged_store, &database)?,
    };
    let by = (store_id.as_str(), &key.verifying_key());
    check_key(&store_id, by.1, &database)?;
    check_newest_checkpoint(&fold, &layout, &checkpoints, by)?;
    let signing = check_signed(&fold, &damaged_store, &layout, &checkpoints, by);
    if let Err(error @ StoreError::Refused { cause, .. }) = signing
        && cause != RefusalCause::Unsigned
    {
        return Err(error);
    }
    let (link, unsigned) = signed_before(&fold, &damaged_store, &checkpoints, by);
    let sound = fold
        .check_end(&damaged_store)
        .map_err(refused_chain(&damaged_store, &database))
        // Later queries of the tables use their indexes.
        .and_then(|()| check_indexes(&damaged_store, &database))
        .and_then(|()| check_tables(&fold, &damaged_store, &database, &store_id))
        .and_then(|()| check_signed(&fold, &damaged_store, &layout, &checkpoints, by));
    let problem = match sound {
        Ok(()) if has_id(&damaged_store, &store_id) => return Ok(None),
        Ok(()) => "its id is not the one its checkpoints are signed over".to_owned(),
        Err(StoreError::Refused {
            problem,
            cause: RefusalCause::NotTheChain | RefusalCause::Unsigned,
            ..
        }) => problem,
        // Records that are missing at the end cannot be restored.
        Err(error) => return Err(error),
    };
    // A rebuild cannot replace an administrator's authorization of a profile.
    let reading = sqlite_error("read the words on profiles");
    let signed = fold.end.seq.saturating_sub(unsigned);
    if let Some((seq, problem)) = first_unauthorized(&damaged_store, signed).map_err(reading)? {
        let problem = format!("no signature covers the record {seq}, and {problem}");
        return Err(refused(&database, &problem, RefusalCause::UnsignedProfile));
    }
    if unsigned > 0 && unsigned_records == UnsignedRecords::Refuse {
        return Err(would_take(&database, &damaged_store, fold.end, unsigned));
    }
    let part = database.with_extension("rebuilt");
    remove_database(&part)?;
    let mut new_store = make(&part, &STORE)?;
    row_limit::lift(&new_store).map_err(sqlite_error("write the rebuilt database"))?;
    let damaged_path = free_name(&layout, fold.end)?;
    let summary = RebuildSummary { by: requester, problem, damaged_file: file_name(&damaged_path), unsigned };
    let rebuilt = fill(&mut new_store, &damaged_store, &fold, (&store_id, summary), wall_ms);
    let rebuilt = rebuilt.inspect_err(|_| drop(remove_database(&part)))?;
    let head = audit::head(&new_store).map_err(sqlite_error("read the audit chain"))?;
    let root = audit::tree_after(&new_store, &Frontier::empty())?.root();
    let wall_ms = audit::wall_ms_of(&new_store, head.seq)?;
    let end = Checkpoint::sign(&store_id, (head, root), wall_ms, link, None, &key);
    chain_signature::write(&new_store, &end).inspect_err(|_| drop(remove_database(&part)))?;
    new_store.close().map_err(|(_, error)| sqlite_error("write the rebuilt database")(error))?;
    drop(damaged_store);
    File::open(&part).and_then(|file| file.sync_all()).map_err(StoreError::io("write", &part))?;
    // The damaged file's log is merged into the file: otherwise it would be taken for the rebuilt one's.
    truncate_log(&database)?;
    fs::hard_link(&database, &damaged_path)
        .map_err(StoreError::io("keep the damaged file as", &damaged_path))?;
    fs::rename(&part, &database).map_err(StoreError::io("rename", &part))?;
    sync_folder(layout.folder())?;
    end.write(&layout.checkpoints())?;
    Ok(Some(rebuilt))
}

/// Every index matches its table: a false index shows or hides rows, and is rebuilt with the tables.
fn check_indexes(damaged_store: &Connection, database: &Path) -> Result<(), StoreError> {
    let forged = |problem: String| not_the_chain(database, &problem);
    structure::check_file(database).map_err(forged)?;
    let summed = Fold::read_noting(damaged_store, Vec::new().into_iter().collect())
        .map_err(refused_chain(damaged_store, database))?;
    structure::check_indexes(damaged_store, &summed).map_err(forged)
}

/// A refusal that names the unsigned records.
fn would_take(database: &Path, damaged_store: &Connection, end: Head, unsigned: u64) -> StoreError {
    let first = (end.seq + 1).saturating_sub(unsigned);
    let mut named = Vec::new();
    // Unreadable records are not named.
    drop(audit::for_each::<rusqlite::Error>(damaged_store, first, |record| {
        if named.len() < UNSIGNED_NAMED_MAX {
            named.push(format!("{} {} {}", record.seq, record.kind, record.subject).trim_end().to_owned());
        }
        Ok(())
    }));
    let more = if unsigned > named.len() as u64 { ", ..." } else { "" };
    let problem =
        format!("no signature covers the records {first} to {} ({}{more})", end.seq, named.join(", "));
    refused(database, &problem, RefusalCause::TakesUnsigned)
}

fn has_id(connection: &Connection, store_id: &str) -> bool {
    text_of(connection, "SELECT value FROM meta WHERE +key = ?1", "store_id").as_deref() == Some(store_id)
}

/// The rebuild's record beside the rebuilt rows.
struct RebuildSummary {
    by: Value,
    problem: String,
    damaged_file: String,
    unsigned: u64,
}

/// The place of the rebuilt store's checkpoint, and the number of unsigned records at the end.
fn signed_before(
    fold: &Fold,
    damaged_store: &Connection,
    checkpoints: &[StoredCheckpoint],
    (store_id, key): (&str, &ed25519_dalek::VerifyingKey),
) -> (CheckpointLink, u64) {
    let newest = checkpoints.last().map(|stored| &stored.checkpoint);
    let end = chain_signature::valid(damaged_store, store_id, Some(key)).ok().flatten();
    let whole = check_links(checkpoints).is_ok()
        && end.as_ref().is_none_or(|end| check_newest(end, checkpoints).is_ok());
    let mut link = CheckpointLink::after_all(checkpoints);
    if !whole {
        link.gap = true;
        link.earlier = count_earlier(checkpoints);
        link.number = link.number.max(end.as_ref().map_or(0, Checkpoint::number) + 1);
    }
    let signed_to = newest.into_iter().chain(&end).map(|signed| signed.seq).max().unwrap_or(0);
    (link, fold.end.seq.saturating_sub(signed_to))
}

/// An unused name for the damaged file.
fn free_name(layout: &Layout, end: Head) -> Result<PathBuf, StoreError> {
    let named = |nth: u32| layout.folder().join(format!("holdpoint-damaged-{}-{nth}.db", end.seq));
    let free = (1..=1_000).map(named).find(|path| fs::symlink_metadata(path).is_err());
    free.ok_or_else(|| {
        StoreError::invalid("store folder", layout.folder().display(), "one with fewer damaged databases")
    })
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Fills a new database with the chain and its rows, and adds the record of it.
fn fill(
    new_store: &mut Connection,
    damaged_store: &Connection,
    fold: &Fold,
    (store_id, summary): (&str, RebuildSummary),
    wall_ms: i64,
) -> Result<RebuildReport, StoreError> {
    let error = sqlite_error("write the rebuilt database");
    let tx = new_store.transaction().map_err(&error)?;
    tx.execute("UPDATE meta SET value = ?1 WHERE key = 'store_id'", [store_id]).map_err(&error)?;
    let mut lost = Vec::new();
    audit::for_each::<ReapplyError>(damaged_store, 0, |record| {
        lost.extend(replay(&tx, damaged_store, fold, &record)?);
        audit::copy(&tx, &record)?;
        Ok(())
    })
    .map_err(|ReapplyError(error)| error)?;
    lost.extend(mark_lost_evidence(&tx, fold)?);
    if let Some(((table, key), problem)) = first_unrepaired(&tx, fold, &lost)? {
        let problem = format!(
            "the {} {key:?} cannot be rebuilt: {problem}, and the chain does not repeat its text",
            table.name()
        );
        return Err(damaged(damaged_store.path().map_or(Path::new(""), Path::new), &problem));
    }
    copy_commands(&tx, damaged_store, fold)?;
    let found = differing(fold, damaged_store).map_err(&error)?;
    let mut differed = Vec::new();
    for ((table, key), problem) in found {
        let columns = differing_columns(damaged_store, &tx, table, &key).map_err(&error)?;
        differed.push(DifferingRow { table: table.name().to_owned(), key, problem, columns });
    }
    let named = |(table, key): &RowName| (table.name().to_owned(), key.clone());
    let rebuilt = RebuildReport {
        from_seq: fold.end.seq,
        from_hash: fold.end.hash,
        problem: summary.problem,
        differed,
        lost: lost.iter().map(named).collect(),
        kept_as: summary.damaged_file,
        unsigned: summary.unsigned,
    };
    let change = RebuildRecordChange { change: "store-rebuilt".to_owned(), by: summary.by, rebuilt };
    write_record(&tx, fold.end, &change, &lost, wall_ms)?;
    let after = Fold::read(&tx).map_err(|fault| StoreError::Invariant(format!("{fault:?}")))?;
    if let Some(fault) = compare(&after, &tx).map_err(&error)? {
        return Err(StoreError::Invariant(format!("the rebuilt store differs from its chain: {fault}")));
    }
    // A database that a start would refuse replaces nothing.
    check_tables(&after, &tx, damaged_store.path().map_or(Path::new(""), Path::new), store_id)?;
    tx.commit().map_err(&error)?;
    Ok(change.rebuilt)
}

/// Evidence whose text does not match its record: a mark replaces it.
fn mark_lost_evidence(new_store: &Connection, fold: &Fold) -> Result<Vec<RowName>, StoreError> {
    let error = sqlite_error("compare the rebuilt database");
    let mut lost = Vec::new();
    for (table, key) in differing(fold, new_store).map_err(&error)?.into_keys() {
        if table == ChainedTable::Evidence {
            new_store
                .execute("UPDATE evidence SET json = ?2 WHERE seq = ?1", params![key, lost_mark(&key)])
                .map_err(&error)?;
            lost.push((table, key));
        }
    }
    Ok(lost)
}

/// The first row that neither matches the chain nor is lost.
fn first_unrepaired(
    new_store: &Connection,
    fold: &Fold,
    lost: &[RowName],
) -> Result<Option<(RowName, String)>, StoreError> {
    let found = differing(fold, new_store).map_err(sqlite_error("compare the rebuilt database"))?;
    Ok(found.into_iter().find(|(row, _)| row.0 != ChainedTable::Evidence || !lost.contains(row)))
}

/// Copies the receipts that match the chain. Records of unknown commands get a name that no command uses: a retry of
/// that command would be applied again.
fn copy_commands(new_store: &Connection, damaged_store: &Connection, fold: &Fold) -> Result<(), StoreError> {
    let error = sqlite_error("copy the receipts");
    let mut select =
        damaged_store.prepare("SELECT id, digest, last_seq, receipt FROM command").map_err(&error)?;
    let mut rows = select.query([]).map_err(&error)?;
    let mut good: BTreeMap<u64, (String, String, u64, String)> = BTreeMap::new();
    while let Some(row) = rows.next().map_err(&error)? {
        let read = || Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?));
        let Ok((id, digest, last_seq, text)): rusqlite::Result<(String, String, u64, String)> = read() else {
            continue;
        };
        let Ok(receipt) = crate::chain::compare::checked_receipt(fold, &id, last_seq, &text) else {
            continue;
        };
        if receipt.first_seq == 0 {
            keep_command(new_store, (&id, &digest, last_seq, &text))?;
        } else {
            good.insert(receipt.first_seq, (id, digest, last_seq, text));
        }
    }
    let mut next = 1;
    for (first, (id, digest, last_seq, text)) in good {
        if first < next {
            continue;
        }
        if first > next {
            keep_lost_command(new_store, fold, next, first - 1)?;
        }
        keep_command(new_store, (&id, &digest, last_seq, &text))?;
        next = last_seq + 1;
    }
    if next <= fold.end.seq {
        keep_lost_command(new_store, fold, next, fold.end.seq)?;
    }
    Ok(())
}

fn keep_command(
    new_store: &Connection,
    (id, digest, last_seq, receipt): (&str, &str, u64, &str),
) -> Result<(), StoreError> {
    new_store
        .prepare_cached("INSERT INTO command (id, digest, last_seq, receipt) VALUES (?1, ?2, ?3, ?4)")
        .and_then(|mut insert| insert.execute(params![id, digest, last_seq, receipt]))
        .map(drop)
        .map_err(sqlite_error("keep the receipt"))
}

/// A receipt for records whose own is lost.
fn keep_lost_command(new_store: &Connection, fold: &Fold, first: u64, last: u64) -> Result<(), StoreError> {
    let unreadable = |error: String| StoreError::invalid("receipt", first, error);
    let mut row_versions = Vec::new();
    for (name, row_version) in fold.states_set(first, last) {
        row_versions.push((name.parse().map_err(|_| unreadable(name.clone()))?, row_version));
    }
    let head = fold.hash(last).ok_or_else(|| unreadable("there is no such record".to_owned()))?;
    let command_id = format!("{LOST_COMMAND}-{first}-{last}");
    let receipt =
        Receipt { command_id: command_id.clone(), first_seq: first, last_seq: last, head, row_versions };
    let text = canonical_json(&receipt).map_err(|error| unreadable(error.to_string()))?;
    keep_command(new_store, (&command_id, &"0".repeat(64), last, &text))
}

/// Adds the record of the rebuild, and the command that wrote it.
fn write_record(
    new_store: &Connection,
    end: Head,
    change: &RebuildRecordChange,
    lost: &[RowName],
    wall_ms: i64,
) -> Result<(), StoreError> {
    let mut rows = Vec::new();
    for (table, key) in lost {
        let digest = row_digest(new_store, *table, key).map_err(sqlite_error("read a row back"))?;
        rows.push(json!([table.name(), key, digest]));
    }
    let kind = RecordKind::StoreRebuilt;
    let body = canonical_json(&json!({ "change": change, "rows": rows }))
        .map_err(|error| StoreError::invalid("record", kind.name(), error))?;
    let wall_ms = wall_ms.max(audit::wall_ms_of(new_store, end.seq)?.unwrap_or(0));
    let head = audit::append(new_store, (end.at_ms, wall_ms), kind, "", body)?;
    let command_id = format!("{LOST_COMMAND}-{}", head.seq);
    let receipt = Receipt {
        command_id: command_id.clone(),
        first_seq: head.seq,
        last_seq: head.seq,
        head: head.hash,
        row_versions: Vec::new(),
    };
    let text =
        canonical_json(&receipt).map_err(|error| StoreError::invalid("receipt", &command_id, error))?;
    keep_command(new_store, (&command_id, &"0".repeat(64), head.seq, &text))
}
