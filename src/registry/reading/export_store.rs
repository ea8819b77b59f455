//! Writes a store's history in one file of JSON lines, for verification without this program.
//!
//! The first line names the form. The signed heads, the signed end, the records of the chain and the signed approvals
//! follow. The guide's page on records has the form in full, with every hash and signature.

use std::io::Write;
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;

use crate::chain::audit::{self, ExportError};
use crate::chain::chain_signature;
use crate::chain::compare::is_lost;
use crate::database::migrate::STORE;
use crate::database::open::open_reader;
use crate::database::store_id;
use crate::verification::check::{VerificationDepth, open_checked};
use holdpoint_audit::checkpoint::{Checkpoint, StoredCheckpoint, read_all};
use holdpoint_audit::export_line::{ExportHeader, ExportLine};
use holdpoint_store::StoreError;
use holdpoint_text::hex::hex;

/// The checkpoints of a moment of the database with this end: an engine may have written more since.
pub(crate) fn until(
    mut checkpoints: Vec<StoredCheckpoint>,
    end: Option<&Checkpoint>,
    last: u64,
) -> Vec<StoredCheckpoint> {
    checkpoints.retain(|StoredCheckpoint { checkpoint, .. }| {
        checkpoint.seq <= last && end.is_none_or(|end| checkpoint.number() <= end.number())
    });
    checkpoints
}

/// Which history is exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportScope {
    /// One whose records match the signatures; another is refused.
    Signed,
    /// The present content, unchecked.
    Unchecked,
}

/// Writes a store's whole history and returns how many records it has.
///
/// # Errors
/// If the store cannot be read, is not what was signed, or the file cannot be written.
pub fn export_store(
    database: &Path,
    exporting: ExportScope,
    public_key: Option<&VerifyingKey>,
    out: &mut dyn Write,
) -> Result<u64, ExportError> {
    let other = |error: StoreError| ExportError::Store(Box::new(error));
    let connection = match exporting {
        ExportScope::Signed => open_checked(database, VerificationDepth::Records),
        ExportScope::Unchecked => open_reader(database, &STORE),
    };
    let connection = connection.map_err(other)?;
    connection.execute_batch("BEGIN")?;
    let head = audit::head(&connection)?;
    let store_id = store_id::read(&connection, database).map_err(other)?;
    let bad = |problem: String| other(StoreError::invalid("signed end", "", problem));
    let end = chain_signature::read(&connection).map_err(bad)?;
    let folder = database.parent().unwrap_or(Path::new(".")).join("checkpoints");
    let checkpoints =
        read_all(&folder).map_err(|bad| other(StoreError::invalid("checkpoint", bad.file, bad.problem)))?;
    let mut put = |line: &ExportLine| -> Result<(), ExportError> {
        let mut text = Vec::new();
        line.write(&mut text)?;
        Ok(out.write_all(&text)?)
    };
    let public_key = public_key.map(|key| hex(key.as_bytes()));
    put(&ExportLine::Export(ExportHeader::new(store_id, head.seq, public_key)))?;
    for stored in until(checkpoints, end.as_ref(), head.seq) {
        put(&ExportLine::Head(stored.checkpoint))?;
    }
    if let Some(end) = end {
        put(&ExportLine::End(end))?;
    }
    audit::for_each(&connection, 1, |record| put(&ExportLine::Record(Box::new(record.into()))))?;
    for signed in approvals(&connection)? {
        put(&ExportLine::Approval(Box::new(serde_json::from_str(&signed)?)))?;
    }
    out.flush()?;
    Ok(head.seq)
}

/// The texts of the approvals that are not lost.
fn approvals(connection: &Connection) -> rusqlite::Result<Vec<String>> {
    let mut select = connection.prepare("SELECT signed FROM approval ORDER BY seq")?;
    let texts = select.query_map([], |row| row.get::<_, String>(0))?;
    texts.filter(|text| text.as_ref().map_or(true, |text| !is_lost(text))).collect()
}
