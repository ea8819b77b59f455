//! Read access to the history of a store's profiles.

use rusqlite::Connection;

use crate::reading::views::Views;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::profile_history::{ProfileChangeBody, ProfileHistory};
use holdpoint_governance::record::RecordKind;
use holdpoint_store::StoreError;

/// The history of a store's profiles, from its records.
fn profile_history(connection: &Connection) -> rusqlite::Result<ProfileHistory> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        connection.prepare("SELECT seq, kind, body FROM audit WHERE kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut history = ProfileHistory::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Ok(found) = serde_json::from_str::<ProfileChangeBody>(&body) else { continue };
        if kind == RecordKind::ContextSet.name() {
            drop(history.take(seq, found.change));
        } else {
            history.allow_on_record(seq, found.change);
        }
    }
    Ok(history)
}

impl Views {
    /// The history of the profiles from the records, unchecked, for messages before a start. The starting engine
    /// compares it with the chain.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn profiles(&self) -> Result<ProfileHistory, StoreError> {
        profile_history(&self.connection).map_err(sqlite_error("read the profiles on record"))
    }
}
