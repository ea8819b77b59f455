//! The results of the views, and their filters: plain data.

use std::collections::BTreeSet;

use crate::store_terms::EvidenceKind;
use holdpoint_approvals::SignedApproval;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::record::{ActivationCause, RecordKind, VersionGroup, VersionSummary};

/// The most rows one call returns.
pub const PAGE_ROWS_MAX: usize = 10_000;

#[derive(Clone, Debug, Default)]
pub struct VersionFilter {
    pub group: VersionGroup,
    pub family: Option<String>,
    pub state: Option<State>,
    /// Whose name contains this text.
    pub text: Option<String>,
    /// How many to skip.
    pub offset: usize,
    /// How many at most; 0 for [`PAGE_ROWS_MAX`].
    pub limit: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EvidenceEntry {
    /// The record that brought it.
    pub seq: u64,
    pub kind: EvidenceKind,
    pub row_version: u64,
    /// Profile it was made under.
    pub profile: ProfileName,
    /// Policy it was made under.
    pub policy_digest: Digest,
    pub digest: Digest,
    /// The evidence, JSON text.
    pub json: String,
    /// Virtual time of the record, ms.
    pub at_ms: u64,
    /// Whether it is still valid (not voided by family, profile, policy or thresholds).
    pub current: bool,
}

/// One move of a family's active pointer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActivationEntry {
    pub seq: u64,
    pub active: Option<CapabilityId>,
    /// The rollback target from then on.
    pub pinned: Option<CapabilityId>,
    pub cause: ActivationCause,
    /// The gate record it rests on.
    pub gate_digest: Option<Digest>,
    /// Virtual time of the record, ms.
    pub at_ms: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ApprovalEntry {
    pub signed: SignedApproval,
    /// The record that used it.
    pub consumed_seq: Option<u64>,
    /// Virtual time it came, ms.
    pub at_ms: u64,
    /// Wall time it came, ms since 1970; absent in a script.
    pub wall_ms: Option<i64>,
}

/// A version in full: the registry entry of the paper's appendix F.
#[derive(Clone, Debug, PartialEq)]
pub struct VersionDetail {
    /// As in a list.
    pub summary: VersionSummary,
    /// The version it was made from.
    pub parent: Option<CapabilityId>,
    /// Digest of everything submitted.
    pub candidate_digest: Digest,
    /// Digest of what runs.
    pub manifest_digest: Digest,
    /// Digest of what runs.
    pub bundle_digest: Digest,
    /// Canonical manifest, JSON text.
    pub manifest: String,
    /// The author's submission, JSON text.
    pub submission: String,
    /// Permission profile, JSON text.
    pub permissions: String,
    /// Environment scope, JSON text.
    pub environments: String,
    /// Behavior signature, JSON text.
    pub signature: Option<String>,
    /// Virtual time of registration, ms.
    pub registered_ms: u64,
    /// Compatibility, sandbox, shadow, gate, activation, monitor, rollback and drill evidence, as `RecordViews::evidence`.
    pub evidence: Vec<EvidenceEntry>,
    /// When it became active or the rollback target, oldest first.
    pub activations: Vec<ActivationEntry>,
    /// Decisions about it, as `RecordViews::approvals`.
    pub approvals: Vec<ApprovalEntry>,
    /// Numbers of all audit records about it, oldest first.
    pub audit_links: Vec<u64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct FamilyStatus {
    pub name: String,
    pub active: Option<CapabilityId>,
    pub pinned: Option<CapabilityId>,
    /// Whether it ever had an active version.
    pub bootstrapped: bool,
    pub safe_stopped: bool,
    /// Why it is, or was last.
    pub reason: NoticeOrText,
    /// The lifecycle model's own view of it, JSON text.
    pub state_json: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AlarmEntry {
    pub alarm: String,
    pub subject: String,
    pub state: AlarmState,
    pub priority: Priority,
    /// All of it, JSON text.
    pub json: String,
    /// Virtual time of the last change, ms.
    pub changed_ms: u64,
}

/// Which audit records to list.
#[derive(Clone, Debug, Default)]
pub struct AuditFilter {
    /// From this record on.
    pub from_seq: u64,
    pub before_seq: Option<u64>,
    pub kind: Option<RecordKind>,
    /// Of none of these kinds.
    pub without: BTreeSet<RecordKind>,
    /// About exactly this subject only.
    pub subject: Option<String>,
    /// How many at most; 0 for [`PAGE_ROWS_MAX`].
    pub limit: usize,
    pub newest_first: bool,
}

impl AuditFilter {
    /// The newest record of a kind.
    #[must_use]
    pub fn newest(kind: RecordKind) -> Self {
        Self { kind: Some(kind), limit: 1, newest_first: true, ..Self::default() }
    }
}

/// The history of a version's state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VersionHistory {
    /// The state it was in before.
    pub left: Option<State>,
    /// The stage that ran when it left that state.
    pub ran: Option<Stage>,
    /// Whether it ever passed its provisional window.
    pub confirmed: bool,
    /// The context in which the gate last activated it; absent if it never did.
    pub activated_under: Option<AdmissionContext>,
}

/// When a record was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordTime {
    pub seq: u64,
    /// Virtual time, ms; never before that of an earlier record.
    pub at_ms: u64,
    /// Wall time, ms since 1970, by the machine's clock as it was set then; absent in scripts.
    pub wall_ms: Option<i64>,
}
