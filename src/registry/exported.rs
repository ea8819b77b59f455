//! A store's history in one file of JSON lines, for whoever verifies it without this program.
//!
//! The first line says what the file is, then come the signed heads, the signed end, the records of the chain, and the
//! signed approvals. The guide's page on records has the form in full, with how every hash and signature is made. What is judged here is what another verifier can judge by the file alone.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;
use serde::{Deserialize, Serialize};

use super::audit::{self, ExportError, Head, ascii_json};
use super::change::Change;
use super::check::{Reading, open_checked};
use super::checkpoint::{Checkpoint, Kept, check_links, check_newest, read_all};
use super::compare::is_lost;
use super::error::StoreError;
use super::fold::START;
use super::merkle::Frontier;
use super::migrate::STORE;
use super::open::open_reader;
use super::signed;
use super::store_id;
use super::unsound::VerifyError;
use holdpoint_approvals::keyfile::hex;
use holdpoint_approvals::{PersonActKind, PersonState, Persons, SignedApproval, SignedPersonAct, keyfile};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::words::Word;

/// What the first line calls the form.
const FORMAT: &str = "holdpoint-store-export";
const VERSION: u32 = 1;
/// The longest line, bytes: a record's body has at most 4 MiB, and each of its bytes six as an escape.
pub(crate) const LINE_BYTES_MAX: u64 = 32 << 20;

/// One line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum ExportLine {
    Export(ExportHeader),
    Head(Checkpoint),
    End(Checkpoint),
    Record(Box<ExportedRecord>),
    Approval(Box<SignedApproval>),
}

/// A record as a line has it, and nothing else.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportedRecord {
    seq: u64,
    prev: Digest,
    hash: Digest,
    at_ms: u64,
    kind: Word<RecordKind>,
    subject: String,
    body: String,
    wall_ms: i64,
}

impl From<AuditRecord> for ExportedRecord {
    fn from(record: AuditRecord) -> Self {
        let AuditRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms } = record;
        Self { seq, prev, hash, at_ms, kind, subject, body, wall_ms }
    }
}

impl From<ExportedRecord> for AuditRecord {
    fn from(record: ExportedRecord) -> Self {
        let ExportedRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms } = record;
        Self { seq, prev, hash, at_ms, kind, subject, body, wall_ms }
    }
}

/// The first line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportHeader {
    format: String,
    version: u32,
    store_id: String,
    /// Records in the file.
    records: u64,
    /// 64 hexadecimal digits.
    public_key: Option<String>,
}

/// What was found sound in an exported file.
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
    /// Approvals whose signature matches, each by somebody who was enrolled when it was given.
    pub approvals: u64,
    /// Persons that the records enrol, revoked ones included.
    pub persons: u64,
    /// Those of them who are confirmed.
    pub confirmed: u64,
    /// Whether a public key was given; without one, signatures were checked with the key that the file itself names.
    pub key_given: bool,
}

/// The checkpoints that belong to a moment of the database, whose end this is: an engine may have written more since.
pub(crate) fn until(mut kept: Vec<Kept>, end: Option<&Checkpoint>, last: u64) -> Vec<Kept> {
    kept.retain(|Kept { checkpoint, .. }| {
        checkpoint.seq <= last && end.is_none_or(|end| checkpoint.number() <= end.number())
    });
    kept
}

/// Which history is written out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exporting {
    /// One whose records are what was signed; another is refused.
    Signed,
    /// Whatever lies there.
    Unchecked,
}

/// Writes a store's whole history and returns how many records it has.
///
/// # Errors
/// If the store cannot be read, is not what was signed, or the file cannot be written.
pub fn export_store(
    database: &Path,
    exporting: Exporting,
    public_key: Option<&VerifyingKey>,
    out: &mut dyn Write,
) -> Result<u64, ExportError> {
    let other = |error: StoreError| ExportError::Store(Box::new(error));
    let connection = match exporting {
        Exporting::Signed => open_checked(database, Reading::Records),
        Exporting::Unchecked => open_reader(database, &STORE),
    };
    let connection = connection.map_err(other)?;
    connection.execute_batch("BEGIN")?;
    let head = audit::head(&connection)?;
    let store_id: String =
        connection.query_row("SELECT value FROM meta WHERE key = 'store_id'", [], |row| row.get(0))?;
    let bad = |problem: String| other(StoreError::invalid("signed end", "", problem));
    let end = signed::read(&connection).map_err(bad)?;
    let folder = database.parent().unwrap_or(Path::new(".")).join("checkpoints");
    let kept =
        read_all(&folder).map_err(|bad| other(StoreError::invalid("checkpoint", bad.file, bad.problem)))?;
    let mut put = |line: &ExportLine| -> Result<(), ExportError> {
        out.write_all(ascii_json(&serde_json::to_string(line)?).as_bytes())?;
        Ok(out.write_all(b"\n")?)
    };
    put(&ExportLine::Export(ExportHeader {
        format: FORMAT.to_owned(),
        version: VERSION,
        store_id,
        records: head.seq,
        public_key: public_key.map(|key| keyfile::hex(key.as_bytes())),
    }))?;
    for kept in until(kept, end.as_ref(), head.seq) {
        put(&ExportLine::Head(kept.checkpoint))?;
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

/// How an exported file begins.
const START_OF_FILE: &[u8; 10] = b"{\"export\":";

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
        let mut line = Vec::new();
        let read = (&mut self.reader).take(LINE_BYTES_MAX + 1).read_until(b'\n', &mut line);
        if read.map_err(|error| bad(error.to_string()))? == 0 {
            return Ok(None);
        }
        if line.len() as u64 > LINE_BYTES_MAX {
            return Err(bad(format!("it has more than {LINE_BYTES_MAX} bytes")));
        }
        if number == 1 && !line.starts_with(START_OF_FILE) {
            return Err(bad("it is not the first of an exported store".to_owned()));
        }
        if line.last() != Some(&b'\n') {
            return Err(bad("the file is cut short in it".to_owned()));
        }
        serde_json::from_slice(&line).map(Some).map_err(|error| bad(error.to_string()))
    }
}

/// Whether a file begins as an exported one does.
#[must_use]
pub fn is_exported(path: &Path) -> bool {
    let mut start = [0; START_OF_FILE.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == *START_OF_FILE
}

/// Verifies an exported file.
///
/// # Errors
/// [`VerifyError`], the first thing found: records in their order with the acts about persons among them, heads, the end,
/// approvals.
pub fn verify_export(path: &Path, key: Option<&VerifyingKey>) -> Result<ExportReport, VerifyError> {
    let file = File::open(path).map_err(StoreError::io("read", path))?;
    let mut lines = ExportLines { reader: BufReader::new(file), number: 0 };
    let header = match lines.next()? {
        Some(ExportLine::Export(header)) if header.format == FORMAT && header.version == VERSION => header,
        _ => {
            let problem = format!("it has to say that the file is a {FORMAT} of version {VERSION}");
            return Err(VerifyError::Line { line: 1, problem });
        }
    };
    let named = match &header.public_key {
        None => None,
        Some(text) => Some(
            keyfile::parse_public(text)
                .ok_or_else(|| VerifyError::Line { line: 1, problem: "its public key is none".to_owned() })?,
        ),
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
    let mut exported = Exported::of(&header.store_id);
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

/// What was read of a file. Its records are let go once they were looked at.
struct Exported {
    heads: Vec<Kept>,
    signed_end: Option<Checkpoint>,
    end: Head,
    tree: Frontier,
    /// Records that a head speaks of: their hash and the tree's root.
    seen: Vec<(u64, Digest, Digest)>,
    /// Nonces of the approvals on record, each with the key of who gave it; before anybody was enrolled, with none.
    put: BTreeMap<String, Option<String>>,
    /// Nonces of those that a rebuild gave up.
    lost: BTreeSet<String>,
    approvals: Vec<SignedApproval>,
    persons: Persons,
}

impl Exported {
    fn of(store_id: &str) -> Self {
        Self {
            persons: Persons::none(store_id),
            heads: Vec::new(),
            signed_end: None,
            end: START,
            tree: Frontier::empty(),
            seen: Vec::new(),
            put: BTreeMap::new(),
            lost: BTreeSet::new(),
            approvals: Vec::new(),
        }
    }

    fn take(&mut self, line: ExportLine, number: u64) -> Result<(), VerifyError> {
        let misplaced = || VerifyError::Line { line: number, problem: "it does not belong here".to_owned() };
        match line {
            ExportLine::Export(_) => Err(misplaced()),
            ExportLine::Head(_) | ExportLine::End(_) if self.end.seq > 0 || self.signed_end.is_some() => {
                Err(misplaced())
            }
            ExportLine::Head(checkpoint) => {
                self.heads.push(Kept { file: format!("line {number}"), checkpoint });
                Ok(())
            }
            ExportLine::End(end) => {
                self.signed_end = Some(end);
                Ok(())
            }
            ExportLine::Record(_) if !self.approvals.is_empty() => Err(misplaced()),
            ExportLine::Record(record) => self.take_record(&(*record).into()),
            ExportLine::Approval(signed) => {
                self.approvals.push(*signed);
                Ok(())
            }
        }
    }

    fn take_record(&mut self, record: &AuditRecord) -> Result<(), VerifyError> {
        let seq = self.end.seq + 1;
        let bad = |problem: &str| VerifyError::Record { seq, problem: problem.to_owned() };
        if record.seq != seq {
            return Err(bad(&format!("it is missing; the next one is {}", record.seq)));
        }
        if record.prev != self.end.hash {
            return Err(bad("it does not follow from the record before"));
        }
        if record.hash != record.expected_hash() {
            return Err(bad("its content does not match its hash"));
        }
        if record.at_ms < self.end.at_ms {
            return Err(bad("it is older than the record before"));
        }
        if record.kind == RecordKind::ApprovalPut {
            let body: PutBody =
                serde_json::from_str(&record.body).map_err(|error| bad(&error.to_string()))?;
            let PutChange { nonce, who } = body.change;
            let key = self.key_of(&who).map_err(|problem| VerifyError::Approval {
                nonce: nonce.clone(),
                problem: problem.to_owned(),
            })?;
            self.put.insert(nonce, key);
        }
        let about_a_person =
            [RecordKind::PersonEnrolled, RecordKind::PersonConfirmed, RecordKind::PersonRevoked];
        if about_a_person.iter().any(|kind| record.kind == *kind) {
            let body: PersonBody =
                serde_json::from_str(&record.body).map_err(|error| bad(&error.to_string()))?;
            let (Change::EnrolPerson(signed) | Change::ConfirmPerson(signed) | Change::RevokePerson(signed)) =
                &body.change
            else {
                return Err(bad("it is no act about a person"));
            };
            self.take_act(record, signed)?;
        }
        if record.kind == RecordKind::WitnessSet {
            let body: PersonBody =
                serde_json::from_str(&record.body).map_err(|error| bad(&error.to_string()))?;
            if let Change::SetWitness { folder, present, act: Some(act), .. } = &body.change {
                act.check(&self.persons, (folder, *present), record.prev).map_err(|error| {
                    VerifyError::Person { name: act.act().by.clone(), problem: error.to_string() }
                })?;
            }
        }
        if record.kind == RecordKind::StoreRebuilt {
            let body: RowsOnRecord =
                serde_json::from_str(&record.body).map_err(|error| bad(&error.to_string()))?;
            let approvals = body.rows.into_iter().filter(|(table, ..)| table == "approval");
            self.lost.extend(approvals.map(|(_, nonce, _)| nonce));
        }
        self.end = Head { seq, hash: record.hash, at_ms: record.at_ms };
        self.tree.push(&record.hash);
        let spoken_of = |checkpoint: &Checkpoint| checkpoint.seq == seq;
        if self.heads.iter().any(|kept| spoken_of(&kept.checkpoint))
            || self.signed_end.as_ref().is_some_and(spoken_of)
        {
            self.seen.push((seq, record.hash, self.tree.root()));
        }
        Ok(())
    }

    /// The key of somebody who is enrolled as the records stand so far; none before anybody was enrolled.
    fn key_of(&self, who: &str) -> Result<Option<String>, &'static str> {
        if self.persons.is_empty() {
            return Ok(None);
        }
        let person = self.persons.named(who).filter(|person| person.state == PersonState::Enrolled);
        let person = person.ok_or("whoever gave it was not enrolled then")?;
        Ok(Some(hex(person.public_key.as_bytes())))
    }

    /// The act is allowed as the records stand so far, and is what the record is said to be.
    fn take_act(&mut self, record: &AuditRecord, signed: &SignedPersonAct) -> Result<(), VerifyError> {
        let act = signed.act();
        let kind = match act.act {
            PersonActKind::Enrol => RecordKind::PersonEnrolled,
            PersonActKind::Confirm => RecordKind::PersonConfirmed,
            PersonActKind::Revoke => RecordKind::PersonRevoked,
        };
        let bad = |problem: String| VerifyError::Person { name: act.name.clone(), problem };
        if record.kind != kind || record.subject != act.name {
            return Err(bad("the act is not what was recorded".to_owned()));
        }
        self.persons.push(signed).map_err(|error| bad(error.to_string()))
    }

    fn check(&self, header: &ExportHeader, key: &VerifyingKey) -> Result<(), VerifyError> {
        if self.end.seq != header.records {
            let problem = format!("it is missing; the file is said to have {}", header.records);
            return Err(VerifyError::Record { seq: self.end.seq + 1, problem });
        }
        for Kept { file, checkpoint } in &self.heads {
            self.check_head(checkpoint, &header.store_id, key)
                .map_err(|problem| VerifyError::Checkpoint { file: file.clone(), problem })?;
        }
        let unsigned = VerifyError::Unsigned;
        match &self.signed_end {
            Some(end) => {
                self.check_head(end, &header.store_id, key).map_err(unsigned)?;
                if end.seq != self.end.seq {
                    return Err(unsigned(format!("nobody signed the records after {}", end.seq)));
                }
            }
            None if self.end.seq == 0 => {}
            None => {
                return Err(unsigned(format!(
                    "nobody signed where the audit chain ends, at record {}",
                    self.end.seq
                )));
            }
        }
        let gap = self.signed_end.as_ref().and_then(|end| end.link.as_ref()).is_some_and(|link| link.gap);
        if !gap {
            check_links(&self.heads)
                .map_err(|bad| VerifyError::Checkpoint { file: bad.file, problem: bad.problem })?;
            if let Some(end) = &self.signed_end {
                check_newest(end, &self.heads).map_err(unsigned)?;
            }
        }
        self.check_approvals(&header.store_id)
    }

    fn check_head(&self, checkpoint: &Checkpoint, store_id: &str, key: &VerifyingKey) -> Result<(), String> {
        if checkpoint.store_id != store_id {
            return Err(format!("it belongs to the store {:?}", checkpoint.store_id));
        }
        if !checkpoint.is_signed_by(key) {
            return Err("its signature does not match the public key".to_owned());
        }
        let seen = self.seen.iter().find(|(seq, ..)| *seq == checkpoint.seq);
        match seen {
            Some((_, hash, _)) if *hash != checkpoint.head => {
                Err("its record is another one: history was rewritten".to_owned())
            }
            Some((.., root)) if checkpoint.root.is_some_and(|signed| signed != *root) => {
                Err("its tree head is not the one of these records".to_owned())
            }
            Some(_) => Ok(()),
            None if checkpoint.seq == 0 => Ok(()),
            None => Err(format!("its record {} is missing", checkpoint.seq)),
        }
    }

    fn check_approvals(&self, store_id: &str) -> Result<(), VerifyError> {
        let mut found = BTreeSet::new();
        for signed in &self.approvals {
            let nonce = signed.approval().nonce.as_str();
            let bad = |problem: &str| VerifyError::Approval {
                nonce: nonce.to_owned(),
                problem: problem.to_owned(),
            };
            if signed.verify_signature().is_err() {
                return Err(bad("its signature does not match the decision"));
            }
            if signed.approval().store_id != store_id {
                return Err(bad("it was made for another store"));
            }
            let Some(key) = self.put.get(nonce) else { return Err(bad("no record speaks of it")) };
            if key.as_deref().is_some_and(|key| key != signed.public_key()) {
                return Err(bad("it was signed with another key than that of who gave it"));
            }
            if !found.insert(nonce) {
                return Err(bad("it is there twice"));
            }
        }
        match self.put.keys().find(|put| !found.contains(put.as_str()) && !self.lost.contains(*put)) {
            None => Ok(()),
            Some(nonce) => {
                Err(VerifyError::Approval { nonce: nonce.clone(), problem: "it is missing".to_owned() })
            }
        }
    }
}

/// The part of an approval's record that is read.
#[derive(Deserialize)]
struct PutBody {
    change: PutChange,
}

#[derive(Deserialize)]
struct PutChange {
    nonce: String,
    who: String,
}

/// The part of a person's record that is read.
#[derive(Deserialize)]
struct PersonBody {
    change: Change,
}

/// The part of a rebuild's record that is read.
#[derive(Deserialize)]
struct RowsOnRecord {
    rows: Vec<(String, String, Digest)>,
}
