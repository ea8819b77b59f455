//! A read-only look at a store: its properties, and whether its files, keys and whole history are sound.

use std::fs;
use std::path::Path;

use rusqlite::Connection;
use serde::Serialize;

use crate::chain::audit;
use crate::chain::chain_signature;
use crate::chain::person_rows;
use crate::database::migrate::{STORE, TELEMETRY};
use crate::database::open::{damaged, open_reader};
use crate::database::schema_shape::first_difference;
use crate::reading::witness_views::witnesses;
use crate::telemetry::telemetry_quarantine::wrong_shape;
use crate::terms::sqlite_error::sqlite_error;
use crate::upkeep::backup::count;
use crate::upkeep::key_files::check_key_files;
use crate::verification::verify::verify;
use holdpoint_approvals::keyfile;
use holdpoint_audit::chain::Head;
use holdpoint_audit::checkpoint::{Checkpoint, names, read_all};
use holdpoint_audit::witness::witness_heads;
use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_store::{Layout, StoreError, VerifyError, lock_owner, size};

/// Less free space than this gives a warning, bytes.
const FREE_BYTES_MIN: u64 = 64 << 20;

/// A store's properties, from its files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct StoreInfo {
    pub store_id: String,
    /// Version of the database's schema, and the newest that this program knows.
    pub schema: u64,
    pub schema_newest: u64,
    pub records: u64,
    /// Hash of the last record.
    pub head: String,
    /// The record of the signed end, with the root of its tree if signed.
    pub signed_at: Option<u64>,
    pub root: Option<String>,
    pub checkpoints: u64,
    pub witnesses: Vec<String>,
    pub versions: u64,
    /// Wall time of the first and of the last record, ms since 1970.
    pub first_wall_ms: Option<i64>,
    pub last_wall_ms: Option<i64>,
    /// Bytes of each file and folder.
    pub bytes: Vec<(String, u64)>,
    /// Bytes free on its file system.
    pub free_bytes: u64,
    /// The engine that has the store open, by process and start.
    pub in_use_by: Option<String>,
}

/// Reads a store's properties; writes nothing.
///
/// # Errors
/// If it cannot be read.
pub fn store_info(folder: &Path) -> Result<StoreInfo, StoreError> {
    let layout = Layout::new(folder);
    let connection = open_reader(&layout.database(), &STORE)?;
    let error = sqlite_error("read the store");
    connection.execute_batch("BEGIN").map_err(&error)?;
    let number = |sql: &str| -> Result<u64, StoreError> {
        connection.query_row(sql, [], |row| row.get(0)).map_err(&error)
    };
    let wall_ms = |order: &str| -> Option<i64> {
        let sql = format!("SELECT wall_ms FROM audit ORDER BY seq {order} LIMIT 1");
        connection.query_row(&sql, [], |row| row.get(0)).ok()
    };
    let head = audit::head(&connection).map_err(&error)?;
    let end = chain_signature::read(&connection).map_err(|problem| damaged(&layout.database(), &problem))?;
    let mut bytes = Vec::new();
    for (name, path) in [
        ("holdpoint.db", layout.database()),
        ("telemetry.db", layout.telemetry()),
        ("checkpoints", layout.checkpoints()),
        ("recordings", layout.recordings()),
        ("logs", layout.logs()),
        ("keys", layout.keys()),
    ] {
        let (mut files, mut size) = (0, 0);
        if path.exists() {
            count(&path, &mut files, &mut size)?;
            bytes.push((name.to_owned(), size));
        }
    }
    let file_system =
        rustix::fs::statvfs(folder).map_err(|error| StoreError::io("read", folder)(error.into()))?;
    Ok(StoreInfo {
        store_id: crate::database::store_id::read(&connection, &layout.database())?,
        schema: number("PRAGMA user_version")?,
        schema_newest: STORE.newest() as u64,
        records: head.seq,
        head: head.hash.to_string(),
        signed_at: end.as_ref().map(|end| end.seq),
        root: end.and_then(|end| end.root).map(|root| root.to_string()),
        checkpoints: if layout.checkpoints().is_dir() {
            names(&layout.checkpoints())?.len() as u64
        } else {
            0
        },
        witnesses: witnesses(&layout.database())?.into_iter().collect(),
        versions: number("SELECT count(*) FROM version")?,
        first_wall_ms: wall_ms("ASC"),
        last_wall_ms: wall_ms("DESC"),
        bytes,
        free_bytes: file_system.f_bavail.saturating_mul(file_system.f_frsize),
        in_use_by: lock_owner(&layout)?,
    })
}

/// Checks a store: its history with every row and sealed batch, shape, signed end, counts, keys, free space, locks,
/// witnesses. Recordings are not checked. Writes nothing.
///
/// # Errors
/// If the database cannot be opened.
pub fn check_store(folder: &Path) -> Result<Vec<StoreFinding>, StoreError> {
    let layout = Layout::new(folder);
    let info = store_info(folder)?;
    // Before the connection here: the verifier closes files, which drops the locks of this process.
    let verdict = history(&layout);
    let connection = open_reader(&layout.database(), &STORE)?;
    let failed = sqlite_error("read the store");
    connection.execute_batch("BEGIN").map_err(&failed)?;
    let mut checks = vec![match first_difference(&connection, &STORE).map_err(&failed)? {
        None => StoreFinding::Schema { present: info.schema, newest: info.schema_newest },
        Some(problem) => StoreFinding::WrongTables { problem },
    }];
    checks.push(verdict);
    let head = audit::head(&connection).map_err(&failed)?;
    checks.extend(telemetry_file(&layout)?);
    checks.push(counted_records(&connection, head)?);
    checks.push(signed_end(&layout, &connection, head));
    match person_rows::read(&connection, &info.store_id).map_err(&failed)? {
        Ok(persons) => checks.extend(check_key_files(&layout, &persons)),
        Err((name, problem)) => checks.push(StoreFinding::BadPerson { name, problem }),
    }
    let is_enough = info.free_bytes >= FREE_BYTES_MIN;
    checks.push(StoreFinding::FreeSpace { size: size(info.free_bytes), is_enough });
    checks.push(StoreFinding::InUse { owner: info.in_use_by });
    for folder in info.witnesses {
        checks.push(match witness_heads(&folder, &info.store_id) {
            Ok(heads) => StoreFinding::Witness { folder, heads },
            Err(problem) => StoreFinding::UnusableWitness { folder, problem },
        });
    }
    Ok(checks)
}

/// The verdict of the verifier: it alone finds a row that was edited with another program.
fn history(layout: &Layout) -> StoreFinding {
    let key = keyfile::read_public(&layout.store_public_key()).ok().map(|(key, _)| key);
    let report = match verify(&layout.database(), key.as_ref()) {
        Ok(report) => report,
        Err(error) => {
            let can_rebuild = matches!(error, VerifyError::State { .. });
            return StoreFinding::BadHistory { problem: error.to_string(), can_rebuild };
        }
    };
    StoreFinding::SoundHistory {
        records: report.records,
        batches: report.batches,
        signatures_checked: report.key_given,
    }
}

/// The shape of the telemetry file, if there is one; the verifier compares its batches with their seals.
fn telemetry_file(layout: &Layout) -> Result<Option<StoreFinding>, StoreError> {
    let path = layout.telemetry();
    if fs::symlink_metadata(&path).is_err() {
        return Ok(None);
    }
    let problem = match open_reader(&path, &TELEMETRY) {
        Ok(connection) => {
            wrong_shape(&connection, &TELEMETRY).map_err(sqlite_error("read the store's telemetry"))?
        }
        Err(StoreError::Refused { problem, .. }) => Some(problem),
        Err(error) => return Err(error),
    };
    Ok(Some(match problem {
        None => StoreFinding::TelemetryFile,
        Some(problem) => StoreFinding::WrongTelemetryFile { problem },
    }))
}

fn counted_records(connection: &Connection, head: Head) -> Result<StoreFinding, StoreError> {
    let counts = connection.query_row("SELECT count(*), coalesce(max(seq), 0) FROM audit", [], |row| {
        Ok((row.get::<_, u64>(0)?, row.get::<_, u64>(1)?))
    });
    let (count, last) = counts.map_err(sqlite_error("read the audit chain"))?;
    Ok(if (count, last) == (head.seq, head.seq) {
        StoreFinding::WholeChain { records: count }
    } else {
        StoreFinding::CutChain { records: count, last, recorded_end: head.seq }
    })
}

fn signed_end(layout: &Layout, connection: &Connection, head: Head) -> StoreFinding {
    let key = match keyfile::read_public(&layout.store_public_key()) {
        Ok((key, _)) => key,
        Err(error) => return StoreFinding::UnreadablePublicKey { problem: error.to_string() },
    };
    let end: Checkpoint = match chain_signature::read(connection) {
        Ok(Some(end)) => end,
        Ok(None) if head.seq == 0 => return StoreFinding::NothingToSign,
        Ok(None) => {
            let newest = read_all(&layout.checkpoints()).ok().and_then(|mut checkpoints| checkpoints.pop());
            return match newest.filter(|stored| stored.checkpoint.link.is_none()) {
                Some(stored) if stored.checkpoint.seq == head.seq => StoreFinding::SignedByCheckpoints,
                Some(stored) => StoreFinding::SignedUpTo { record: stored.checkpoint.seq },
                None => StoreFinding::UnsignedEnd,
            };
        }
        Err(problem) => return StoreFinding::BadSignedEnd { problem },
    };
    if !end.is_signed_by(&key) || (end.seq, end.head) != (head.seq, head.hash) {
        return StoreFinding::OtherSignedEnd;
    }
    match read_all(&layout.checkpoints()) {
        Err(bad) => StoreFinding::BadCheckpoint { file: bad.file, problem: bad.problem },
        Ok(checkpoints) => match checkpoints.last() {
            Some(newest) if newest.checkpoint.number() > end.number() => {
                StoreFinding::NewerCheckpoint { file: newest.file.clone() }
            }
            Some(_) | None => StoreFinding::SignedToEnd { checkpoints: checkpoints.len() },
        },
    }
}
