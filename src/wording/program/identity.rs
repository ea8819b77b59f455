//! What `identity` prints: a new identity, its key and passphrase, persons that are enrolled, confirmed or revoked.

use std::fmt::Display;

/// A new identity, with the protection of its key.
#[must_use]
pub fn created(name: impl Display, role: impl Display, protection: &str, public_key: impl Display) -> String {
    format!("created the identity {name} ({role}, {protection}), public key {public_key}")
}

/// The passphrase of a key after it was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassphraseChange {
    /// Another one.
    Replaced,
    /// The first one.
    Set,
    /// None.
    Removed,
}

/// A changed passphrase.
#[must_use]
pub fn passphrase(of: PassphraseChange, name: impl Display) -> String {
    match of {
        PassphraseChange::Replaced => format!("the key of {name} has a new passphrase"),
        PassphraseChange::Set => format!("the key of {name} now has a passphrase"),
        PassphraseChange::Removed => {
            format!("the key of {name} has no passphrase now; the profile human accepts no approval of it")
        }
    }
}

/// An enrolled person.
#[must_use]
pub fn enrolled(name: impl Display, role: impl Display, by: impl Display) -> String {
    format!("{name} is enrolled as {role} by {by}")
}

/// A confirmed person.
#[must_use]
pub fn confirmed(name: impl Display, role: impl Display, key: impl Display, by: impl Display) -> String {
    format!("{name} ({role}, public key {key}) is confirmed by {by}")
}

/// A revoked person.
#[must_use]
pub fn revoked(name: impl Display, by: impl Display) -> String {
    format!("{name} is revoked by {by}: no signature of this key counts")
}

/// A store whose last confirming administrator was revoked.
pub const NOBODY_CONFIRMS: &str =
    "no administrator can confirm others: the profile human ignores unconfirmed persons";

/// The protection of a key whose file has wrong permissions or cannot be read.
#[must_use]
pub const fn unprotected(is_open: bool) -> &'static str {
    if is_open { "open to others" } else { "unreadable" }
}

/// A folder without identities.
#[must_use]
pub fn no_identities(folder: impl Display) -> String {
    format!("no identities in {folder}")
}
