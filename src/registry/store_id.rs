//! The id of a store is derived from its signing key. Another key makes another store with another id, for which no
//! approvals and enrollments are signed and no witness has a folder.
//!
//! Stores of earlier versions have a random id, without relation to a key.

use std::path::Path;

use ed25519_dalek::VerifyingKey;
use rusqlite::Connection;

use super::error::StoreError;
use super::open::not_the_chain;
use super::row_limit;
use holdpoint_governance::ids::Digest;

/// Domain tag of the digest in an id.
const DOMAIN: &str = "holdpoint/store-id/v1";
/// The prefix of ids that are derived from a key.
const PREFIX: &str = "key-";
/// Digits of the digest in an id: 128 bits, too many to find a second key.
const DIGITS: usize = 32;

/// The id of a store that signs with this key.
pub(crate) fn of_key(key: &VerifyingKey) -> String {
    let digits: String =
        Digest::of_parts(DOMAIN, &[key.as_bytes()]).to_string().chars().take(DIGITS).collect();
    format!("{PREFIX}{digits}")
}

/// Whether a store with this id signs with this key, as far as the id shows.
///
/// # Errors
/// What is wrong, if it does not.
pub(crate) fn check_key(store_id: &str, key: &VerifyingKey) -> Result<(), String> {
    if !store_id.starts_with(PREFIX) || store_id == of_key(key) {
        return Ok(());
    }
    Err(format!("the store {store_id:?} does not sign with this key: it would be {:?}", of_key(key)))
}

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
        .map_err(StoreError::sql("name the store"))?;
    Ok(store_id)
}

#[cfg(test)]
mod tests {
    use ed25519_dalek::SigningKey;

    use super::*;

    #[test]
    fn store_id_identifies_one_key() {
        let key = |byte: u8| SigningKey::from_bytes(&[byte; 32]).verifying_key();
        let id = of_key(&key(1));
        assert_eq!(id.len(), PREFIX.len() + DIGITS);
        assert!(holdpoint_governance::ids::is_name(&id));
        check_key(&id, &key(1)).unwrap();
        assert!(check_key(&id, &key(2)).unwrap_err().contains(&id));
        // The ids of earlier versions.
        check_key("0123456789abcdef0123456789abcdef", &key(2)).unwrap();
    }
}
