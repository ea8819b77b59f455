//! A store's history in one file of JSON lines, for verification without this program.
//!
//! The first line names the form. The signed heads, the signed end, the records of the chain and the signed approvals
//! follow. The guide's page on records has the form in full, with every hash and signature.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;
use serde::Serialize;

use super::audit::{self, ExportError};
use super::chain_signature;
use super::check::{VerificationDepth, open_checked};
use super::checkpoint::{Checkpoint, StoredCheckpoint, read_all};
use super::compare::is_lost;
use super::error::StoreError;
use super::export_line::{ExportHeader, ExportLine, START_OF_FILE, next_line};
use super::export_verify::ExportedChain;
use super::migrate::STORE;
use super::open::open_reader;
use super::store_id;
use super::verify_error::VerifyError;
use holdpoint_approvals::keyfile;
use holdpoint_governance::ids::Digest;
use holdpoint_text::file;

/// The name of the form in the first line.
const FORMAT: &str = "holdpoint-store-export";
const VERSION: u32 = 1;

/// The sound content of an exported file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ExportReport {
    pub store_id: String,
    pub records: u64,
    /// Hash of the last one.
    pub head: Digest,
    /// Root of the tree over all of them.
    pub root: Digest,
    /// Signed heads that are of this chain, the end included.
    pub heads: u64,
    /// Approvals with a valid signature, each by a person enrolled at that time.
    pub approvals: u64,
    /// Persons that the records enroll, revoked ones included.
    pub persons: u64,
    /// The verified persons among them.
    pub confirmed: u64,
    /// Whether a public key was given; otherwise signatures were checked with the key in the file.
    pub key_given: bool,
}

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
    put(&ExportLine::Export(ExportHeader {
        format: FORMAT.to_owned(),
        version: VERSION,
        store_id,
        records: head.seq,
        public_key: public_key.map(|key| keyfile::hex(key.as_bytes())),
    }))?;
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

/// Reads the lines of an exported file.
struct ExportLines {
    reader: BufReader<File>,
    number: u64,
}

impl ExportLines {
    /// The next line; `None` at the end.
    fn next(&mut self) -> Result<Option<ExportLine>, VerifyError> {
        self.number += 1;
        let number = self.number;
        let bad = |problem: String| VerifyError::Line { line: number, problem };
        let Some(line) = next_line(&mut self.reader).map_err(bad)? else { return Ok(None) };
        if number == 1 && !line.starts_with(START_OF_FILE) {
            return Err(bad("it is not the first of an exported store".to_owned()));
        }
        ExportLine::parse(&line).map(Some).map_err(bad)
    }
}

/// Whether a file begins as an exported one does.
#[must_use]
pub fn is_exported(path: &Path) -> bool {
    let mut start = [0; START_OF_FILE.len()];
    let read = file::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == *START_OF_FILE
}

/// Verifies an exported file.
///
/// # Errors
/// [`VerifyError`], the first thing found: records in their order with the acts about persons among them, heads, the end,
/// approvals.
pub fn verify_export(path: &Path, key: Option<&VerifyingKey>) -> Result<ExportReport, VerifyError> {
    let file = file::open(path).map_err(StoreError::io("read", path))?;
    let mut lines = ExportLines { reader: BufReader::new(file), number: 0 };
    let header = match lines.next()? {
        Some(ExportLine::Export(header)) if header.format == FORMAT && header.version == VERSION => header,
        _ => {
            let problem = format!("it has to say that the file is a {FORMAT} of version {VERSION}");
            return Err(VerifyError::Line { line: 1, problem });
        }
    };
    let named =
        match &header.public_key {
            None => None,
            Some(text) => Some(keyfile::parse_public(text).ok_or_else(|| VerifyError::Line {
                line: 1,
                problem: "its public key is invalid".to_owned(),
            })?),
        };
    if let (Some(key), Some(named)) = (key, &named)
        && key != named
    {
        let problem = "it names another public key than the one that was given".to_owned();
        return Err(VerifyError::Line { line: 1, problem });
    }
    let Some(checked_with) = key.or(named.as_ref()) else {
        let problem = "it names no public key, and none was given".to_owned();
        return Err(VerifyError::Line { line: 1, problem });
    };
    store_id::check_key(&header.store_id, checked_with)
        .map_err(|problem| VerifyError::Line { line: 1, problem })?;
    let mut exported = ExportedChain::of(&header.store_id);
    while let Some(line) = lines.next()? {
        exported.take(line, lines.number)?;
    }
    exported.check(&header, checked_with)?;
    Ok(ExportReport {
        store_id: header.store_id,
        records: exported.end.seq,
        head: exported.end.hash,
        root: exported.tree.root(),
        heads: exported.heads.len() as u64 + u64::from(exported.signed_end.is_some()),
        approvals: exported.approvals.len() as u64,
        persons: exported.persons.all().count() as u64,
        confirmed: exported.persons.confirmed().count() as u64,
        key_given: key.is_some(),
    })
}
