//! The common part of every administrator's authorization on a store: the administrator and the reason, the store and
//! the end of its chain, and whether the signing key had a passphrase.

use super::person::{PersonDirectory, PersonError};
use super::signed_approval::{REASON_ALLOWED, holds, is_reason};
use holdpoint_governance::ids::Digest;
use holdpoint_text::is_visible;

/// The part of an authorization that is checked in the same way for all kinds.
pub(super) struct AdminAuthorization<'a> {
    /// Its subject, for errors.
    pub(super) about: &'a str,
    pub(super) by: &'a str,
    pub(super) reason: &'a str,
    pub(super) store_id: &'a str,
    pub(super) guarded: bool,
    pub(super) public_key: &'a str,
    pub(super) signature: &'a str,
    pub(super) digest: Digest,
    /// Whether it has the right subject and this end of the chain.
    pub(super) follows: bool,
}

impl AdminAuthorization<'_> {
    /// Whether it permits the act: valid, with a readable reason.
    pub(super) fn check(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
        if is_visible(self.reason) { self.judge(persons) } else { Err(self.bad_reason()) }
    }

    /// Whether it is valid as recorded: an enrolled administrator signed it, for this subject and this end of the chain.
    pub(super) fn judge(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
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
            return Err(PersonError::AuthorizationDoesNotFollow(self.about.to_owned()));
        }
        persons.check_signer(self.by, self.public_key)
    }

    /// Whether, by the record, only the administrator could have signed it.
    pub(super) fn check_guarded(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
        if !persons.is_confirmed(self.by) {
            return Err(PersonError::SignerUnconfirmed(self.by.to_owned()));
        }
        if self.guarded { Ok(()) } else { Err(PersonError::Unguarded(self.by.to_owned())) }
    }

    fn bad_reason(&self) -> PersonError {
        PersonError::Field { name: self.about.to_owned(), field: "reason", allowed: REASON_ALLOWED }
    }
}
