//! The id of a store is derived from its signing key. Another key makes another store with another id, for which no
//! approvals and enrollments are signed and no witness has a folder.
//!
//! Stores of earlier versions have a random id, without relation to a key.

use ed25519_dalek::VerifyingKey;

use holdpoint_governance::ids::Digest;

/// Domain tag of the digest in an id.
const DOMAIN: &str = "holdpoint/store-id/v1";
/// The prefix of ids that are derived from a key.
const PREFIX: &str = "key-";
/// Digits of the digest in an id: 128 bits, too many to find a second key.
const DIGITS: usize = 32;

/// The id of a store that signs with this key.
#[must_use]
pub fn of_key(key: &VerifyingKey) -> String {
    let digits: String =
        Digest::of_parts(DOMAIN, &[key.as_bytes()]).to_string().chars().take(DIGITS).collect();
    format!("{PREFIX}{digits}")
}

/// Whether a store with this id signs with this key, as far as the id shows.
///
/// # Errors
/// What is wrong, if it does not.
pub fn check_key(store_id: &str, key: &VerifyingKey) -> Result<(), String> {
    if !store_id.starts_with(PREFIX) || store_id == of_key(key) {
        return Ok(());
    }
    Err(format!("the store {store_id:?} does not sign with this key: it would be {:?}", of_key(key)))
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
