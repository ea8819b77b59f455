//! The id of a store in its database; [`of_key`] derives it from the key.

use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;

use crate::database::open::not_the_chain;
use crate::terms::row_limit;
use crate::terms::sqlite_error::sqlite_error;
use holdpoint_audit::store_id::of_key;
use holdpoint_store::StoreError;

/// The store's id, made with the store.
pub(crate) fn read(connection: &Connection, database: &Path) -> Result<String, StoreError> {
    connection.query_row("SELECT value FROM meta WHERE +key = 'store_id'", [], |row| row.get(0)).map_err(
        |error| {
            not_the_chain(
                database,
                &format!("its id cannot be read: {}", row_limit::error_message_for("meta", &error)),
            )
        },
    )
}

/// Names a store without records after its key, and tells the id.
pub(crate) fn name_after(connection: &Connection, key: &VerifyingKey) -> Result<String, StoreError> {
    let store_id = of_key(key);
    connection
        .execute("UPDATE meta SET value = ?1 WHERE key = 'store_id' AND value != ?1", [&store_id])
        .map_err(sqlite_error("name the store"))?;
    Ok(store_id)
}
