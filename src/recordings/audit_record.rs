//! Audit records about recordings: which were closed with which digest, and which were removed and why.
//!
//! Owns the form of these records and reads them. Must not write them: the engine does at closure, and the remover does
//! before it removes a file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;

use serde::{Deserialize, Serialize};

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::{AuditRecord, RecordKind, UpgradeEnd};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

use super::recording_folder::{self, RecordingFile};

/// The kind of record that a closed recording leaves; its subject is the version.
pub const KIND: RecordKind = RecordKind::Recording;

/// The kind of record that a removed recording leaves; its subject is the version.
pub const REMOVED_KIND: RecordKind = RecordKind::RecordingRemoved;

/// A recording as it was when its upgrade was closed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingClosure {
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: Digest,
    pub bytes: u64,
    /// Moments of the live cell in it.
    pub pictures: u64,
    /// Moments that were dropped because the queue was full.
    pub dropped_pictures: u64,
    /// Events that were dropped.
    pub dropped_events: u64,
    /// How the upgrade ended.
    pub outcome: Lenient<UpgradeEnd>,
}

/// A recording that was removed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingRemoval {
    pub file: String,
    /// SHA-256 of the file as it was then.
    pub sha256: Digest,
    pub bytes: u64,
    pub reason: String,
}

/// The records about one file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FileRecord {
    /// The closed file, if a record names it.
    pub recorded: Option<RecordingClosure>,
    /// Its later removal, if a record names it.
    pub removed: Option<RecordingRemoval>,
}

/// The records about recordings, by file name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordedFiles(pub BTreeMap<String, FileRecord>);

/// The state of a file compared with its record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileCheck {
    /// The file is the one that was closed.
    Matches,
    /// The content differs from the record.
    Differs {
        /// The file's digest now.
        found: Digest,
        /// The digest on record.
        recorded: Digest,
    },
    /// The size differs from the record; the content was not read.
    OtherSize {
        /// Bytes of the file now.
        found: u64,
        /// Bytes on record.
        recorded: u64,
    },
    /// The upgrade was not closed, or closed without this file.
    NotOnRecord,
}

/// A record of one of the two kinds with an unknown form.
#[derive(Debug, thiserror::Error)]
#[error("audit record {seq} of kind {kind:?} cannot be read: {source}")]
pub struct RecordError {
    pub seq: u64,
    pub kind: String,
    pub source: serde_json::Error,
}

impl Hint for RecordError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorReason::StoreRefused.into())
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        None
    }
}

impl RecordedFiles {
    /// Reads the next audit record of kind [`KIND`] or [`REMOVED_KIND`]; skips others.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn take(&mut self, record: &AuditRecord) -> Result<(), RecordError> {
        let AuditRecord { seq, kind, body, .. } = record;
        let form = |source| RecordError { seq: *seq, kind: kind.to_string(), source };
        if *kind == KIND {
            let recorded: RecordingClosure = serde_json::from_str(body).map_err(form)?;
            let entry = FileRecord { recorded: Some(recorded.clone()), removed: None };
            self.0.insert(recorded.file, entry);
        } else if *kind == REMOVED_KIND {
            let removed: RecordingRemoval = serde_json::from_str(body).map_err(form)?;
            let file = removed.file.clone();
            self.0.entry(file).or_default().removed = Some(removed);
        }
        Ok(())
    }

    /// A file as it was closed.
    #[must_use]
    pub fn recorded(&self, file: &str) -> Option<&RecordingClosure> {
        self.0.get(file)?.recorded.as_ref()
    }

    /// Files that were closed and not removed since.
    pub fn present(&self) -> impl Iterator<Item = &RecordingClosure> {
        self.0.values().filter(|entry| entry.removed.is_none()).filter_map(|one| one.recorded.as_ref())
    }

    /// Compares a file with its record. A file of another size is not read, because it may be endless.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn check(&self, filed: &RecordingFile) -> io::Result<FileCheck> {
        Ok(match self.recorded(&filed.file) {
            None => FileCheck::NotOnRecord,
            Some(recorded) if recorded.bytes != filed.bytes => {
                FileCheck::OtherSize { found: filed.bytes, recorded: recorded.bytes }
            }
            Some(recorded) => match recording_folder::digest(&filed.path)? {
                found if found == recorded.sha256 => FileCheck::Matches,
                found => FileCheck::Differs { found, recorded: recorded.sha256 },
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::recording_folder::list;

    #[test]
    fn a_file_of_another_size_is_not_read() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a-1.0.0-00000000.rrd");
        fs::write(&path, "abc").unwrap();
        let recorded = RecordingClosure {
            file: "a-1.0.0-00000000.rrd".to_owned(),
            sha256: recording_folder::digest(&path).unwrap(),
            bytes: 3,
            pictures: 0,
            dropped_pictures: 0,
            dropped_events: 0,
            outcome: UpgradeEnd::Confirmed.into(),
        };
        let entry = FileRecord { recorded: Some(recorded.clone()), removed: None };
        let record = RecordedFiles([(recorded.file, entry)].into());
        let check = || record.check(&list(root.path()).unwrap()[0]).unwrap();
        assert_eq!(check(), FileCheck::Matches);
        fs::write(&path, "abd").unwrap();
        assert!(matches!(check(), FileCheck::Differs { .. }));
        // Hashing this much takes minutes.
        fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(check(), FileCheck::OtherSize { found: 1 << 40, recorded: 3 });
    }
}
