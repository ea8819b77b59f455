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

/// Asks for the passphrase of a key.
#[must_use]
pub fn passphrase_prompt(name: impl Display) -> String {
    format!("Passphrase of {name}: ")
}

/// Asks for a new passphrase of a key.
#[must_use]
pub fn new_passphrase_prompt(name: impl Display) -> String {
    format!("New passphrase of {name}: ")
}

/// A new identity whose key this administrator enrolled.
#[must_use]
pub fn enrolled_by(admin: impl Display) -> String {
    format!("enrolled by {admin}")
}

/// A new identity whose key the administrator enrolled with a key without a passphrase.
#[must_use]
pub fn enrolled_by_unprotected(admin: impl Display, name: impl Display) -> String {
    format!(
        "enrolled by {admin}, whose key has no passphrase: any process that can read it can enroll people, and the \
         profile human ignores the signatures of {name}. `holdpoint identity passphrase {admin}` sets one, and then \
         `holdpoint identity confirm {name} --by {admin} --reason TEXT`"
    )
}

/// A new identity that this administrator has to enroll.
#[must_use]
pub fn not_enrolled(name: impl Display, admin: impl Display) -> String {
    format!(
        "not enrolled: {name} cannot decide anything yet. `holdpoint identity enroll {name} --by {admin} --reason \
         TEXT` enrolls the key"
    )
}

/// The key and the role that an administrator is about to sign.
#[must_use]
pub fn to_be_enrolled(name: impl Display, role: impl Display, key: impl Display) -> String {
    format!("{name} is about to be enrolled as {role}, with the public key {key}")
}

/// As [`to_be_enrolled`], of a person whom an administrator is about to confirm.
#[must_use]
pub fn to_be_confirmed(name: impl Display, role: impl Display, key: impl Display) -> String {
    format!("{name} is about to be confirmed as {role}, with the public key {key}")
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
