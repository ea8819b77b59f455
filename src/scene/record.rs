//! What the audit chain says of recordings: which were closed with which digest, and which were removed and why.
//!
//! Owns the form of these records and reads them. Must not write them: the engine does at closure, in this form, and
//! who removes a recording before it is gone.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::shelf::{self, Filed};
use crate::governance::ids::Digest;
use crate::registry::{AuditFilter, AuditRecord, PAGE_ROWS_MAX, StoreError, Views};

/// The kind of record that a closed recording leaves; its subject is the version.
pub const KIND: &str = "recording";

/// The kind of record that a removed recording leaves; its subject is the version.
pub const REMOVED_KIND: &str = "recording-removed";

/// A recording as it was when its upgrade was closed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recorded {
    /// The file's name.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: Digest,
    /// Its size.
    pub bytes: u64,
    /// Moments of the live cell in it.
    pub pictures: u64,
    /// Moments that were dropped because the queue was full.
    pub dropped_pictures: u64,
    /// Events that were dropped.
    pub dropped_events: u64,
    /// How the upgrade ended.
    pub outcome: String,
}

/// A recording that was removed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Removed {
    /// The file's name.
    pub file: String,
    /// SHA-256 of the file as it was then.
    pub sha256: Digest,
    /// Its size then.
    pub bytes: u64,
    /// Why.
    pub reason: String,
}

/// What is on record of one file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// As it was closed.
    pub recorded: Option<Recorded>,
    /// That it was removed afterwards.
    pub removed: Option<Removed>,
}

/// What is on record, by file name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OnRecord(pub BTreeMap<String, Standing>);

/// How a file stands to what is on record of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Check {
    /// It is what was closed.
    Matches,
    /// It is not: this is its digest, the other the one on record.
    Differs {
        /// The file's digest now.
        found: Digest,
        /// The one on record.
        recorded: Digest,
    },
    /// Its upgrade was not closed, or closed without it.
    NotOnRecord,
}

/// Why the records cannot be told.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A record has another form.
    #[error("audit record {seq} of kind {kind:?} cannot be read: {source}")]
    Form {
        /// The record.
        seq: u64,
        /// Its kind.
        kind: String,
        /// Why.
        source: serde_json::Error,
    },
}

impl OnRecord {
    /// Reads the chain.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn read(views: &Views) -> Result<Self, RecordError> {
        let mut records = of_kind(views, KIND)?;
        records.extend(of_kind(views, REMOVED_KIND)?);
        records.sort_by_key(|record| record.seq);
        let mut files: BTreeMap<String, Standing> = BTreeMap::new();
        for record in records {
            let form = |source| RecordError::Form { seq: record.seq, kind: record.kind.clone(), source };
            if record.kind == KIND {
                let recorded: Recorded = serde_json::from_str(&record.body).map_err(form)?;
                let standing = Standing { recorded: Some(recorded.clone()), removed: None };
                files.insert(recorded.file, standing);
            } else {
                let removed: Removed = serde_json::from_str(&record.body).map_err(form)?;
                let file = removed.file.clone();
                files.entry(file).or_default().removed = Some(removed);
            }
        }
        Ok(Self(files))
    }

    /// A file as it was closed.
    #[must_use]
    pub fn recorded(&self, file: &str) -> Option<&Recorded> {
        self.0.get(file)?.recorded.as_ref()
    }

    /// Files that were closed and not removed since.
    pub fn kept(&self) -> impl Iterator<Item = &Recorded> {
        self.0.values().filter(|standing| standing.removed.is_none()).filter_map(|one| one.recorded.as_ref())
    }

    /// Compares a file with what is on record of it.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn check(&self, filed: &Filed) -> std::io::Result<Check> {
        let Some(recorded) = self.recorded(&filed.file) else { return Ok(Check::NotOnRecord) };
        let found = shelf::digest(&filed.path)?;
        let same = found == recorded.sha256;
        Ok(if same { Check::Matches } else { Check::Differs { found, recorded: recorded.sha256 } })
    }
}

/// Every record of a kind, oldest first.
fn of_kind(views: &Views, kind: &str) -> Result<Vec<AuditRecord>, StoreError> {
    let mut all = Vec::new();
    let mut from_seq = 0;
    loop {
        let page = views.audit(&AuditFilter {
            from_seq,
            before_seq: None,
            kind: Some(kind.to_owned()),
            subject: None,
            limit: PAGE_ROWS_MAX,
            newest_first: false,
        })?;
        let full = page.len() >= PAGE_ROWS_MAX;
        from_seq = page.last().map_or(from_seq, |record| record.seq + 1);
        all.extend(page);
        if !full {
            return Ok(all);
        }
    }
}
