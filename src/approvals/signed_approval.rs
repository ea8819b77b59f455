//! The approval object: what a person decided, bound to exactly what was shown, used once.

use std::borrow::Cow;

use ed25519_dalek::{Signature, VerifyingKey};
use serde::{Deserialize, Serialize};

use super::agent::AgentError;
use super::display_binding::DisplayBinding;
use super::identity::IdentityInfo;
use super::keyfile::parse_public;
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_text::hex::{hex, unhex};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Separates these bytes from all other signed bytes. For a decision without a displayed request: those of earlier
/// versions, and refusals by name.
const DOMAIN: &str = "holdpoint/approval/v1";
/// For a decision on a displayed request.
const DOMAIN_SHOWN: &str = "holdpoint/approval/v2";
pub(super) const REASON_BYTES_MAX: usize = 4096;
/// The allowed form of an act's reason.
pub(super) const REASON_ALLOWED: &str = "1 to 4096 bytes that can be read";

/// Whether a recorded reason has an allowed length and more than blanks and controls.
pub(super) fn is_reason(text: &str) -> bool {
    text.len() <= REASON_BYTES_MAX && text.chars().any(|ch| matches!(ch, '!'..='~' | '\u{a1}'..))
}

/// Whether a signature is by this key over these bytes, both in hexadecimal digits (strict ed25519: no malleable
/// signature, no weak key).
pub(super) fn holds(public_key: &str, signature: &str, bytes: &[u8]) -> bool {
    let key = parse_public(public_key);
    let signature = unhex::<64>(signature).map(|bytes| Signature::from_bytes(&bytes));
    key.zip(signature).is_some_and(|(key, signature)| key.verify_strict(bytes, &signature).is_ok())
}

/// A number used once: 16 bytes, written as 32 hexadecimal digits.
#[derive(
    Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct Nonce(String);

impl Nonce {
    /// A new one from the system's random numbers.
    ///
    /// # Errors
    /// [`ApprovalError::Random`].
    pub fn random() -> Result<Self, ApprovalError> {
        let mut bytes = [0u8; 16];
        getrandom::fill(&mut bytes).map_err(ApprovalError::Random)?;
        Ok(Self::from_bytes(bytes))
    }

    /// A given one, for scripts whose runs must be equal.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(hex(&bytes))
    }

    /// The 32 hexadecimal digits, as they are signed and stored.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for Nonce {
    type Error = ApprovalError;
    fn try_from(text: String) -> Result<Self, ApprovalError> {
        match unhex::<16>(&text) {
            Some(bytes) => Ok(Self::from_bytes(bytes)),
            None => Err(ApprovalError::Nonce(text)),
        }
    }
}

impl From<Nonce> for String {
    fn from(nonce: Nonce) -> Self {
        nonce.0
    }
}

impl std::fmt::Display for Nonce {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// A decision and everything it is bound to; any change voids it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Approval {
    /// Name of the identity.
    pub who: String,
    pub role: Role,
    pub decision: ApprovalDecision,
    pub reason: String,
    /// The version decided on.
    pub version: CapabilityId,
    /// Digest of the whole submission.
    pub candidate_digest: Digest,
    /// The row version decided on.
    pub row_version: u64,
    /// Digest of the displayed evidence.
    pub evidence_digest: Digest,
    /// Digest of profile, policies and thresholds.
    pub policy_digest: Digest,
    /// The profile it was made under.
    pub profile: ProfileName,
    /// The store it was made for.
    pub store_id: String,
    pub nonce: Nonce,
    /// When it expires, ms since 1970 by the machine's clock. Earlier versions wrote milliseconds of their engine's clock,
    /// which lie in 1970: those decisions have expired.
    pub not_after_ms: u64,
    /// Whether it is an emergency (break-glass) approval; signed, so that neither kind passes for the other.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub break_glass: bool,
    /// The displayed request. Absent in decisions of earlier versions and in some refusals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown: Option<DisplayBinding>,
}

/// What a break-glass approval signs in addition.
const BREAK_GLASS: &[u8] = b"break-glass";

impl Approval {
    /// When it expires.
    #[must_use]
    pub fn not_after(&self) -> WallTime {
        WallTime::from_ms(i64::try_from(self.not_after_ms).unwrap_or(i64::MAX))
    }

    /// The signed bytes: every field with its length, behind a domain tag.
    #[must_use]
    pub fn bytes(&self) -> [u8; 32] {
        let store_key = self.shown.as_ref().map_or("", |shown| shown.store_key.as_str());
        *self.digest(&self.store_id, store_key).bytes()
    }

    /// The decision without the store: the same in equal runs, so it can enter the audit chain.
    #[must_use]
    pub fn claim_digest(&self) -> Digest {
        self.digest("", "")
    }

    fn digest(&self, store_id: &str, store_key: &str) -> Digest {
        let Self { who, role, decision, reason, version, profile, nonce, .. } = self;
        let version = version.to_string();
        let (row_version, not_after_ms) = (self.row_version.to_le_bytes(), self.not_after_ms.to_le_bytes());
        let mut parts: Vec<&[u8]> = vec![
            store_id.as_bytes(),
            who.as_bytes(),
            role.name().as_bytes(),
            decision.name().as_bytes(),
            reason.as_bytes(),
            version.as_bytes(),
            self.candidate_digest.bytes(),
            &row_version,
            self.evidence_digest.bytes(),
            self.policy_digest.bytes(),
            profile.name().as_bytes(),
            nonce.as_str().as_bytes(),
            &not_after_ms,
        ];
        let Some(shown) = &self.shown else {
            if self.break_glass {
                parts.push(BREAK_GLASS);
            }
            return Digest::of_parts(DOMAIN, &parts);
        };
        let renderer = shown.renderer.to_le_bytes();
        parts.extend([
            if self.break_glass { BREAK_GLASS } else { b"" },
            &renderer,
            shown.lines.bytes(),
            shown.facts.bytes(),
            store_key.as_bytes(),
            shown.request.as_str().as_bytes(),
        ]);
        Digest::of_parts(DOMAIN_SHOWN, &parts)
    }
}

/// A decision with its signature and the claimed key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SignedApproval {
    approval: Approval,
    public_key: String,
    signature: String,
}

/// Why an approval is invalid.
#[derive(Debug, thiserror::Error)]
pub enum ApprovalError {
    #[error("{0:?} is not a nonce: 32 hexadecimal digits are needed")]
    Nonce(String),
    #[error("the system gave no random numbers for a nonce: {0}")]
    Random(getrandom::Error),
    #[error("the signature of {0:?} does not match the decision")]
    Signature(String),
    #[error("the decision is signed with another key than that of {0:?}")]
    Key(String),
    #[error("{who:?} signed as {signed:?} but is {is:?}")]
    Role {
        /// Name of the identity.
        who: String,
        signed: Role,
        is: Role,
    },
    #[error("what is to be signed has no canonical form: {0}")]
    NoForm(String),
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error("the reason has {0} bytes; at most 4096 are allowed")]
    ReasonTooLong(usize),
}

impl Hint for ApprovalError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Nonce(_) | Self::ReasonTooLong(_) => ErrorReason::BadInput.into(),
            Self::Random(_) => ErrorReason::Environment.into(),
            Self::Signature(_) | Self::Key(_) | Self::Role { .. } => ErrorReason::NotAllowed.into(),
            // A request for another version, person or purpose is refused in the same way.
            Self::NoForm(_) => ErrorReason::Stale.into(),
            Self::Agent(error) => return error.details(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Agent(error) => error.hint(),
            Self::Nonce(_)
            | Self::Random(_)
            | Self::Signature(_)
            | Self::Key(_)
            | Self::Role { .. }
            | Self::NoForm(_)
            | Self::ReasonTooLong(_) => None,
        }
    }
}

impl SignedApproval {
    pub(super) fn new(approval: Approval, public_key: VerifyingKey, signature: Signature) -> Self {
        Self { approval, public_key: hex(public_key.as_bytes()), signature: hex(&signature.to_bytes()) }
    }

    /// The decision. Trust it only after [`Self::verify`].
    #[must_use]
    pub const fn approval(&self) -> &Approval {
        &self.approval
    }

    /// The public key it carries, 64 hexadecimal digits.
    #[must_use]
    pub fn public_key(&self) -> &str {
        &self.public_key
    }

    /// The signature, 128 hexadecimal digits.
    #[must_use]
    pub fn signature(&self) -> &str {
        &self.signature
    }

    /// Joins the parts as stored; [`Self::verify_signature`] checks that they belong together.
    #[must_use]
    pub const fn from_parts(approval: Approval, public_key: String, signature: String) -> Self {
        Self { approval, public_key, signature }
    }

    /// Checks the signature against the key it carries (strict ed25519: no malleable signature, no weak key).
    ///
    /// # Errors
    /// [`ApprovalError::Signature`], [`ApprovalError::ReasonTooLong`].
    pub fn verify_signature(&self) -> Result<(), ApprovalError> {
        if self.approval.reason.len() > REASON_BYTES_MAX {
            return Err(ApprovalError::ReasonTooLong(self.approval.reason.len()));
        }
        if holds(&self.public_key, &self.signature, &self.approval.bytes()) {
            Ok(())
        } else {
            Err(ApprovalError::Signature(self.approval.who.clone()))
        }
    }

    /// Checks that this identity made the decision, in its role.
    ///
    /// # Errors
    /// [`ApprovalError`].
    pub fn verify(&self, identity: &IdentityInfo) -> Result<(), ApprovalError> {
        if self.public_key != hex(identity.public_key.as_bytes()) || self.approval.who != identity.name {
            return Err(ApprovalError::Key(identity.name.clone()));
        }
        if self.approval.role != identity.role {
            return Err(ApprovalError::Role {
                who: identity.name.clone(),
                signed: self.approval.role,
                is: identity.role,
            });
        }
        self.verify_signature()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Identity;
    use super::*;

    fn approval() -> Approval {
        Approval {
            who: String::new(),
            role: Role::Operator,
            decision: ApprovalDecision::Approve,
            reason: "seen".into(),
            version: "grasp@1.2.0".parse().unwrap(),
            candidate_digest: Digest::of_parts("t", &[b"c"]),
            row_version: 4,
            evidence_digest: Digest::of_parts("t", &[b"e"]),
            policy_digest: Digest::of_parts("t", &[b"p"]),
            profile: ProfileName::Human,
            store_id: "s".into(),
            nonce: Nonce::from_bytes([7; 16]),
            not_after_ms: 1000,
            break_glass: false,
            shown: Some(DisplayBinding {
                renderer: 1,
                lines: Digest::of_parts("t", &[b"l"]),
                facts: Digest::of_parts("t", &[b"f"]),
                store_key: "k".into(),
                request: Nonce::from_bytes([9; 16]),
            }),
        }
    }

    fn edit_shown(approval: &mut Approval, edit: impl FnOnce(&mut DisplayBinding)) {
        edit(approval.shown.as_mut().unwrap());
    }

    #[test]
    fn any_edit_voids_the_signature() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let signed = ada.sign(approval()).unwrap();
        signed.verify(ada.info()).unwrap();
        let other = Digest::of_parts("t", &[b"x"]);
        type ApprovalEdit = fn(&mut Approval, Digest);
        let edits: [(&str, ApprovalEdit); 20] = [
            ("who", |a, _| a.who = "eve".into()),
            ("role", |a, _| a.role = Role::Safety),
            ("decision", |a, _| a.decision = ApprovalDecision::Reject),
            ("reason", |a, _| a.reason.push('!')),
            ("version", |a, _| a.version = "grasp@1.2.1".parse().unwrap()),
            ("candidate", |a, d| a.candidate_digest = d),
            ("row", |a, _| a.row_version += 1),
            ("evidence", |a, d| a.evidence_digest = d),
            ("policy", |a, d| a.policy_digest = d),
            ("profile", |a, _| a.profile = ProfileName::Sim),
            ("store", |a, _| a.store_id = "t".into()),
            ("nonce", |a, _| a.nonce = Nonce::from_bytes([8; 16])),
            ("expiry", |a, _| a.not_after_ms += 1),
            ("emergency", |a, _| a.break_glass = true),
            ("renderer", |a, _| edit_shown(a, |shown| shown.renderer = 2)),
            ("lines", |a, d| edit_shown(a, |shown| shown.lines = d)),
            ("facts", |a, d| edit_shown(a, |shown| shown.facts = d)),
            ("store key", |a, _| edit_shown(a, |shown| shown.store_key = "x".into())),
            ("request", |a, _| edit_shown(a, |shown| shown.request = Nonce::from_bytes([8; 16]))),
            ("nothing shown", |a, _| a.shown = None),
        ];
        for (name, edit) in edits {
            let mut forged = signed.clone();
            edit(&mut forged.approval, other);
            assert!(forged.verify_signature().is_err(), "{name}");
            assert!(forged.verify(ada.info()).is_err(), "{name}");
        }
    }

    /// Equal runs have equal claims in any store; the displayed request is a part of the claim.
    #[test]
    fn claim_digest_covers_the_shown_request_and_no_store() {
        let claim = approval().claim_digest();
        let mut elsewhere = approval();
        elsewhere.store_id = "other".into();
        edit_shown(&mut elsewhere, |shown| shown.store_key = "other".into());
        assert_eq!(elsewhere.claim_digest(), claim);
        let mut otherwise = approval();
        edit_shown(&mut otherwise, |shown| shown.lines = Digest::of_parts("t", &[b"x"]));
        assert_ne!(otherwise.claim_digest(), claim);
    }

    #[test]
    fn another_persons_key_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let eve = Identity::create(folder.path(), "eve", Role::Operator).unwrap();
        let signed = eve.sign(approval()).unwrap();
        assert!(matches!(signed.verify(ada.info()), Err(ApprovalError::Key(_))));
        let json = serde_json::to_string(&signed).unwrap();
        assert_eq!(serde_json::from_str::<SignedApproval>(&json).unwrap(), signed);
        assert!(serde_json::from_str::<SignedApproval>(&json.replacen('{', "{\"x\":1,", 1)).is_err());
    }
}
