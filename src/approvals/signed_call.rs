//! A signed request to an engine that grants or widens authority.
//!
//! The signature is over the request's content, the store, one session of the engine, a nonce and an expiry. It counts
//! once and only in that session.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::identity::{Identity, IdentityInfo};
use super::signed_approval::{ApprovalError, Nonce, holds};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::hex;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Separates these bytes from all other signed bytes.
const DOMAIN: &str = "holdpoint/call/v1";

/// What a request signature covers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CallClaim {
    /// Name of the identity.
    pub who: String,
    pub role: Role,
    /// Digest of the request's content.
    pub call: Digest,
    /// The store it was made for.
    pub store_id: String,
    /// The session it is made for.
    pub life: Nonce,
    pub nonce: Nonce,
    /// Virtual time at which it expires, ms.
    pub not_after_ms: u64,
}

impl CallClaim {
    /// The digest that is signed: every field with its length, behind a domain tag.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let Self { who, role, call, store_id, life, nonce, not_after_ms } = self;
        let not_after_ms = not_after_ms.to_le_bytes();
        let parts: [&[u8]; 7] = [
            store_id.as_bytes(),
            life.as_str().as_bytes(),
            who.as_bytes(),
            role.name().as_bytes(),
            call.bytes(),
            nonce.as_str().as_bytes(),
            &not_after_ms,
        ];
        Digest::of_parts(DOMAIN, &parts)
    }
}

/// A claim with its signature and the claimed key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SignedCall {
    claim: CallClaim,
    public_key: String,
    signature: String,
}

/// Why a signed request is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    #[error("the signature of {0:?} does not match the request")]
    Signature(String),
    #[error("the request is signed with another key than that of {0:?}")]
    Key(String),
    #[error("{who:?} signed as {signed} but is {is}")]
    Role { who: String, signed: Role, is: Role },
}

impl Hint for CallError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(ErrorReason::NotAllowed.into())
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Signature(_) | Self::Key(_) | Self::Role { .. } => None,
        }
    }
}

impl SignedCall {
    /// Signed; the claim's `who` and `role` are replaced by those of the signer.
    ///
    /// # Errors
    /// If the key's agent refuses to sign.
    pub(super) fn by(who: &Identity, mut claim: CallClaim) -> Result<Self, ApprovalError> {
        claim.who.clone_from(&who.info().name);
        claim.role = who.info().role;
        let public_key = hex(who.info().public_key.as_bytes());
        let signature = who.signature(&claim.digest())?;
        Ok(Self { claim, public_key, signature })
    }

    /// The signed claim. Trust it only after [`Self::verify`].
    #[must_use]
    pub const fn claim(&self) -> &CallClaim {
        &self.claim
    }

    /// The public key it carries, 64 hexadecimal digits.
    #[must_use]
    pub fn public_key(&self) -> &str {
        &self.public_key
    }

    /// Checks that this person made the claim, in their role (strict ed25519).
    ///
    /// # Errors
    /// [`CallError`].
    pub fn verify(&self, person: &IdentityInfo) -> Result<(), CallError> {
        if self.public_key != hex(person.public_key.as_bytes()) || self.claim.who != person.name {
            return Err(CallError::Key(person.name.clone()));
        }
        if self.claim.role != person.role {
            let (who, signed, is) = (person.name.clone(), self.claim.role, person.role);
            return Err(CallError::Role { who, signed, is });
        }
        if holds(&self.public_key, &self.signature, self.claim.digest().bytes()) {
            Ok(())
        } else {
            Err(CallError::Signature(self.claim.who.clone()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_edit_voids_the_signature() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let eve = Identity::create(folder.path(), "eve", Role::Operator).unwrap();
        let claim = CallClaim {
            who: String::new(),
            role: Role::Admin,
            call: Digest::of_parts("t", &[b"c"]),
            store_id: "s".into(),
            life: Nonce::from_bytes([1; 16]),
            nonce: Nonce::from_bytes([2; 16]),
            not_after_ms: 1000,
        };
        let signed = ada.sign_call(claim.clone()).unwrap();
        signed.verify(ada.info()).unwrap();
        assert!(matches!(eve.sign_call(claim).unwrap().verify(ada.info()), Err(CallError::Key(_))));
        type CallEdit = fn(&mut CallClaim);
        let edits: [(&str, CallEdit); 7] = [
            ("who", |c| c.who = "eve".into()),
            ("role", |c| c.role = Role::Safety),
            ("call", |c| c.call = Digest::of_parts("t", &[b"d"])),
            ("store", |c| c.store_id = "t".into()),
            ("life", |c| c.life = Nonce::from_bytes([3; 16])),
            ("nonce", |c| c.nonce = Nonce::from_bytes([3; 16])),
            ("expiry", |c| c.not_after_ms += 1),
        ];
        for (name, edit) in edits {
            let mut forged = signed.clone();
            edit(&mut forged.claim);
            assert!(forged.verify(ada.info()).is_err(), "{name}");
        }
        let json = serde_json::to_string(&signed).unwrap();
        assert_eq!(serde_json::from_str::<SignedCall>(&json).unwrap(), signed);
        assert!(serde_json::from_str::<SignedCall>(&json.replacen('{', "{\"x\":1,", 1)).is_err());
    }
}
