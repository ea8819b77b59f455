//! The key that gives the seeds of one evaluation, or of a stretch of live work, and its two records.
//!
//! A store's secret and a nonce give the key. The engine records a commitment to it before the first episode, and the
//! key itself once the episodes are run, so that every client can draw the seeds again. Owns the forms and the arithmetic;
//! the engine has secret and nonce.

use serde::{Deserialize, Serialize};

use crate::evidence::EvidenceBinding;
use crate::ids::{CapabilityId, Digest};

crate::closed_set! {
    /// What a key's seeds are for.
    KeyUse, "use of a key", {
        /// The evaluation in the sandbox.
        Sandbox = "sandbox",
        /// The second budget before a confirmation.
        Confirmation = "confirmation",
        /// The re-evaluation in the live cell's conditions.
        ReEvaluation = "re-evaluation",
        /// A stretch of live work.
        Live = "live",
    }
}

/// A key for seeds; its debug form does not show it.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(transparent)]
pub struct EvaluationKey(Digest);

impl std::fmt::Debug for EvaluationKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("EvaluationKey")
    }
}

impl EvaluationKey {
    /// The key that 32 secret bytes are.
    #[must_use]
    pub const fn from_secret(bytes: [u8; 32]) -> Self {
        Self(Digest::from_bytes(bytes))
    }

    /// The digest on record before the key is used. The key cannot be computed from it.
    #[must_use]
    pub fn commitment(&self) -> Digest {
        Digest::of_parts("holdpoint.key-commitment.v1", &[self.0.bytes()])
    }

    /// The `index`-th number under a name, 64 bits. Without the key, they look random.
    #[must_use]
    pub fn number(&self, name: &str, index: u64) -> u64 {
        let parts = [self.0.bytes().as_slice(), name.as_bytes(), &index.to_le_bytes()];
        let digest = Digest::of_parts("holdpoint.keyed-number.v1", &parts);
        digest.bytes().iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte))
    }
}

/// The record of a key before its first use.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyCommitment {
    /// What its seeds are for.
    #[serde(rename = "use")]
    pub key_use: KeyUse,
    /// The version that is evaluated; absent for live work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<CapabilityId>,
    /// What the evaluation is about; absent for live work.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub binding: Option<EvidenceBinding>,
    /// From the operating system, 32 hexadecimal digits: with the store's secret it gives the key again.
    pub nonce: String,
    /// Digest of the key.
    pub commitment: Digest,
}

impl KeyCommitment {
    /// What the store's secret is applied to, to derive the key.
    ///
    /// # Errors
    /// Never for a binding, which has no floats.
    pub fn derivation(
        key_use: KeyUse,
        version: Option<&CapabilityId>,
        binding: Option<&EvidenceBinding>,
        nonce: &str,
    ) -> Result<String, serde_json::Error> {
        let digest = Digest::of_json("holdpoint.key-derivation.v1", &(key_use, version, binding, nonce))?;
        Ok(format!("evaluation key {digest}"))
    }
}

/// The record that reveals a key, once nothing runs under it any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyReveal {
    /// The commitment it belongs to.
    pub commitment: Digest,
    /// The key.
    pub key: EvaluationKey,
}

impl KeyReveal {
    /// Whether the key is the one that was committed to.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.key.commitment() == self.commitment
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_committed_key_is_a_sound_reveal() {
        let key = EvaluationKey::from_secret([3; 32]);
        let reveal = KeyReveal { commitment: key.commitment(), key };
        assert!(reveal.is_sound());
        assert!(!KeyReveal { key: EvaluationKey::from_secret([4; 32]), ..reveal }.is_sound());
        assert_eq!(format!("{key:?}"), "EvaluationKey");
    }

    #[test]
    fn derivation_depends_on_every_input() {
        let id: CapabilityId = "grasp@1.1.0".parse().unwrap();
        let of = |key_use, version, nonce| KeyCommitment::derivation(key_use, version, None, nonce).unwrap();
        let one = of(KeyUse::Sandbox, Some(&id), "aa");
        assert_eq!(one, of(KeyUse::Sandbox, Some(&id), "aa"));
        for other in [
            of(KeyUse::Confirmation, Some(&id), "aa"),
            of(KeyUse::Sandbox, None, "aa"),
            of(KeyUse::Sandbox, Some(&id), "ab"),
        ] {
            assert_ne!(one, other);
        }
    }
}
