//! The digests of the displayed request that a decision signs, and the facts that every verifier reads.
//!
//! The engine makes the lines and the facts behind them. The signer hashes the text that arrived, never digests sent
//! along. If the text was altered on its way, the engine refuses the signature.

use serde::{Deserialize, Serialize};

use super::signed_approval::{Approval, ApprovalError, Nonce};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::profile::ProfileName;

const LINES_DOMAIN: &str = "holdpoint/question-lines/v1";
const FACTS_DOMAIN: &str = "holdpoint/question-facts/v1";

/// What a decision states of the displayed request; signed with it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DisplayBinding {
    /// Version of the renderer that made the lines of the facts.
    pub renderer: u32,
    /// Digest of the lines, each with its length ([`lines_digest`]).
    pub lines: Digest,
    /// Digest of the text of the facts ([`facts_digest`]).
    pub facts: Digest,
    /// The public key of the requesting store, 64 hexadecimal digits.
    pub store_key: String,
    /// Nonce of the call that fetched the approval request.
    pub request: Nonce,
}

pub fn lines_digest(lines: &[String]) -> Digest {
    let parts: Vec<&[u8]> = lines.iter().map(String::as_bytes).collect();
    Digest::of_parts(LINES_DOMAIN, &parts)
}

/// The digest of the facts behind the lines, over their JSON text.
#[must_use]
pub fn facts_digest(text: &str) -> Digest {
    Digest::of_parts(FACTS_DOMAIN, &[text.as_bytes()])
}

/// The person an approval request was rendered for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignerName {
    pub name: String,
    pub role: Role,
}

/// The facts of an approval request that a decision repeats and that are compared with the record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignedFacts {
    pub asked: SignerName,
    /// Id of the approval request.
    pub question: String,
    pub purpose: String,
    pub version: CapabilityId,
    pub candidate: Digest,
    pub row_version: u64,
    pub evidence: Digest,
    pub policy: Digest,
    pub profile: ProfileName,
    /// The quorum.
    pub needed: u32,
}

/// The purpose of a request that one person answers alone.
const EMERGENCY: &str = "emergency";

impl SignedFacts {
    /// Reads them from the text of all facts.
    ///
    /// # Errors
    /// [`ApprovalError::NoForm`].
    pub fn read(text: &str) -> Result<Self, ApprovalError> {
        serde_json::from_str(text)
            .map_err(|error| ApprovalError::NoForm(format!("the question's facts: {error}")))
    }

    /// Whether the request is for break-glass by one person.
    #[must_use]
    pub fn is_emergency(&self) -> bool {
        self.purpose == EMERGENCY
    }

    /// Whether a decision repeats these facts.
    ///
    /// # Errors
    /// The facts that it does not repeat.
    pub fn agree(&self, approval: &Approval) -> Result<(), &'static str> {
        let same = [
            (self.asked.name == approval.who, "who is asked"),
            (self.asked.role == approval.role, "the role"),
            (self.version == approval.version, "the version"),
            (self.candidate == approval.candidate_digest, "the candidate"),
            (self.row_version == approval.row_version, "the row version"),
            (self.evidence == approval.evidence_digest, "the evidence"),
            (self.policy == approval.policy_digest, "the policy"),
            (self.profile == approval.profile, "the profile"),
            (self.is_emergency() == approval.break_glass, "the purpose"),
        ];
        same.into_iter().find(|(same, _)| !same).map_or(Ok(()), |(_, what)| Err(what))
    }
}
