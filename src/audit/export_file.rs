//! Verifies a store's history in one file of JSON lines.
//!
//! The first line names the form. The signed heads, the signed end, the records of the chain and the signed approvals
//! follow. The guide's page on records has the form in full, with every hash and signature.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use serde::Serialize;

use super::export_line::{ExportLine, FORMAT, START_OF_FILE, VERSION, next_line};
use super::export_verify::ExportedChain;
use super::files::FileError;
use super::history_error::HistoryError;
use super::store_id;
use holdpoint_approvals::keyfile;
use holdpoint_governance::ids::Digest;
use holdpoint_text::file;

/// The sound content of an exported file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ExportReport {
    pub store_id: String,
    /// Records in the file, from the first one on.
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

/// Reads the lines of an exported file.
struct ExportLines {
    reader: BufReader<File>,
    number: u64,
}

impl ExportLines {
    /// The next line; `None` at the end.
    fn next(&mut self) -> Result<Option<ExportLine>, HistoryError> {
        self.number += 1;
        let number = self.number;
        let bad = |problem: String| HistoryError::Line { line: number, problem };
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
/// [`HistoryError`], the first thing found: records in their order with the acts about persons among them, heads, the end,
/// approvals.
pub fn verify_export(path: &Path, key: Option<&VerifyingKey>) -> Result<ExportReport, HistoryError> {
    let file = file::open(path).map_err(FileError::io("read", path))?;
    let mut lines = ExportLines { reader: BufReader::new(file), number: 0 };
    let header = match lines.next()? {
        Some(ExportLine::Export(header)) if header.format == FORMAT && header.version == VERSION => header,
        _ => {
            let problem = format!("it has to say that the file is a {FORMAT} of version {VERSION}");
            return Err(HistoryError::Line { line: 1, problem });
        }
    };
    let named = match &header.public_key {
        None => None,
        Some(text) => Some(keyfile::parse_public(text).ok_or_else(|| HistoryError::Line {
            line: 1,
            problem: "its public key is invalid".to_owned(),
        })?),
    };
    if let (Some(key), Some(named)) = (key, &named)
        && key != named
    {
        let problem = "it names another public key than the one that was given".to_owned();
        return Err(HistoryError::Line { line: 1, problem });
    }
    let Some(checked_with) = key.or(named.as_ref()) else {
        let problem = "it names no public key, and none was given".to_owned();
        return Err(HistoryError::Line { line: 1, problem });
    };
    store_id::check_key(&header.store_id, checked_with)
        .map_err(|problem| HistoryError::Line { line: 1, problem })?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// A store of an earlier version, and its public key.
    fn fixture() -> (Vec<u8>, VerifyingKey) {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/store-d43131bc");
        let (key, _) = keyfile::read_public(&folder.join("store/keys/store.pub")).unwrap();
        (fs::read(folder.join("export.jsonl")).unwrap(), key)
    }

    #[test]
    fn exported_file_is_verified_without_a_store() {
        let (bytes, key) = fixture();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("export.jsonl");
        fs::write(&path, &bytes).unwrap();
        assert!(is_exported(&path));
        let report = verify_export(&path, Some(&key)).unwrap();
        let root = "aa6835338c70b05adedff35aedd30ac04e8470980a4fb0a8794db952b2f54a0c";
        assert_eq!((report.records, report.heads, report.root.to_string().as_str()), (44, 9, root));
        assert_eq!((report.approvals, report.persons, report.confirmed), (0, 2, 1));
        assert!(report.key_given && !verify_export(&path, None).unwrap().key_given);
    }

    #[test]
    fn removed_edited_and_unsigned_records_are_named() {
        let (bytes, key) = fixture();
        let text = String::from_utf8(bytes).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("export.jsonl");
        let verdict = |lines: &[&str]| {
            fs::write(&path, lines.join("\n") + "\n").unwrap();
            verify_export(&path, Some(&key)).unwrap_err()
        };
        // One header, eight checkpoints and the signed end come first.
        let at = |seq: usize| 9 + seq;
        let without = |index: usize| [&lines[..index], &lines[index + 1..]].concat();
        assert_eq!(verdict(&without(at(20))).record(), Some(20));
        assert_eq!(verdict(&without(at(44))).record(), Some(44));
        let mut edited = lines.clone();
        let other = lines[at(7)].replacen("\"at_ms\":", "\"at_ms\":1", 1);
        edited[at(7)] = &other;
        assert_eq!(verdict(&edited).record(), Some(7));
        assert!(matches!(verdict(&without(9)), HistoryError::Unsigned(_)));
        assert!(matches!(verdict(&without(4)), HistoryError::Checkpoint { .. }));
        assert!(matches!(verdict(&lines[1..]), HistoryError::Line { line: 1, .. }));
    }
}
