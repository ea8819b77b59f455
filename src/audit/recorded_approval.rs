//! The form in which a record holds a person's decision. The decision itself, with its signature, is beside the record.

use holdpoint_approvals::{Approval, Nonce};
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use serde::{Deserialize, Serialize};

/// An approval in its record's form; its signature is in its row.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedApproval {
    /// `put-approval`.
    pub change: String,
    /// The approver.
    pub who: String,
    pub role: Role,
    pub decision: ApprovalDecision,
    pub reason: String,
    /// The row version decided on.
    pub row_version: u64,
    pub evidence_digest: Digest,
    pub policy_digest: Digest,
    pub profile: ProfileName,
    /// Wall time from which it counts no more, ms since 1970.
    pub not_after_ms: u64,
    /// Names the decision; no second one has it.
    pub nonce: Nonce,
    /// The signed data without the store's key: equal in equal runs. Earlier versions signed none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    shown: Option<DisplayDigests>,
}

/// The signed data of a decision, in its record's form.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct DisplayDigests {
    renderer: u32,
    lines: Digest,
    facts: Digest,
    request: Nonce,
}

impl RecordedApproval {
    /// The form of a decision.
    #[must_use]
    pub fn of(approval: &Approval) -> Self {
        Self {
            change: "put-approval".to_owned(),
            who: approval.who.clone(),
            role: approval.role,
            decision: approval.decision,
            reason: approval.reason.clone(),
            row_version: approval.row_version,
            evidence_digest: approval.evidence_digest,
            policy_digest: approval.policy_digest,
            profile: approval.profile,
            not_after_ms: approval.not_after_ms,
            nonce: approval.nonce.clone(),
            shown: approval.shown.as_ref().map(|shown| DisplayDigests {
                renderer: shown.renderer,
                lines: shown.lines,
                facts: shown.facts,
                request: shown.request.clone(),
            }),
        }
    }
}
