//! Compares the tables with the fold of the chain, in every column that decides anything.
//!
//! A row's digest covers its columns, except those that cannot be in the chain because they differ between stores of
//! equal runs or are made by SQLite. These are compared with other data:
//!
//! | column | compared with |
//! | --- | --- |
//! | `version.id` | the order of registration in the chain |
//! | `approval.signed` | its own signature, and the claim that the chain holds |
//! | `command.id`, `last_seq`, `receipt` | the records they name: all commands together cover the chain without a gap |
//! | `audit_head` | the chain's last record |
//! | `meta.signed_end` | the store's key, which signed it over the end of the chain |
//! | `meta.store_id` | the checkpoints, which are signed over it, and the approvals |
//!
//! Two columns are compared with nothing. `audit.wall_ms` is displayed and selects the start of `metrics --since DATE`;
//! decisions use the wall time of the newest record alone, which the signed end and checkpoints hold. `command.digest`
//! distinguishes a retry from another command under its id, and ids of later commands are unpredictable
//! ([`command_id`](holdpoint_store::command_id)). An edit of it, or of the id, only makes a retry be refused or run
//! again. A receipt without records is ignored.

use std::collections::BTreeMap;

use ed25519_dalek::VerifyingKey;
use rusqlite::{Connection, OptionalExtension};

use crate::chain::fold::{ChainFault, Fold, HEAD_ROW};
use crate::chain::row_images::{ChainedTable, RowName, all_rows};
use holdpoint_approvals::SignedApproval;
use holdpoint_audit::display_records::DisplayRecords;
use holdpoint_audit::history_error::HistoryError;
use holdpoint_governance::ids::canonical_json;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::Receipt;
use holdpoint_text::hex::hex;

fn row(table: &'static str, key: &str, problem: impl Into<String>) -> ChainFault {
    ChainFault::Row { table, key: key.to_owned(), problem: problem.into() }
}

/// The first difference between the tables and the chain, `None` if there is none.
///
/// # Errors
/// If the tables cannot be read.
pub(crate) fn compare(fold: &Fold, connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
    if let Some(fault) = chained(fold, connection)? {
        return Ok(Some(fault));
    }
    if let Some(fault) = order(fold, connection)? {
        return Ok(Some(fault));
    }
    if let Some(fault) = single_rows(connection)? {
        return Ok(Some(fault));
    }
    commands(fold, connection)
}

/// Every difference of a row that the chain vouches for.
///
/// # Errors
/// If the tables cannot be read.
pub(crate) fn differing(fold: &Fold, connection: &Connection) -> rusqlite::Result<BTreeMap<RowName, String>> {
    let mut found = BTreeMap::new();
    let mut seen = 0;
    for table in ChainedTable::ALL {
        all_rows(connection, table, |key, digest| match fold.row(table, &key) {
            Some(vouched) if vouched.digest == digest => seen += 1,
            Some(vouched) => {
                seen += 1;
                found.insert((table, key), format!("it differs from record {}", vouched.seq));
            }
            None => {
                found.insert((table, key), "no record names it".to_owned());
            }
        })?;
    }
    if seen == fold.rows.len() {
        return Ok(found);
    }
    let mut there = std::collections::BTreeSet::new();
    for table in ChainedTable::ALL {
        all_rows(connection, table, |key, _| {
            there.insert((table, key));
        })?;
    }
    for (name, vouched) in &fold.rows {
        if !there.contains(name) {
            found.insert(name.clone(), format!("it is missing; record {} made it", vouched.seq));
        }
    }
    Ok(found)
}

fn chained(fold: &Fold, connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
    let differing = differing(fold, connection)?;
    Ok(differing.into_iter().next().map(|((table, key), problem)| row(table.name(), &key, problem)))
}

/// Versions have the numbers of their registration: a family's stored model refers to them by this order.
fn order(fold: &Fold, connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
    let mut select = connection.prepare("SELECT id, name FROM version ORDER BY id")?;
    let mut rows = select.query([])?;
    for (expected, name) in (1i64..).zip(&fold.order) {
        let Some(found) = rows.next()? else { break };
        let (id, found): (i64, String) = (found.get(0)?, found.get(1)?);
        if (id, &found) != (expected, name) {
            let problem = format!("its id is {id}, but {name} was registered as number {expected}");
            return Ok(Some(row("version", &found, problem)));
        }
    }
    Ok(None)
}

/// Tables with one row have only that row.
fn single_rows(connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
    let stray: Option<String> = connection
        .query_row("SELECT key FROM meta WHERE key NOT IN ('store_id', 'signed_end') LIMIT 1", [], |row| {
            row.get(0)
        })
        .optional()?;
    if let Some(key) = stray {
        return Ok(Some(row("meta", &key, "no program writes it")));
    }
    let stray: Option<i64> = connection
        .query_row("SELECT id FROM audit_head WHERE id <> ?1 LIMIT 1", [HEAD_ROW], |row| row.get(0))
        .optional()?;
    Ok(stray.map(|id| row("audit_head", &id.to_string(), "there is one end of the chain")))
}

/// A command's receipt: it names records that are there with that hash, and the row versions that these set.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn checked_receipt(
    fold: &Fold,
    id: &str,
    last_seq: u64,
    text: &str,
) -> Result<Receipt, &'static str> {
    let Ok(receipt) = serde_json::from_str::<Receipt>(text) else { return Err("its receipt cannot be read") };
    let spans = if receipt.first_seq == 0 {
        receipt.last_seq == 0
    } else {
        receipt.first_seq <= last_seq && receipt.last_seq == last_seq
    };
    if receipt.command_id != id || !spans || canonical_json(&receipt).ok().as_deref() != Some(text) {
        return Err("its receipt is not the one of this command");
    }
    if fold.hash(last_seq) != Some(receipt.head) {
        return Err("its receipt names a record that is not there, or another hash");
    }
    let set = fold.states_set(receipt.first_seq, receipt.last_seq);
    if !receipt.row_versions.iter().map(|(id, version)| (id.to_string(), *version)).eq(set) {
        return Err("its receipt has row versions that its records did not set");
    }
    Ok(receipt)
}

/// Every receipt matches the chain, and together they name every record.
fn commands(fold: &Fold, connection: &Connection) -> rusqlite::Result<Option<ChainFault>> {
    let mut select = connection.prepare("SELECT id, last_seq, receipt FROM command WHERE last_seq > ?1")?;
    let mut rows = select.query([fold.since.seq])?;
    // By their first record: the last one, and the command.
    let mut covered: BTreeMap<u64, (u64, String)> = BTreeMap::new();
    while let Some(found) = rows.next()? {
        let (id, last_seq, text): (String, u64, String) = (found.get(0)?, found.get(1)?, found.get(2)?);
        let receipt = match checked_receipt(fold, &id, last_seq, &text) {
            Ok(receipt) => receipt,
            Err(problem) => return Ok(Some(row("command", &id, problem))),
        };
        if receipt.first_seq != 0 && covered.insert(receipt.first_seq, (last_seq, id.clone())).is_some() {
            return Ok(Some(row("command", &id, "its receipt names records of another command")));
        }
    }
    let mut next = fold.since.seq + 1;
    for (first, (last, id)) in covered {
        if first != next {
            let problem =
                format!("its receipt begins at record {first}; the commands before end at {}", next - 1);
            return Ok(Some(row("command", &id, problem)));
        }
        next = last + 1;
    }
    if next != fold.end.seq + 1 {
        return Ok(Some(row("command", "", format!("the command that wrote record {next} is missing"))));
    }
    Ok(None)
}

/// The records of a whole store about displayed texts.
///
/// # Errors
/// If the store cannot be read; then the first record that is bad.
fn displays(connection: &Connection) -> rusqlite::Result<Result<DisplayRecords, (u64, String)>> {
    let mut select = connection
        .prepare("SELECT seq, kind, subject, body FROM audit WHERE kind IN (?1, ?2, ?3) ORDER BY seq")?;
    let mut rows = select.query(DisplayRecords::KINDS.map(RecordKind::name))?;
    let mut read = DisplayRecords::default();
    while let Some(row) = rows.next()? {
        let (seq, kind): (u64, String) = (row.get(0)?, row.get(1)?);
        let (subject, body): (String, String) = (row.get(2)?, row.get(3)?);
        let kind = DisplayRecords::KINDS.into_iter().find(|known| known.name() == kind);
        if let Err(problem) = read.take(kind, &subject, &body) {
            return Ok(Err((seq, problem)));
        }
    }
    Ok(Ok(read))
}

/// Every approval is signed, for this store, matches its claim in the chain, and covers the displayed text on record.
/// Returns their number.
///
/// # Errors
/// The first one that does not, or the bad record of a displayed text.
pub(crate) fn check_approvals(
    connection: &Connection,
    store_id: &str,
    key: Option<&VerifyingKey>,
) -> rusqlite::Result<Result<u64, HistoryError>> {
    let shown = match displays(connection)? {
        Ok(shown) => shown,
        Err((seq, problem)) => return Ok(Err(HistoryError::Record { seq, problem })),
    };
    let key = key.map(|key| hex(key.as_bytes()));
    let mut select = connection.prepare("SELECT nonce, claim, signed FROM approval ORDER BY seq")?;
    let mut rows = select.query([])?;
    let mut good = 0;
    while let Some(row) = rows.next()? {
        let (nonce, claim, text): (String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        if is_lost(&text) {
            continue;
        }
        let checked = match serde_json::from_str::<SignedApproval>(&text) {
            Err(error) => Err(error.to_string()),
            Ok(signed) => check_approval(&signed, &nonce, &claim, &text, store_id)
                .and_then(|()| shown.check(signed.approval(), key.as_deref())),
        };
        if let Err(problem) = checked {
            return Ok(Err(HistoryError::Approval { nonce, problem }));
        }
        good += 1;
    }
    Ok(Ok(good))
}

pub(crate) fn check_approval(
    signed: &SignedApproval,
    nonce: &str,
    claim: &str,
    text: &str,
    store_id: &str,
) -> Result<(), String> {
    signed.verify_signature().map_err(|error| error.to_string())?;
    let approval = signed.approval();
    let recorded = approval.claim_digest().to_string() == claim && approval.nonce.as_str() == nonce;
    if !recorded || canonical_json(signed).ok().as_deref() != Some(text) {
        return Err("it differs from its record".to_owned());
    }
    if approval.store_id != store_id {
        return Err(format!("it was made for the store {:?}", approval.store_id));
    }
    Ok(())
}

pub(crate) fn is_lost(text: &str) -> bool {
    text.starts_with(LOST)
}

/// The start of the mark of a lost text.
pub(crate) const LOST: &str = "{\"lost-in-rebuild\":";
