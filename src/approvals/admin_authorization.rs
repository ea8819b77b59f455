//! The common form of every administrator's authorization on a store: the administrator and the reason, the store and
//! the end of its chain, and whether the signing key had a passphrase.

use serde::{Deserialize, Serialize};

use super::identity::Identity;
use super::person::{PersonDirectory, PersonError};
use super::signed_approval::{ApprovalError, REASON_ALLOWED, holds, is_reason};
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::hex;
use holdpoint_text::is_visible;

/// The signed content of an authorization.
pub trait AdminAct {
    /// What a caller wants to do.
    type Subject<'a>;

    /// The digest that is signed: every field with its length, behind a domain tag.
    fn digest(&self) -> Digest;

    /// Whether it authorizes this.
    fn is_about(&self, subject: Self::Subject<'_>) -> bool;

    /// The fields that every authorization has.
    fn fields(&self) -> AdminActFields<'_>;
}

/// See [`AdminAct::fields`].
pub struct AdminActFields<'a> {
    /// Its subject, for errors.
    pub about: &'a str,
    pub by: &'a str,
    pub reason: &'a str,
    pub store_id: &'a str,
    /// Hash of the record that this one follows.
    pub after: Digest,
    pub guarded: bool,
}

/// An authorization with its signature and the claimed key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedAdminAct<A> {
    act: A,
    public_key: String,
    signature: String,
}

impl<A: AdminAct> SignedAdminAct<A> {
    pub(super) fn signed(who: &Identity, act: A) -> Result<Self, ApprovalError> {
        let signature = who.signature(&act.digest())?;
        Ok(Self { act, public_key: hex(who.info().public_key.as_bytes()), signature })
    }

    /// The signed content. Trust it only after [`Self::check`].
    pub const fn act(&self) -> &A {
        &self.act
    }

    /// Whether it permits the act: valid, with a readable reason.
    pub fn check(
        &self,
        persons: &PersonDirectory,
        subject: A::Subject<'_>,
        after: Digest,
    ) -> Result<(), PersonError> {
        if is_visible(self.act.fields().reason) {
            self.judge(persons, subject, after)
        } else {
            Err(self.bad_reason())
        }
    }

    /// Whether it is valid as recorded: an enrolled administrator signed it, for this subject and this end of the chain.
    pub fn judge(
        &self,
        persons: &PersonDirectory,
        subject: A::Subject<'_>,
        after: Digest,
    ) -> Result<(), PersonError> {
        let signed = self.act.fields();
        if !is_reason(signed.reason) {
            return Err(self.bad_reason());
        }
        if !holds(&self.public_key, &self.signature, self.act.digest().bytes()) {
            return Err(PersonError::Signature(signed.by.to_owned()));
        }
        let name = signed.about.to_owned();
        if signed.store_id != persons.store_id() {
            return Err(PersonError::OtherStore { name, found: signed.store_id.to_owned() });
        }
        if signed.after != after || !self.act.is_about(subject) {
            return Err(PersonError::AuthorizationDoesNotFollow(name));
        }
        persons.check_signer(signed.by, &self.public_key)
    }

    /// Whether, by the record, only the administrator could have signed it.
    ///
    /// # Errors
    /// [`PersonError::Unguarded`] or [`PersonError::SignerUnconfirmed`].
    pub fn check_guarded(&self, persons: &PersonDirectory) -> Result<(), PersonError> {
        let AdminActFields { by, guarded, .. } = self.act.fields();
        if !persons.is_confirmed(by) {
            return Err(PersonError::SignerUnconfirmed(by.to_owned()));
        }
        if guarded { Ok(()) } else { Err(PersonError::Unguarded(by.to_owned())) }
    }

    fn bad_reason(&self) -> PersonError {
        let name = self.act.fields().about.to_owned();
        PersonError::Field { name, field: "reason", allowed: REASON_ALLOWED }
    }
}
