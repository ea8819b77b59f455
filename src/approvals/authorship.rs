//! An author's signature under a version: an enrolled person's, or an organization's whose key is enrolled.
//!
//! It covers the candidate's digest and the text of its submission, so that code, author, parent and estimated risk
//! cannot be exchanged under it. It names the author of the version and gives it no authority.

use serde::{Deserialize, Serialize};

use super::identity::Identity;
use super::signed_approval::{ApprovalError, holds};
use holdpoint_governance::ids::Digest;
use holdpoint_text::hex::hex;

/// Separates these bytes from all other signed bytes.
const DOMAIN: &str = "holdpoint/authorship/v1";

/// The author's signature, as the file `author.sig` beside a manifest has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignedAuthorship {
    /// Name of the identity; the submission names the same author.
    pub author: String,
    /// The claimed key, 64 hexadecimal digits.
    pub public_key: String,
    /// The signature, 128 hexadecimal digits.
    pub signature: String,
}

impl SignedAuthorship {
    /// Signs a version as its author.
    ///
    /// # Errors
    /// If the key's agent refuses to sign.
    pub fn by(who: &Identity, candidate: &Digest, submission: &str) -> Result<Self, ApprovalError> {
        let author = who.info().name.clone();
        let signature = who.signature(&digest(&author, candidate, submission))?;
        Ok(Self { author, public_key: hex(who.info().public_key.as_bytes()), signature })
    }

    /// Whether the named key signed this version (strict ed25519).
    #[must_use]
    pub fn holds(&self, candidate: &Digest, submission: &str) -> bool {
        let signed = digest(&self.author, candidate, submission);
        holds(&self.public_key, &self.signature, signed.bytes())
    }
}

fn digest(author: &str, candidate: &Digest, submission: &str) -> Digest {
    Digest::of_parts(DOMAIN, &[author.as_bytes(), candidate.bytes(), submission.as_bytes()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::Role;

    #[test]
    fn signature_covers_version_submission_and_author() {
        let folder = tempfile::tempdir().unwrap();
        let acme = Identity::create(folder.path(), "acme", Role::Operator).unwrap();
        let candidate = Digest::of_parts("t", &[b"c"]);
        let signed = SignedAuthorship::by(&acme, &candidate, "author = \"acme\"").unwrap();
        assert!(signed.holds(&candidate, "author = \"acme\""));
        assert!(!signed.holds(&Digest::of_parts("t", &[b"d"]), "author = \"acme\""));
        assert!(!signed.holds(&candidate, "author = \"acme\"\nestimated_risk = \"low\""));
        let renamed = SignedAuthorship { author: "ada".to_owned(), ..signed.clone() };
        assert!(!renamed.holds(&candidate, "author = \"acme\""));
        let other = Identity::create(folder.path(), "other", Role::Operator).unwrap();
        let public_key = hex(other.info().public_key.as_bytes());
        assert!(!SignedAuthorship { public_key, ..signed }.holds(&candidate, "author = \"acme\""));
    }
}
