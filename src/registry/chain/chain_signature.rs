//! The signed end: a checkpoint in the database, written by every transaction together with its records.
//!
//! Without the store's key, an attacker cannot add, change or remove a record behind the newest checkpoint and leave a
//! signed end. The end refers to the newest checkpoint file by number and digest, so that removed files are noticed. An
//! attacker with an earlier signed end can restore the whole store to it: only a copy elsewhere shows that.

use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::{Connection, OptionalExtension, params};

use crate::chain::audit;
use crate::chain::fold::Fold;
use crate::database::open::open_sound;
use crate::terms::row_limit;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::checkpoint::{Checkpoint, StoredCheckpoint, check_links, check_newest};
use holdpoint_store::StoreError;

/// Its key in `meta`.
pub(crate) const KEY: &str = "signed_end";

/// A problem with the signatures of a chain.
#[derive(Clone, Debug)]
pub(crate) enum SigningFault {
    /// A signed record is not in the chain: the chain was cut or rewritten.
    Chain { seq: u64, problem: String },
    /// The signature is missing, or is not of this store.
    Signature(String),
}

/// Writes it; the caller holds the transaction.
pub(crate) fn write(connection: &Connection, end: &Checkpoint) -> Result<(), StoreError> {
    let text =
        serde_json::to_string(end).map_err(|error| StoreError::invalid("signed end", end.seq, error))?;
    connection
        .prepare_cached(
            "INSERT INTO meta (key, value) VALUES (?1, ?2) ON CONFLICT (key) DO UPDATE SET value = ?2",
        )
        .and_then(|mut put| put.execute(params![KEY, text]))
        .map(drop)
        .map_err(sqlite_error("sign the end of the audit chain"))
}

/// Reads it, `None` if there is none.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn read(connection: &Connection) -> Result<Option<Checkpoint>, String> {
    let text: Option<String> = connection
        .query_row("SELECT value FROM meta WHERE +key = ?1", [KEY], |row| row.get(0))
        .optional()
        .map_err(|error| row_limit::error_message_for("meta", &error))?;
    let read = |text: String| -> Result<Checkpoint, serde_json::Error> {
        let end: Checkpoint = serde_json::from_str(&text)?;
        if serde_json::to_string(&end)? == text {
            return Ok(end);
        }
        Err(serde::de::Error::custom("it is not as it was written"))
    };
    text.map(read).transpose().map_err(|error: serde_json::Error| error.to_string())
}

/// Reads that of a database elsewhere, `None` if there is none.
///
/// # Errors
/// What is wrong with it, or with the database.
pub(crate) fn read_elsewhere(database: &Path) -> Result<Option<Checkpoint>, String> {
    open_sound(database)
        .map_err(|error| row_limit::error_message(&error))
        .and_then(|connection| read(&connection))
}

/// The signed end, if this store and this key signed it; without a key, signatures are not checked.
pub(crate) fn valid(
    connection: &Connection,
    store_id: &str,
    key: Option<&VerifyingKey>,
) -> Result<Option<Checkpoint>, SigningFault> {
    let bad =
        |problem: String| SigningFault::Signature(format!("the signed end of the audit chain: {problem}"));
    let Some(end) = read(connection).map_err(bad)? else { return Ok(None) };
    if end.store_id != store_id || end.link.is_none() || key.is_some_and(|key| !end.is_signed_by(key)) {
        return Err(bad("it was not signed by this store".to_owned()));
    }
    Ok(Some(end))
}

/// The chain ends at its signed end. `checkpoints` are the checkpoints beside it.
pub(crate) fn check_end(
    fold: &Fold,
    connection: &Connection,
    checkpoints: &[StoredCheckpoint],
    (store_id, key): (&str, Option<&VerifyingKey>),
) -> Result<Option<Checkpoint>, SigningFault> {
    let last = fold.end.seq;
    let Some(end) = valid(connection, store_id, key)? else {
        // Earlier versions signed checkpoints alone, the last of them at the end.
        let earlier = checkpoints.last().filter(|stored| stored.checkpoint.link.is_none());
        let signed_to = earlier.map(|stored| stored.checkpoint.seq);
        let problem = match signed_to {
            _ if last == 0 => return Ok(None),
            Some(seq) if seq == last => return Ok(None),
            Some(seq) => format!("no signature covers the records after {seq}"),
            None => format!("no signature covers the end of the audit chain, record {last}"),
        };
        return Err(SigningFault::Signature(problem));
    };
    // A store without signed records needs no signature.
    if fold.hash(end.seq) == Some(end.head) || (end.seq == 0 && last == 0) {
        if end.seq == last {
            if end.root.is_some() && end.root != fold.root(end.seq) {
                return Err(SigningFault::Signature(
                    "its tree head is not the one of these records".to_owned(),
                ));
            }
            check_wall_time(&end, connection)?;
            return Ok(Some(end));
        }
        return Err(SigningFault::Signature(format!("no signature covers the records after {}", end.seq)));
    }
    if end.seq > last {
        let problem = format!("it is missing: the chain was signed up to {}", end.seq);
        return Err(SigningFault::Chain { seq: last + 1, problem });
    }
    let problem = "it is not the one that was signed: history was rewritten".to_owned();
    Err(SigningFault::Chain { seq: end.seq, problem })
}

/// The signed wall time of a record equals the record's own.
fn check_wall_time(of: &Checkpoint, connection: &Connection) -> Result<(), SigningFault> {
    let Some(signed_ms) = of.wall_ms else { return Ok(()) };
    let found = audit::wall_ms_of(connection, of.seq);
    match found {
        Ok(Some(found_ms)) if found_ms == signed_ms => Ok(()),
        Ok(_) => {
            let problem = "its wall time is not the one that was signed".to_owned();
            Err(SigningFault::Chain { seq: of.seq, problem })
        }
        Err(error) => Err(SigningFault::Signature(error.to_string())),
    }
}

/// The chain ends at its signed end, and no checkpoint is missing.
pub(crate) fn check(
    fold: &Fold,
    connection: &Connection,
    checkpoints: &[StoredCheckpoint],
    by: (&str, Option<&VerifyingKey>),
) -> Result<(), SigningFault> {
    let end = check_end(fold, connection, checkpoints, by)?;
    if end.as_ref().and_then(|end| end.link.as_ref()).is_some_and(|link| link.gap) {
        return Ok(());
    }
    check_links(checkpoints)
        .map_err(|bad| SigningFault::Signature(format!("the checkpoint {:?}: {}", bad.file, bad.problem)))?;
    for stored in checkpoints {
        check_wall_time(&stored.checkpoint, connection)?;
    }
    let Some(end) = end else { return Ok(()) };
    check_newest(&end, checkpoints).map_err(|problem| {
        SigningFault::Signature(format!("the signed end of the audit chain and the checkpoints: {problem}"))
    })
}
