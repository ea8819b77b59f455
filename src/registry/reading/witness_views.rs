//! The witnesses on record.

use std::collections::BTreeSet;
use std::path::Path;

use serde::Deserialize;

use crate::database::migrate::STORE;
use crate::database::open::open_reader;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{Change, StoreError};

/// The witness folders of a store, from its records.
///
/// # Errors
/// If the store cannot be read.
pub fn witnesses(database: &Path) -> Result<BTreeSet<String>, StoreError> {
    #[derive(Deserialize)]
    struct RecordedWitness {
        change: Change,
    }
    let error = sqlite_error("read the audit chain");
    let connection = open_reader(database, &STORE)?;
    let mut select =
        connection.prepare("SELECT seq, body FROM audit WHERE kind = ?1 ORDER BY seq").map_err(&error)?;
    let mut rows = select.query([RecordKind::WitnessSet.name()]).map_err(&error)?;
    let mut found = BTreeSet::new();
    while let Some(row) = rows.next().map_err(&error)? {
        let (seq, body): (u64, String) = (row.get(0).map_err(&error)?, row.get(1).map_err(&error)?);
        let read: RecordedWitness =
            serde_json::from_str(&body).map_err(|it| StoreError::invalid("audit record", seq, it))?;
        if let Change::SetWitness { folder, present, .. } = read.change {
            if present {
                found.insert(folder);
            } else {
                found.remove(&folder);
            }
        }
    }
    Ok(found)
}
