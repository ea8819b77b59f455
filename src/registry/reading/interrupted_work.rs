//! The leftovers of an interrupted engine. Listing only: the engine finishes or undoes each, and reports it.

use crate::database::columns::{parsed, parsed_option};
use rusqlite::Connection;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_store::InterruptedWork;

/// Every interrupted operation, in order of registration; a pending rollback comes before the rest of a version.
pub(crate) fn interrupted(connection: &Connection) -> rusqlite::Result<Vec<InterruptedWork>> {
    let mut select = connection.prepare(
        "SELECT name, running, provisional, rollback_pending FROM version
         WHERE running IS NOT NULL OR provisional = 1 OR rollback_pending = 1 ORDER BY id",
    )?;
    let mut rows = select.query([])?;
    let mut found = Vec::new();
    while let Some(row) = rows.next()? {
        let version: CapabilityId = parsed(row, 0)?;
        if row.get(3)? {
            found.push(InterruptedWork::RollbackPending { version: version.clone() });
        }
        if let Some(stage) = parsed_option(row, 1)? {
            found.push(InterruptedWork::Stage { version: version.clone(), stage });
        }
        if row.get(2)? {
            found.push(InterruptedWork::Provisional { version });
        }
    }
    Ok(found)
}
