//! The content of a transaction on the registry: plain data, no I/O.
//!
//! A [`Transaction`] is applied whole or not at all. Every [`Change`] leaves an audit record of its own in the same
//! transaction; the caller's [`AuditBody`] records follow them and say why. Bodies (manifests, evidence, decisions)
//! are opaque JSON text: the store keeps the bytes it was given and chains their digest.

use serde::{Deserialize, Serialize};

use crate::error::StoreError;
use crate::store_terms::{EvidenceKind, RequestState};
use holdpoint_approvals::{
    Nonce, PersonActKind, SignedApproval, SignedPersonAct, SignedProfileAct, SignedWitnessAct,
};
use holdpoint_audit::profile_history::ContextRules;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::lifecycle::VersionFlags;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{ActivationCause, RecordKind};
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::{WallTime, as_ms};

/// The largest JSON text the store takes for one field, bytes.
pub const BODY_BYTES_MAX: usize = 4 << 20;
/// The largest free text (reason, name of a trigger), bytes.
pub const TEXT_BYTES_MAX: usize = 4096;
/// The largest notice, bytes of JSON: it quotes at most a few free texts.
pub const NOTICE_BYTES_MAX: usize = 64 << 10;
/// The most batches of telemetry in one seal record.
pub const BLOCK_BATCHES_MAX: usize = 64;
/// The most runs of missing batches in one record; the last one extends to the end of the gap.
pub const GAPS_MAX: usize = 64;
/// The most quarantined telemetry files in one record.
pub const QUARANTINED_MAX: usize = 64;
pub const CHANGES_MAX: usize = 256;
/// The most records a caller may add to one transaction.
pub const AUDIT_MAX: usize = 256;

/// One all-or-nothing step of the registry.
#[derive(Clone, Debug, Serialize)]
pub struct Transaction {
    /// Names the command. A retry with the same id and content returns the first receipt if records were written, and
    /// runs again otherwise. 1 to 128 bytes.
    pub command_id: String,
    /// Virtual time, ms; must not be before the last record's. Hashed into the chain.
    pub at_ms: u64,
    /// Wall time, ms since 1970, 0 in a script; stored beside the records and not hashed, so that equal runs give equal
    /// chains. The newest is signed with the end of the chain. It never goes back unless a person confirms the time: an
    /// earlier time becomes that of the record before.
    pub wall_ms: i64,
    /// Applied in this order. Put [`Change::ConsumeApproval`] before the [`Change::SetState`] it allows, and the
    /// `SetState` of a leaving active version before that of its successor.
    pub changes: Vec<Change>,
    /// Records that explain the changes.
    pub audit: Vec<AuditBody>,
}

impl Transaction {
    /// Whether the end of the chain is signed at once, so that its removal (with the database's log, for example) is
    /// noticed.
    #[must_use]
    pub fn is_signed_at_once(&self) -> bool {
        let kinds = [
            RecordKind::CellStopped,
            RecordKind::CellReleased,
            RecordKind::EngineBegan,
            RecordKind::ClockDoubted,
        ];
        self.changes.iter().any(|change| matches!(change, Change::SetActive { .. }))
            || self.audit.iter().any(|body| kinds.contains(&body.kind))
    }
}

/// An unpredictable name for a command. A planted row under a known name would swallow or refuse the command, because
/// no record covers the table of commands.
///
/// # Errors
/// If the system has no random numbers.
pub fn command_id(what: &str) -> Result<String, StoreError> {
    let nonce = Nonce::random().map_err(|error| StoreError::invalid("command", what, error))?;
    Ok(format!("{what}-{}", nonce.as_str()))
}

/// A record the caller adds to the audit chain.
#[derive(Clone, Debug, Serialize)]
pub struct AuditBody {
    /// Kind of record; one that the store does not write itself.
    pub kind: RecordKind,
    /// Its subject: `family`, `family@version`, or empty.
    pub subject: String,
    pub body: String,
}

/// The store's answer once a transaction is on disk.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Receipt {
    pub command_id: String,
    /// First audit record written (0 if none was).
    pub first_seq: u64,
    /// Last audit record written (0 if none was).
    pub last_seq: u64,
    /// Digest of the chain's last record.
    pub head: Digest,
    /// Row version of each version whose state was set, in order.
    pub row_versions: Vec<(CapabilityId, u64)>,
}

/// A version to register (paper appendix F, registry entry).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct NewVersion {
    pub id: CapabilityId,
    /// The version it was made from.
    pub parent: Option<CapabilityId>,
    /// Digest of the whole submission; approvals and gates are bound to it.
    pub candidate_digest: Digest,
    /// Digest of the canonical manifest.
    pub manifest_digest: Digest,
    pub bundle_digest: Digest,
    /// Canonical manifest, JSON text.
    pub manifest: String,
    /// Submission (author, provenance, risk, declared traces), JSON text.
    pub submission: String,
    pub author: String,
    /// How it came about.
    pub provenance: Provenance,
    /// Estimated risk as submitted.
    pub risk: Risk,
    /// Permission profile (the manifest's P), JSON text.
    pub permissions: String,
    /// Environment scope (D.environments), JSON text.
    pub environments: String,
    /// Whether this is a family's first version, active without a gate.
    pub baseline: bool,
}

/// Why a family's active pointer moves.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "cause", rename_all = "kebab-case")]
pub enum ActiveCause {
    /// The family's first version; only if it never had one.
    Bootstrap,
    /// A candidate passed the gate.
    Gate {
        /// Digest of the gate evidence, stored for this version at its present row version.
        evidence: Digest,
        /// Distinct people whose approvals must be consumed in this same transaction.
        approvals_needed: u32,
    },
    /// The rollback target is activated.
    Restore,
    /// No version is active; the family must be safe-stopped in the same transaction.
    Vacate,
    /// An operator reactivates a safe-stopped family with a version that was active before.
    Rearm,
}

impl ActiveCause {
    /// The cause by name, without what it rests on.
    #[must_use]
    pub const fn kind(&self) -> ActivationCause {
        match self {
            Self::Bootstrap => ActivationCause::Bootstrap,
            Self::Gate { .. } => ActivationCause::Gate,
            Self::Restore => ActivationCause::Restore,
            Self::Vacate => ActivationCause::Vacate,
            Self::Rearm => ActivationCause::Rearm,
        }
    }
}

/// One change of the registry.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "change", rename_all = "kebab-case")]
pub enum Change {
    /// A new version enters as `registered`, row version 1.
    RegisterVersion(Box<NewVersion>),
    /// The lifecycle state moves as the lifecycle allows; the row version goes up by one. A baseline may go from
    /// registered to active at once. Leaving `active` clears provisional, restricted and rollback-pending; a final
    /// state clears all flags.
    SetState {
        version: CapabilityId,
        /// The row version the decision was made on.
        expected_row_version: u64,
        /// The state the decision was made on.
        from: State,
        to: State,
        reason: NoticeOrText,
    },
    /// Replaces all flags; the row version stays (a pause does not void an approval).
    SetFlags { version: CapabilityId, flags: VersionFlags },
    /// Scores of the last validation, each in 0..=1 or not measured, and the behavior signature.
    SetScores {
        version: CapabilityId,
        /// kappa I, P, B, R.
        kappas: [Option<f64>; 4],
        /// Behavior signature, JSON text.
        signature: Option<String>,
    },
    /// Moves a family's active pointer. Belongs in one transaction with the `SetState`s it goes with.
    SetActive {
        family: Family,
        /// The active version from now on.
        active: Option<CapabilityId>,
        /// The rollback target: a superseded version of the family.
        pinned: Option<CapabilityId>,
        cause: ActiveCause,
        /// Digest of the description of the robot it is made active with, 16 hexadecimal digits; a pointer that
        /// names a robot never moves to another. Absent in records of schema 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        robot: Option<String>,
    },
    /// Stops or reactivates a family.
    SetFamily {
        /// The family; made if it is new.
        family: Family,
        /// Whether it is stopped: then it has no active version.
        safe_stopped: bool,
        reason: NoticeOrText,
    },
    /// Stores the lifecycle model's view of a family, so that it survives a restart.
    SetStanding {
        family: Family,
        /// The model, JSON text.
        json: String,
    },
    /// Voids all of a family's earlier gate passes, approvals and comparative evidence.
    VoidFamily { family: Family, reason: NoticeOrText },
    /// A piece of evidence on a version at its present row version.
    PutEvidence {
        version: CapabilityId,
        kind: EvidenceKind,
        /// The evidence, JSON text.
        json: String,
        /// Its digest as governance names it.
        digest: Digest,
    },
    /// Asks approvers, or changes the state of a request.
    PutApprovalRequest(Box<ApprovalRequest>),
    /// A person's key may decide from now on. Checked: an enrolled administrator signed the act, for the present state
    /// of this store; the first act of a store is its first administrator's own.
    EnrolPerson(Box<SignedPersonAct>),
    /// A verified administrator verifies a person. Checked: the signing key was passphrase-protected, and its owner.
    ConfirmPerson(Box<SignedPersonAct>),
    /// Signatures of a person's key no longer count. Checked likewise; one administrator always stays.
    RevokePerson(Box<SignedPersonAct>),
    /// Stores a signed decision. Checked: its person is enrolled here, in that role, with that key, for this store.
    PutApproval(Box<SignedApproval>),
    /// Consumes an approval: it must be current for its version, profile and policy, unexpired and an `approve`.
    ConsumeApproval {
        nonce: String,
        /// Digest of the present evidence; must be the approved one.
        evidence_digest: Digest,
        /// Time of use; must be before the approval expires. Absent in records of earlier versions, which used virtual
        /// time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at: Option<WallTime>,
    },
    /// The profile, policy or thresholds change; voids everything made under the old ones. Checked: a change that needs
    /// an authorization directly follows its [`Change::AllowProfile`].
    SetContext {
        profile: ProfileName,
        /// Digest of profile, policy set and thresholds together.
        policy_digest: Digest,
        /// Its content, JSON text.
        json: String,
        /// Its requirements, and which of them are less strict. Records of earlier versions have none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rules: Option<Box<ContextRules>>,
    },
    /// The store may be used under another profile next. Checked: an enrolled administrator signed it over this end of
    /// the chain; the next record uses it up.
    AllowProfile {
        profile: ProfileName,
        /// The requesting system user, JSON text.
        by: String,
        act: Box<SignedProfileAct>,
    },
    /// Batches of telemetry are on disk; their digests enter the chain as one record.
    SealTelemetryBlock {
        /// In the order of their numbers, at most 64.
        batches: Vec<BatchReceipt>,
        /// The starting engine found them; the last one ended before it sealed them.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        found: bool,
    },
    /// The oldest batches are removed because of the size limit, once this is on record.
    PruneTelemetry {
        /// The last removed batch.
        through: u64,
    },
    /// Sealed batches are missing, and no record says why.
    MissTelemetry {
        /// Numbers, first and last, of each run of them.
        gaps: Vec<[u64; 2]>,
        /// Quarantined telemetry files, at most 64.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        aside: Vec<QuarantinedFile>,
    },
    /// One batch of telemetry, as earlier versions sealed it.
    SealTelemetry {
        version: CapabilityId,
        batch: u64,
        /// Its digest, as the telemetry file returned it.
        digest: Digest,
        rows: u64,
    },
    /// A witness folder gets every checkpoint from now on, or no more.
    SetWitness {
        /// Absolute.
        folder: String,
        present: bool,
        /// The requesting system user, JSON text.
        by: String,
        /// The administrator's signature. Required where robots or people are at risk; records of earlier versions have
        /// none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        act: Option<Box<SignedWitnessAct>>,
    },
    /// The present state of an alarm.
    AlarmChange {
        alarm: String,
        subject: String,
        state: AlarmState,
        priority: Priority,
        /// All of it, JSON text.
        json: String,
    },
}

/// A quarantined telemetry file; no engine reads it any more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantinedFile {
    /// Its name in the store's folder.
    pub file: String,
    pub problem: String,
}

/// A stored batch, for [`Change::SealTelemetryBlock`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BatchReceipt {
    pub version: CapabilityId,
    pub batch: u64,
    /// Digest of all its fields.
    pub digest: Digest,
    pub rows: u64,
}

impl Change {
    /// The change for an act about a person.
    #[must_use]
    pub fn about_person(signed: SignedPersonAct) -> Self {
        let kind = signed.act().act;
        let signed = Box::new(signed);
        match kind {
            PersonActKind::Enrol => Self::EnrolPerson(signed),
            PersonActKind::Confirm => Self::ConfirmPerson(signed),
            PersonActKind::Revoke => Self::RevokePerson(signed),
        }
    }

    /// Whether it admits a version or advances it. Stops, rollbacks and notes do not.
    #[must_use]
    pub const fn admits(&self) -> bool {
        match self {
            Self::RegisterVersion(_)
            | Self::EnrolPerson(_)
            | Self::ConfirmPerson(_)
            | Self::PutApproval(_)
            | Self::ConsumeApproval { .. }
            | Self::SetContext { .. }
            | Self::AllowProfile { .. }
            | Self::SetWitness { .. } => true,
            Self::SetState { from, to, .. } => match to {
                State::Registered | State::Validated | State::Sandboxed | State::Shadowed => true,
                // The rollback target is activated.
                State::Active => !matches!(from, State::Superseded),
                State::Superseded | State::Demoted | State::RolledBack | State::Rejected => false,
            },
            Self::SetActive { cause, .. } => match cause {
                ActiveCause::Bootstrap | ActiveCause::Gate { .. } | ActiveCause::Rearm => true,
                ActiveCause::Restore | ActiveCause::Vacate => false,
            },
            Self::RevokePerson(_)
            | Self::SetFlags { .. }
            | Self::SetScores { .. }
            | Self::SetFamily { .. }
            | Self::SetStanding { .. }
            | Self::VoidFamily { .. }
            | Self::PutEvidence { .. }
            | Self::PutApprovalRequest(_)
            | Self::SealTelemetry { .. }
            | Self::SealTelemetryBlock { .. }
            | Self::PruneTelemetry { .. }
            | Self::MissTelemetry { .. }
            | Self::AlarmChange { .. } => false,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ApprovalRequest {
    /// Its id, a name.
    pub id: String,
    pub version: CapabilityId,
    pub row_version: u64,
    pub evidence_digest: Digest,
    pub policy_digest: Digest,
    pub profile: ProfileName,
    /// The required number of distinct approvers.
    pub needed: u32,
    /// When it expires, also while no engine runs.
    #[serde(rename = "deadline_ms", with = "as_ms")]
    pub until: WallTime,
    pub state: RequestState,
    /// The text shown to approvers, JSON text.
    pub json: String,
}
