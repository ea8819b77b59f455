//! What every administrator's signed word on a store has in common, whatever it is about: who gave it and why, for which store
//! and over which end of its chain, and whether the key that signed was guarded.

use super::person::{PersonError, Persons};
use super::signed::{REASON_ALLOWED, holds, is_reason};
use holdpoint_governance::ids::Digest;
use holdpoint_text::is_visible;

/// A word as far as it is judged alike for all of them.
pub(super) struct Word<'a> {
    /// What it is about, for errors.
    pub(super) about: &'a str,
    pub(super) by: &'a str,
    pub(super) reason: &'a str,
    pub(super) store_id: &'a str,
    pub(super) guarded: bool,
    pub(super) public_key: &'a str,
    pub(super) signature: &'a str,
    /// The digest that is to be signed.
    pub(super) digest: Digest,
    /// It is about what it is used for, and over this end of the chain.
    pub(super) follows: bool,
}

impl Word<'_> {
    /// Whether something may be done by it: it holds, with a reason that can be read.
    pub(super) fn check(&self, persons: &Persons) -> Result<(), PersonError> {
        if is_visible(self.reason) { self.judge(persons) } else { Err(self.bad_reason()) }
    }

    /// Whether it holds as it is on record: an administrator who is enrolled signed it, for this and over this end of the
    /// chain.
    pub(super) fn judge(&self, persons: &Persons) -> Result<(), PersonError> {
        if !is_reason(self.reason) {
            return Err(self.bad_reason());
        }
        if !holds(self.public_key, self.signature, self.digest.bytes()) {
            return Err(PersonError::Signature(self.by.to_owned()));
        }
        if self.store_id != persons.store_id() {
            return Err(PersonError::OtherStore {
                name: self.about.to_owned(),
                found: self.store_id.to_owned(),
            });
        }
        if !self.follows {
            return Err(PersonError::WordDoesNotFollow(self.about.to_owned()));
        }
        persons.check_signer(self.by, self.public_key)
    }

    /// Whether the signature is one that only the administrator could have made, as far as is on record.
    pub(super) fn check_guarded(&self, persons: &Persons) -> Result<(), PersonError> {
        if !persons.is_confirmed(self.by) {
            return Err(PersonError::SignerUnconfirmed(self.by.to_owned()));
        }
        if self.guarded { Ok(()) } else { Err(PersonError::Unguarded(self.by.to_owned())) }
    }

    fn bad_reason(&self) -> PersonError {
        PersonError::Field { name: self.about.to_owned(), field: "reason", allowed: REASON_ALLOWED }
    }
}
