//! Persons: the keys that may decide in a store. An administrator's signed act enrolls or revokes a key.
//!
//! Every act follows from the one before it in its store, so that none can be left out, reordered or carried to
//! another store. The first act adds the store's first administrator and is signed by that key itself. Every later
//! person needs an administrator who is enrolled at that moment. One key is one person: a name and a key are used
//! once, also after they were revoked.
//!
//! A reader of an unencrypted key can enroll anyone. So *verified* is separate from enrolled: a verified
//! administrator signs the enrollment or a later act with a passphrase-protected key. Trust begins with the first
//! administrator, and what its key signed while unencrypted verifies no person. The validity of an act is fixed when
//! it is signed.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use ed25519_dalek::VerifyingKey;
use serde::{Deserialize, Serialize};

use super::identity::{Identity, IdentityInfo};
use super::keyfile::parse_public;
use super::signed_approval::{ApprovalError, Nonce, REASON_ALLOWED, holds, is_reason};
use holdpoint_governance::approval::Role;
use holdpoint_governance::closed_set;
use holdpoint_governance::ids::{Digest, is_name};
use holdpoint_text::hex::hex;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, is_visible};

/// Separates these bytes from all other signed bytes.
const DOMAIN: &str = "holdpoint/person-act/v1";
/// What the first act of a store follows from.
const FIRST: &str = "holdpoint/persons/v1";
/// The most persons of a store, revoked ones included.
pub const PERSONS_MAX: usize = 1000;

closed_set! {
    /// What an administrator does with a person's key.
    PersonActKind, "act about a person", {
        /// From now on, signatures of the key may count.
        Enrol = "enrol",
        /// An administrator attests a person whose enrolling key others could have used.
        Confirm = "confirm",
        /// No signature of the key counts any more, past or future.
        Revoke = "revoke",
    }
}

closed_set! {
    /// The state of a person in a store.
    PersonState, "state of a person", {
        Enrolled = "enrolled",
        /// Final: neither the name nor the key is used again.
        Revoked = "revoked",
    }
}

/// An administrator's act on a person's key, and everything it is bound to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonAct {
    pub act: PersonActKind,
    /// The person it is about.
    pub name: String,
    pub role: Role,
    /// The person's public key, 64 hexadecimal digits.
    pub key: String,
    /// Whether the key had no passphrase when it was enrolled, as far as that could be seen.
    pub unprotected: bool,
    /// Name of the administrator; in a store's first act, the name of the first administrator.
    pub by: String,
    /// Why, in the administrator's own words.
    pub reason: String,
    /// The store it was made for.
    pub store_id: String,
    /// Digest of the act before it in that store.
    pub follows: Digest,
    pub nonce: Nonce,
    /// Whether the signing key had a passphrase or lay elsewhere, as far as the program could see. False in the acts
    /// of earlier versions, which do not record it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub guarded: bool,
}

impl PersonAct {
    /// The digest that is signed, and that the next act follows from: every field with its length, behind a domain tag,
    /// and one part more if the key had a passphrase.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let Self { act, name, role, key, unprotected, by, reason, store_id, follows, nonce, guarded } = self;
        let mut parts: Vec<&[u8]> = vec![
            store_id.as_bytes(),
            follows.bytes(),
            act.name().as_bytes(),
            name.as_bytes(),
            role.name().as_bytes(),
            key.as_bytes(),
            if *unprotected { b"unprotected" } else { b"" },
            by.as_bytes(),
            reason.as_bytes(),
            nonce.as_str().as_bytes(),
        ];
        if *guarded {
            parts.push(b"guarded");
        }
        Digest::of_parts(DOMAIN, &parts)
    }
}

/// An act with its signature and the key that is to have made it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SignedPersonAct {
    act: PersonAct,
    public_key: String,
    signature: String,
}

impl SignedPersonAct {
    fn by(who: &Identity, act: PersonAct) -> Result<Self, ApprovalError> {
        let public_key = hex(who.info().public_key.as_bytes());
        let signature = who.signature(&act.digest())?;
        Ok(Self::new(act, public_key, signature))
    }

    pub(super) const fn new(act: PersonAct, public_key: String, signature: String) -> Self {
        Self { act, public_key, signature }
    }

    /// The act. Trust it only after [`PersonDirectory::check`].
    #[must_use]
    pub const fn act(&self) -> &PersonAct {
        &self.act
    }
}

/// Why an act about a person is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PersonError {
    /// A field that is not allowed.
    #[error("the act about the person {name:?} has a bad {field}: {allowed}")]
    Field { name: String, field: &'static str, allowed: &'static str },
    #[error("the signature of {0:?} does not match the act")]
    Signature(String),
    #[error("the act about {name:?} was made for the store {found:?}")]
    OtherStore { name: String, found: String },
    /// Another act came between, or it was used before.
    #[error("the act about {0:?} does not follow from the last one about people in this store")]
    DoesNotFollow(String),
    /// Another record came between, it was used before, or it is about something else.
    #[error("the authorization about {0:?} is for another end of the record, or about something else")]
    AuthorizationDoesNotFollow(String),
    /// The signer is unknown, another person, or revoked.
    #[error(
        "{0:?} is not enrolled in this store with the key that signed, and signs for no person, witness or profile"
    )]
    SignerUnknown(String),
    #[error(
        "{name:?} is enrolled as {role}, and only an administrator signs for people, witnesses and profiles"
    )]
    NoAdministrator { name: String, role: Role },
    /// The first act of a store must enroll the administrator who signs it.
    #[error("the first person of a store is an administrator who enrolls their own key; {0:?} is not")]
    NotTheFirst(String),
    #[error("the name {name:?} is {state} in this store already; a name stands for one key")]
    NameTaken { name: String, state: PersonState },
    #[error("the key of {name:?} is that of {other:?} already ({state}); one key is one person")]
    KeyTaken { name: String, other: String, state: PersonState },
    /// Any reader of the signer's key could have signed.
    #[error("the key of {0:?} had no passphrase when it signed; signatures of such keys do not count here")]
    Unguarded(String),
    /// No verified administrator attested the signer.
    #[error(
        "{0:?} is not verified, because others could have used the enrolling key, and verifies no one else"
    )]
    SignerUnconfirmed(String),
    #[error("{name:?} is verified already, by {by:?}")]
    Confirmed { name: String, by: String },
    #[error("{0:?} is not enrolled in this store")]
    NotEnrolled(String),
    #[error("{0:?} is the last administrator of this store and cannot be revoked")]
    LastAdministrator(String),
    #[error("this store has 1000 persons already, revoked ones included")]
    TooMany,
}

impl PersonError {
    /// The cause for a signer whose key has no passphrase.
    pub const NO_PASSPHRASE: &'static str = "no-passphrase";

    /// Its name for programs.
    const fn cause(&self) -> &'static str {
        match self {
            Self::Field { .. } => "field",
            Self::Signature(_) => "signature",
            Self::OtherStore { .. } => "other-store",
            Self::DoesNotFollow(_) | Self::AuthorizationDoesNotFollow(_) => "does-not-follow",
            Self::SignerUnknown(_) => "signer-unknown",
            Self::NoAdministrator { .. } => "no-administrator",
            Self::NotTheFirst(_) => "not-the-first",
            Self::NameTaken { .. } => "name-taken",
            Self::KeyTaken { .. } => "key-taken",
            Self::Unguarded(_) => Self::NO_PASSPHRASE,
            Self::SignerUnconfirmed(_) => "signer-unconfirmed",
            Self::Confirmed { .. } => "confirmed-already",
            Self::NotEnrolled(_) => "not-enrolled",
            Self::LastAdministrator(_) => "last-administrator",
            Self::TooMany => "too-many-persons",
        }
    }

    const fn reason(&self) -> ErrorReason {
        match self {
            Self::Field { .. } => ErrorReason::BadInput,
            Self::DoesNotFollow(_) | Self::AuthorizationDoesNotFollow(_) => ErrorReason::Stale,
            Self::NameTaken { .. } | Self::KeyTaken { .. } | Self::Confirmed { .. } => ErrorReason::Exists,
            Self::NotEnrolled(_) => ErrorReason::NotFound,
            Self::Signature(_)
            | Self::OtherStore { .. }
            | Self::SignerUnknown(_)
            | Self::NoAdministrator { .. }
            | Self::NotTheFirst(_)
            | Self::Unguarded(_)
            | Self::SignerUnconfirmed(_)
            | Self::LastAdministrator(_)
            | Self::TooMany => ErrorReason::NotAllowed,
        }
    }
}

impl Hint for PersonError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorDetails::from(self.reason()).with_cause(self.cause()))
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::DoesNotFollow(_) | Self::AuthorizationDoesNotFollow(_) => {
                Some("sign it again over the store as it is now".into())
            }
            Self::SignerUnknown(_) | Self::NoAdministrator { .. } => {
                Some("`holdpoint identity list` names the administrators; name one with --by".into())
            }
            Self::Unguarded(by) => {
                Some(format!("`holdpoint identity passphrase {by}` sets one and keeps the key").into())
            }
            Self::SignerUnconfirmed(by) => Some(
                format!("`holdpoint identity confirm {by} --by admin --reason TEXT`, by a verified administrator, comes first")
                    .into(),
            ),
            Self::NameTaken { .. } => Some("choose another name".into()),
            Self::KeyTaken { .. } => Some("make another key with `holdpoint identity new`".into()),
            Self::LastAdministrator(_) => Some("enroll another administrator first".into()),
            Self::NotEnrolled(_) => Some("see `holdpoint identity list`".into()),
            Self::Field { .. }
            | Self::Signature(_)
            | Self::OtherStore { .. }
            | Self::NotTheFirst(_)
            | Self::Confirmed { .. }
            | Self::TooMany => None,
        }
    }
}

/// A person of a store, as the acts about the person state it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Person {
    pub name: String,
    pub role: Role,
    pub public_key: VerifyingKey,
    pub state: PersonState,
    /// Whether the key had no passphrase when it was enrolled.
    pub unprotected: bool,
    pub enrolled_by: String,
    /// The administrator who verified this person; the first administrator's own name for itself. If absent,
    /// `human` does not count what this person signs.
    pub confirmed_by: Option<String>,
    /// Absent while enrolled.
    pub revoked_by: Option<String>,
}

impl Person {
    /// The name and role that a signature carries.
    #[must_use]
    pub fn info(&self) -> IdentityInfo {
        IdentityInfo { name: self.name.clone(), role: self.role, public_key: self.public_key }
    }

    /// The public key, 64 hexadecimal digits.
    #[must_use]
    pub fn key_hex(&self) -> String {
        hex(self.public_key.as_bytes())
    }
}

/// All persons of a store, enrolled or revoked: the result of its acts in order.
#[derive(Clone, Debug)]
pub struct PersonDirectory {
    store_id: String,
    follows: Digest,
    by_name: BTreeMap<String, Person>,
}

impl PersonDirectory {
    /// The directory of a store without acts.
    #[must_use]
    pub fn none(store_id: &str) -> Self {
        let follows = Digest::of_parts(FIRST, &[store_id.as_bytes()]);
        Self { store_id: store_id.to_owned(), follows, by_name: BTreeMap::new() }
    }

    /// Their store.
    #[must_use]
    pub fn store_id(&self) -> &str {
        &self.store_id
    }

    /// All persons, by name.
    pub fn all(&self) -> impl Iterator<Item = &Person> {
        self.by_name.values()
    }

    /// Whether the store has never had a person.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by_name.is_empty()
    }

    /// The person of this name, enrolled or revoked.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Person> {
        self.by_name.get(name)
    }

    /// The person with this key, enrolled or revoked.
    #[must_use]
    pub fn with_key(&self, key: &VerifyingKey) -> Option<&Person> {
        self.all().find(|person| person.public_key == *key)
    }

    /// The verified persons, enrolled or revoked.
    pub fn confirmed(&self) -> impl Iterator<Item = &Person> {
        self.all().filter(|person| person.confirmed_by.is_some())
    }

    /// The same persons as of the time when only these were enrolled.
    #[must_use]
    pub fn at_a_time(&self, enrolled: impl Fn(&Person) -> bool) -> Self {
        let mut then = self.clone();
        for person in then.by_name.values_mut() {
            person.state = if enrolled(person) { PersonState::Enrolled } else { PersonState::Revoked };
        }
        then
    }

    /// The approvers.
    pub fn enrolled(&self) -> impl Iterator<Item = &Person> {
        self.all().filter(|person| person.state == PersonState::Enrolled)
    }

    pub fn administrators(&self) -> impl Iterator<Item = &Person> {
        self.enrolled().filter(|person| person.role == Role::Admin)
    }

    /// An administrator whose key lies in this folder without a passphrase, so that signing needs no prompt.
    #[must_use]
    pub fn unprotected_administrator(&self, folder: &Path) -> Option<Identity> {
        let load = |admin: &Person| Identity::load(folder, &admin.name).ok();
        let is_theirs = |admin: &Person, key: &Identity| *key.info() == admin.info();
        self.administrators().find_map(|admin| load(admin).filter(|key| is_theirs(admin, key)))
    }

    /// An act, signed by an administrator, that adds `who` to the store.
    ///
    /// # Errors
    /// If the machine gives no random number for the nonce, or the agent that holds the key signs nothing.
    pub fn enrolment(
        &self,
        who: &IdentityInfo,
        unprotected: bool,
        by: &Identity,
        reason: &str,
    ) -> Result<SignedPersonAct, ApprovalError> {
        self.act(PersonActKind::Enrol, who, unprotected, (by, reason))
    }

    /// An act that verifies `who`, signed by a verified administrator.
    ///
    /// # Errors
    /// If the machine gives no random number for the nonce, or the agent that holds the key signs nothing.
    pub fn confirmation(
        &self,
        who: &Person,
        by: &Identity,
        reason: &str,
    ) -> Result<SignedPersonAct, ApprovalError> {
        self.act(PersonActKind::Confirm, &who.info(), who.unprotected, (by, reason))
    }

    /// An administrator who can verify others, by name.
    #[must_use]
    pub fn confirmer(&self) -> Option<&Person> {
        self.administrators().find(|admin| admin.confirmed_by.is_some())
    }

    /// An act that revokes `who`, signed by an administrator.
    ///
    /// # Errors
    /// If the machine gives no random number for the nonce, or the agent that holds the key signs nothing.
    pub fn revocation(
        &self,
        who: &Person,
        by: &Identity,
        reason: &str,
    ) -> Result<SignedPersonAct, ApprovalError> {
        self.act(PersonActKind::Revoke, &who.info(), who.unprotected, (by, reason))
    }

    fn act(
        &self,
        act: PersonActKind,
        who: &IdentityInfo,
        unprotected: bool,
        (by, reason): (&Identity, &str),
    ) -> Result<SignedPersonAct, ApprovalError> {
        let act = PersonAct {
            act,
            name: who.name.clone(),
            role: who.role,
            key: hex(who.public_key.as_bytes()),
            unprotected,
            by: by.info().name.clone(),
            reason: reason.to_owned(),
            store_id: self.store_id.clone(),
            follows: self.follows,
            nonce: Nonce::random()?,
            guarded: by.is_guarded(),
        };
        SignedPersonAct::by(by, act)
    }

    /// Whether an act is allowed now: valid, with a readable reason.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn check(&self, signed: &SignedPersonAct) -> Result<(), PersonError> {
        if is_visible(&signed.act.reason) {
            return self.judge(signed);
        }
        let (name, allowed) = (signed.act.name.clone(), REASON_ALLOWED);
        Err(PersonError::Field { name, field: "reason", allowed })
    }

    /// Whether a recorded act is valid: signed by an enrolled administrator, over this store in its present state. It
    /// ignores whether the reason is readable, because that depends on Unicode tables, which change.
    ///
    /// # Errors
    /// [`PersonError`], the first thing that is wrong.
    pub fn judge(&self, signed: &SignedPersonAct) -> Result<(), PersonError> {
        let act = &signed.act;
        let name = || act.name.clone();
        let field = |field, allowed| Err(PersonError::Field { name: name(), field, allowed });
        if !is_name(&act.name) {
            return field("name", "1 to 64 of a-z, 0-9, '.', '_', '-', starting with a letter or digit");
        }
        if !is_reason(&act.reason) {
            return field("reason", REASON_ALLOWED);
        }
        let Some(key) = parse_public(&act.key) else {
            return field("key", "64 hexadecimal digits of an ed25519 public key");
        };
        if !holds(&signed.public_key, &signed.signature, act.digest().bytes()) {
            return Err(PersonError::Signature(act.by.clone()));
        }
        if act.store_id != self.store_id {
            return Err(PersonError::OtherStore { name: name(), found: act.store_id.clone() });
        }
        if act.follows != self.follows {
            return Err(PersonError::DoesNotFollow(name()));
        }
        if self.is_empty() {
            let own = act.by == act.name && signed.public_key == act.key;
            let first = act.act == PersonActKind::Enrol && act.role == Role::Admin && own;
            return if first { Ok(()) } else { Err(PersonError::NotTheFirst(name())) };
        }
        self.check_signer(&act.by, &signed.public_key)?;
        match act.act {
            PersonActKind::Enrol => self.check_enrollment(act, &key),
            PersonActKind::Confirm => self.check_confirmation(act, &key),
            PersonActKind::Revoke => self.check_revocation(act, &key),
        }
    }

    /// Whether an enrolled administrator has that key.
    pub(super) fn check_signer(&self, by: &str, public_key: &str) -> Result<(), PersonError> {
        let is_signer = |person: &&Person| {
            person.state == PersonState::Enrolled && hex(person.public_key.as_bytes()) == public_key
        };
        let signer =
            self.named(by).filter(is_signer).ok_or_else(|| PersonError::SignerUnknown(by.to_owned()))?;
        match signer.role {
            Role::Admin => Ok(()),
            role @ (Role::Operator | Role::Engineer | Role::Safety) => {
                Err(PersonError::NoAdministrator { name: by.to_owned(), role })
            }
        }
    }

    fn check_enrollment(&self, act: &PersonAct, key: &VerifyingKey) -> Result<(), PersonError> {
        let name = act.name.clone();
        if let Some(other) = self.with_key(key).filter(|other| other.name != act.name) {
            return Err(PersonError::KeyTaken { name, other: other.name.clone(), state: other.state });
        }
        if let Some(same) = self.named(&act.name) {
            return Err(PersonError::NameTaken { name, state: same.state });
        }
        if self.by_name.len() >= PERSONS_MAX { Err(PersonError::TooMany) } else { Ok(()) }
    }

    fn enrolled_of(&self, act: &PersonAct, key: &VerifyingKey) -> Result<&Person, PersonError> {
        let enrolled = |person: &&Person| {
            person.state == PersonState::Enrolled && (person.public_key, person.role) == (*key, act.role)
        };
        self.named(&act.name).filter(enrolled).ok_or_else(|| PersonError::NotEnrolled(act.name.clone()))
    }

    fn check_confirmation(&self, act: &PersonAct, key: &VerifyingKey) -> Result<(), PersonError> {
        let person = self.enrolled_of(act, key)?;
        if let Some(by) = &person.confirmed_by {
            return Err(PersonError::Confirmed { name: act.name.clone(), by: by.clone() });
        }
        if !self.is_confirmed(&act.by) {
            return Err(PersonError::SignerUnconfirmed(act.by.clone()));
        }
        if act.guarded { Ok(()) } else { Err(PersonError::Unguarded(act.by.clone())) }
    }

    pub(super) fn is_confirmed(&self, name: &str) -> bool {
        self.named(name).is_some_and(|person| person.confirmed_by.is_some())
    }

    fn check_revocation(&self, act: &PersonAct, key: &VerifyingKey) -> Result<(), PersonError> {
        let person = self.enrolled_of(act, key)?;
        if person.role == Role::Admin && self.administrators().count() == 1 {
            return Err(PersonError::LastAdministrator(act.name.clone()));
        }
        Ok(())
    }

    /// Applies a valid act.
    ///
    /// # Errors
    /// As [`PersonDirectory::judge`]; nothing has changed then.
    pub fn push(&mut self, signed: &SignedPersonAct) -> Result<(), PersonError> {
        self.judge(signed)?;
        let act = &signed.act;
        match act.act {
            PersonActKind::Enrol => {
                let Some(public_key) = parse_public(&act.key) else {
                    return Err(PersonError::Signature(act.by.clone()));
                };
                // Trust starts at the first administrator and passes on by acts of passphrase-protected keys only.
                let is_confirmed = self.is_empty() || (act.guarded && self.is_confirmed(&act.by));
                let person = Person {
                    name: act.name.clone(),
                    role: act.role,
                    public_key,
                    state: PersonState::Enrolled,
                    unprotected: act.unprotected,
                    enrolled_by: act.by.clone(),
                    confirmed_by: is_confirmed.then(|| act.by.clone()),
                    revoked_by: None,
                };
                self.by_name.insert(act.name.clone(), person);
            }
            PersonActKind::Confirm => {
                if let Some(person) = self.by_name.get_mut(&act.name) {
                    person.confirmed_by = Some(act.by.clone());
                }
            }
            PersonActKind::Revoke => {
                if let Some(person) = self.by_name.get_mut(&act.name) {
                    person.state = PersonState::Revoked;
                    person.revoked_by = Some(act.by.clone());
                }
            }
        }
        self.follows = act.digest();
        Ok(())
    }
}

#[cfg(test)]
mod tests;
