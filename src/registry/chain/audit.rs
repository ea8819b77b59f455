//! The audit chain in its table: appends and reads records. [`verify`](crate::verify()) checks the chain.

use std::borrow::Cow;
use std::io::{ErrorKind, Write};

use rusqlite::{Connection, OptionalExtension, Row, params};

use crate::terms::row_limit::error_message;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::ascii_json::ascii_json;
use holdpoint_audit::chain::Head;
use holdpoint_audit::merkle::Frontier;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_store::{StoreError, StoreFailure};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Columns, in the order [`read`] takes them.
pub(crate) const COLUMNS: &str = "seq, prev, hash, at_ms, kind, subject, body, wall_ms";

/// Reads a row of [`COLUMNS`].
pub(crate) fn read(row: &Row<'_>) -> rusqlite::Result<AuditRecord> {
    Ok(AuditRecord {
        seq: row.get(0)?,
        prev: Digest::from_bytes(row.get(1)?),
        hash: Digest::from_bytes(row.get(2)?),
        at_ms: row.get(3)?,
        kind: Lenient::read(row.get(4)?),
        subject: row.get(5)?,
        body: row.get(6)?,
        wall_ms: row.get(7)?,
    })
}

/// Reads the end of the chain.
pub(crate) fn head(connection: &Connection) -> rusqlite::Result<Head> {
    let (seq, hash) = connection
        .prepare_cached("SELECT seq, hash FROM audit_head WHERE id = 1")?
        .query_row([], |row| Ok((row.get::<_, u64>(0)?, Digest::from_bytes(row.get(1)?))))?;
    let at_ms = connection
        .prepare_cached("SELECT at_ms FROM audit WHERE seq = ?1")?
        .query_row([seq], |row| row.get(0))
        .optional()?
        .unwrap_or(0);
    Ok(Head { seq, hash, at_ms })
}

/// The wall time of a record, ms since 1970; `None` if it has none, or is not there.
pub(crate) fn wall_ms_of(connection: &Connection, seq: u64) -> Result<Option<i64>, StoreError> {
    connection
        .prepare_cached("SELECT wall_ms FROM audit WHERE seq = ?1")
        .and_then(|mut select| select.query_row([seq], |row| row.get(0)).optional())
        .map(|found: Option<i64>| found.filter(|wall_ms| *wall_ms > 0))
        .map_err(sqlite_error("read when the newest record was written"))
}

/// Appends one record; the caller holds the write transaction.
pub(crate) fn append(
    connection: &Connection,
    (at_ms, wall_ms): (u64, i64),
    kind: RecordKind,
    subject: &str,
    body: String,
) -> Result<Head, StoreError> {
    let error = sqlite_error("append to the audit chain");
    let before = head(connection).map_err(&error)?;
    let mut record = AuditRecord {
        seq: before.seq + 1,
        prev: before.hash,
        hash: before.hash,
        at_ms,
        kind: kind.into(),
        subject: subject.to_owned(),
        body,
        wall_ms,
    };
    record.hash = record.expected_hash();
    copy(connection, &record)?;
    crate::fp!("audit-inserted");
    Ok(Head { seq: record.seq, hash: record.hash, at_ms })
}

/// Appends a record as it is; the caller holds the write transaction.
pub(crate) fn copy(connection: &Connection, record: &AuditRecord) -> Result<(), StoreError> {
    let error = sqlite_error("append to the audit chain");
    let sql = "INSERT INTO audit (seq, prev, hash, at_ms, kind, subject, body, wall_ms)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
    let kind = record.kind.to_string();
    connection
        .prepare_cached(sql)
        .and_then(|mut insert| {
            insert.execute(params![
                record.seq,
                record.prev.bytes(),
                record.hash.bytes(),
                record.at_ms,
                kind,
                record.subject,
                record.body,
                record.wall_ms
            ])
        })
        .map_err(&error)?;
    connection
        .prepare_cached("UPDATE audit_head SET seq = ?1, hash = ?2 WHERE id = 1")
        .and_then(|mut update| update.execute(params![record.seq, record.hash.bytes()]))
        .map(drop)
        .map_err(&error)
}

/// A tree with the records that came after it; the caller holds the transaction.
pub(crate) fn tree_after(connection: &Connection, tree: &Frontier) -> Result<Frontier, StoreError> {
    let mut tree = tree.clone();
    let mut grow = || -> rusqlite::Result<()> {
        let mut select = connection.prepare_cached("SELECT hash FROM audit WHERE seq > ?1 ORDER BY seq")?;
        let mut rows = select.query([tree.size()])?;
        while let Some(row) = rows.next()? {
            tree.push(&Digest::from_bytes(row.get(0)?));
        }
        Ok(())
    };
    grow().map_err(sqlite_error("read the audit chain"))?;
    Ok(tree)
}

/// Calls `visit` with each record from `from_seq` on, in order, one at a time.
pub(crate) fn for_each<E: From<rusqlite::Error>>(
    connection: &Connection,
    from_seq: u64,
    mut visit: impl FnMut(AuditRecord) -> Result<(), E>,
) -> Result<(), E> {
    let sql = format!("SELECT {COLUMNS} FROM audit WHERE seq >= ?1 ORDER BY seq");
    let mut select = connection.prepare(&sql)?;
    let mut rows = select.query([from_seq])?;
    while let Some(row) = rows.next()? {
        visit(read(row)?)?;
    }
    Ok(())
}

#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    #[error("the audit chain cannot be read: {}", error_message(.0))]
    Read(#[from] rusqlite::Error),
    #[error("the audit chain cannot be written out: {0}")]
    Write(#[from] std::io::Error),
    #[error(transparent)]
    Store(Box<StoreError>),
    #[error("the audit record cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
}

impl Hint for ExportError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Store(error) => return error.details(),
            Self::Read(_) => ErrorDetails::from(ErrorReason::Store).with_cause(StoreFailure::Database.name()),
            Self::Write(_) => ErrorReason::Output.into(),
            Self::Json(_) => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Read(_) | Self::Write(_) | Self::Json(_) => None,
        }
    }
}

/// Writes the chain from `from_seq` on as JSON lines and returns their number; a closed pipe is a clean end.
///
/// Every character outside printable ASCII is written as a `\u` escape, so that the lines are safe on a terminal.
///
/// # Errors
/// [`ExportError`].
pub(crate) fn export(
    connection: &Connection,
    from_seq: u64,
    out: &mut dyn Write,
) -> Result<u64, ExportError> {
    let mut written = 0;
    let ended = for_each(connection, from_seq, |record| {
        let line = ascii_json(&record)?;
        out.write_all(line.as_bytes())?;
        out.write_all(b"\n")?;
        written += 1;
        Ok::<(), ExportError>(())
    })
    .and_then(|()| Ok(out.flush()?));
    match ended {
        Err(ExportError::Write(error)) if error.kind() == ErrorKind::BrokenPipe => Ok(written),
        Err(error) => Err(error),
        Ok(()) => Ok(written),
    }
}
