//! What the record says of scene recordings: which are closed, and with which digest.
//!
//! A recording is for people. Nothing here is read by anything that decides.

use std::collections::BTreeSet;

use super::manager::{Fault, UpgradeManager};
use crate::engine::event::EventKind;
use crate::governance::ids::{CapabilityId, Digest};
use crate::registry::{AuditBody, AuditFilter, PAGE_ROWS_MAX, StoreError};

/// The kind of an audit record that closes a recording.
pub const KEPT: &str = "recording";

/// A closed recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Whose it is.
    pub version: CapabilityId,
    /// How the upgrade ended.
    pub outcome: String,
    /// The file's name.
    pub file: String,
    /// SHA-256 of the file.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
    /// Moments of the live cell in it.
    pub pictures: u64,
    /// Pictures and events that are not in it because the queue was full.
    pub dropped: [u64; 2],
}

impl UpgradeManager {
    /// Names of the files that are closed.
    ///
    /// # Errors
    /// Where the store cannot be read.
    pub fn recordings_on_record(&self) -> Result<BTreeSet<String>, StoreError> {
        let views = self.ledger.store().views()?;
        let mut names = BTreeSet::new();
        let mut filter = AuditFilter { kind: Some(KEPT.to_owned()), ..AuditFilter::default() };
        loop {
            let page = views.audit(&filter)?;
            let Some(last) = page.last() else { return Ok(names) };
            filter.from_seq = last.seq + 1;
            let full = page.len() >= PAGE_ROWS_MAX;
            names.extend(page.iter().filter_map(|record| {
                let body: serde_json::Value = serde_json::from_str(&record.body).ok()?;
                body.get("file")?.as_str().map(ToOwned::to_owned)
            }));
            if !full {
                return Ok(names);
            }
        }
    }

    /// Puts the digest of a closed recording on record.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep_recording(&mut self, kept: Kept) -> Result<(), Fault> {
        let Kept { version, outcome, file, digest, bytes, pictures, dropped } = kept;
        let body = serde_json::json!({
            "file": file,
            "sha256": digest,
            "bytes": bytes,
            "pictures": pictures,
            "dropped_pictures": dropped[0],
            "dropped_events": dropped[1],
            "outcome": outcome,
        });
        let record =
            AuditBody { kind: KEPT.to_owned(), subject: version.to_string(), body: body.to_string() };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(EventKind::RecordingKept { version, file, digest, bytes, pictures, dropped });
        Ok(())
    }

    /// Tells something about scenes.
    pub fn tell_scene(&mut self, text: String, failed: bool) {
        self.emit(EventKind::Scene { text, failed });
    }
}
