//! Brings a database to the newest schema: a list of SQL texts, each applied once, in its own transaction.

use rusqlite::{Connection, TransactionBehavior};

use crate::terms::sqlite_error::sqlite_error;
use holdpoint_store::StoreError;

/// The identity of our databases: application id and schemas, oldest first.
pub(crate) struct Schema {
    /// The value of `PRAGMA application_id`.
    pub(crate) application_id: i32,
    /// One SQL text per schema version.
    pub(crate) steps: &'static [&'static str],
}

/// The store, `holdpoint.db`: "HPT1".
pub(crate) const STORE: Schema = Schema {
    application_id: 0x4850_5431,
    steps: &[
        include_str!("../schema/store-1.sql"),
        include_str!("../schema/store-2.sql"),
        include_str!("../schema/store-3.sql"),
        include_str!("../schema/store-4.sql"),
    ],
};

/// The telemetry, `telemetry.db`: "HPT2".
pub(crate) const TELEMETRY: Schema = Schema {
    application_id: 0x4850_5432,
    steps: &[
        include_str!("../schema/telemetry-1.sql"),
        include_str!("../schema/telemetry-2.sql"),
        include_str!("../schema/telemetry-3.sql"),
    ],
};

impl Schema {
    /// The newest version this program knows.
    pub(crate) const fn newest(&self) -> usize {
        self.steps.len()
    }
}

pub(crate) fn version(connection: &Connection) -> rusqlite::Result<usize> {
    connection.query_row("PRAGMA user_version", [], |row| row.get(0))
}

/// Applies the steps that are missing.
///
/// # Errors
/// If a step fails; that step is undone.
pub(crate) fn migrate(connection: &mut Connection, schema: &Schema) -> Result<(), StoreError> {
    migrate_to(connection, schema, schema.newest()).map_err(sqlite_error("bring its schema up to date"))
}

/// Applies the steps that are missing up to a version.
///
/// # Errors
/// If a step fails; that step is undone.
pub(crate) fn migrate_to(
    connection: &mut Connection,
    schema: &Schema,
    newest: usize,
) -> rusqlite::Result<()> {
    let found = version(connection)?;
    for (index, step) in schema.steps.iter().enumerate().take(newest).skip(found) {
        let step_tx = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        step_tx.execute_batch(step)?;
        step_tx.pragma_update(None, "application_id", schema.application_id)?;
        step_tx.pragma_update(None, "user_version", index + 1)?;
        step_tx.commit()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::ApprovalDecision;
    use holdpoint_governance::lifecycle::{Stage, State};
    use holdpoint_store::{EvidenceKind, RequestState};

    #[test]
    fn stored_names_are_those_of_lifecycle_and_schema() {
        let schema = STORE.steps[0];
        let all = (State::ALL.map(State::name).into_iter())
            .chain(Stage::ALL.map(Stage::name))
            .chain(EvidenceKind::ALL.map(EvidenceKind::name))
            .chain(ApprovalDecision::ALL.map(ApprovalDecision::name))
            .chain(RequestState::ALL.map(RequestState::name));
        for name in all {
            assert!(schema.contains(&format!("'{name}'")), "{name}");
        }
        assert!("Active".parse::<State>().is_err());
    }
}
