//! What a transaction on the registry is made of: plain data, no I/O.
//!
//! A [`Transaction`] is applied whole or not at all. Every [`Change`] leaves an audit record of its own in the same
//! transaction; the caller's [`AuditBody`] records follow them and say why. Bodies (manifests, evidence, decisions)
//! are opaque JSON text: the store keeps the bytes it was given and chains their digest.

use serde::{Deserialize, Serialize};

use super::error::StoreError;
use super::loosened::ContextRules;
use super::names::{EvidenceKind, RequestState};
use holdpoint_approvals::{
    Nonce, PersonActKind, SignedApproval, SignedPersonAct, SignedProfileAct, SignedWitnessAct,
};
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::Flags;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{ActivationCause, RecordKind};
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::wall_time::{WallTime, as_ms};

/// The largest JSON text the store takes for one field, bytes.
pub const BODY_BYTES_MAX: usize = 4 << 20;
/// The largest free text (reason, name of a trigger), bytes.
pub const TEXT_BYTES_MAX: usize = 4096;
/// The most batches of telemetry that one record seals.
pub const BLOCK_BATCHES_MAX: usize = 64;
/// The most runs of missing batches that one record tells; the last one reaches to the end of what is missing.
pub const GAPS_MAX: usize = 64;
/// Telemetry files that were put aside in one record at most.
pub(crate) const ASIDE_MAX: usize = 64;
/// The most changes in one transaction.
pub const CHANGES_MAX: usize = 256;
/// The most records a caller may add to one transaction.
pub const AUDIT_MAX: usize = 256;

/// One all-or-nothing step of the registry.
#[derive(Clone, Debug, Serialize)]
pub struct Transaction {
    /// Names the command: a retry with the same id and content returns the first receipt, if records were written, and is
    /// done again otherwise. 1 to 128 bytes.
    pub command_id: String,
    /// Virtual time, ms; must not be before the last record's. Hashed into the chain.
    pub at_ms: u64,
    /// Wall time, ms since 1970, 0 in a script; kept beside the records and not hashed, so that equal runs give equal
    /// chains. The newest is signed with the end of the chain. It never goes back, but where a person confirms the time: an
    /// earlier one is kept as that of the record before.
    pub wall_ms: i64,
    /// Applied in this order. Put [`Change::ConsumeApproval`] before the [`Change::SetState`] it allows, and the
    /// `SetState` of a leaving active version before that of its successor.
    pub changes: Vec<Change>,
    /// Records that explain the changes.
    pub audit: Vec<AuditBody>,
}

impl Transaction {
    /// Whether the end of the chain is signed right after it: who takes that end away then does not do so unseen, by removing
    /// the database's log for one.
    pub(crate) fn is_signed_at_once(&self) -> bool {
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

/// A name for a command that nobody can foretell. A row under a name that is known before would swallow or refuse the
/// command: what lies in the table of commands is in no record.
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
    /// What it is about: `family`, `family@version`, or empty.
    pub subject: String,
    pub body: String,
}

/// What the store answers once a transaction is on disk.
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
    /// Digest of everything submitted; what approvals and gates bind to.
    pub candidate_digest: Digest,
    /// Digest of the canonical manifest.
    pub manifest_digest: Digest,
    /// Digest of what runs.
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
    /// The pinned predecessor takes over again.
    Restore,
    /// Nobody is active; the family must be safe-stopped in the same transaction.
    Vacate,
    /// An operator re-arms a safe-stopped family with a version that was active before.
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
        /// Why, in a sentence.
        reason: String,
    },
    /// Replaces all flags; the row version stays (a pause does not void an approval).
    SetFlags { version: CapabilityId, flags: Flags },
    /// Scores of the last validation, each in 0..=1 or not measured, and the behavioural signature.
    SetScores {
        version: CapabilityId,
        /// kappa I, P, B, R.
        kappas: [Option<f64>; 4],
        /// Behavioural signature, JSON text.
        signature: Option<String>,
    },
    /// Moves a family's active pointer. Belongs in one transaction with the `SetState`s it goes with.
    SetActive {
        family: Family,
        /// Who is active from now on.
        active: Option<CapabilityId>,
        /// The rollback target: a superseded version of the family.
        pinned: Option<CapabilityId>,
        cause: ActiveCause,
        /// Digest of the description of the robot it is made active with, 16 hexadecimal digits; a pointer that
        /// names a robot never moves to another. Absent in records of schema 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        robot: Option<String>,
    },
    /// Stops a family safely or re-arms it.
    SetFamily {
        /// The family; made if it is new.
        family: Family,
        /// Whether it is stopped: then it has no active version.
        safe_stopped: bool,
        /// Why, in a sentence.
        reason: String,
    },
    /// Keeps the lifecycle model's own view of a family, so that it can go on from there after a restart.
    SetStanding {
        family: Family,
        /// The model, JSON text.
        json: String,
    },
    /// Voids all of a family's earlier gate passes, approvals and comparative evidence.
    VoidFamily {
        family: Family,
        /// Why, in a sentence.
        reason: String,
    },
    /// A piece of evidence on a version at its present row version.
    PutEvidence {
        version: CapabilityId,
        /// What it is about.
        kind: EvidenceKind,
        /// The evidence, JSON text.
        json: String,
        /// Its digest as governance names it.
        digest: Digest,
    },
    /// Asks people for approval, or changes how a request stands.
    PutApprovalRequest(Box<ApprovalRequest>),
    /// A person's key may decide from now on. Checked: that an administrator who is enrolled signed the act, for this
    /// store as it stands; the first act of a store is its first administrator's own.
    EnrolPerson(Box<SignedPersonAct>),
    /// A confirmed administrator vouches for a person. Checked: that the key that signed was guarded, and whose it is.
    ConfirmPerson(Box<SignedPersonAct>),
    /// Nothing that a person's key signed counts any more. Checked likewise; one administrator always stays.
    RevokePerson(Box<SignedPersonAct>),
    /// Keeps a signed decision. Checked: that who made it is enrolled here, in that role, with that key, for this store.
    PutApproval(Box<SignedApproval>),
    /// Uses an approval, once: it must be current for its version, profile and policy, unexpired and an `approve`.
    ConsumeApproval {
        nonce: String,
        /// Digest of the evidence as it stands now; must be what was approved.
        evidence_digest: Digest,
        /// When it is used; must be before it is void. Absent in records of earlier versions, which counted in the engine's
        /// time.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at: Option<WallTime>,
    },
    /// The profile, policy or thresholds change; voids everything made under the old ones. Checked: that a change that
    /// takes an authorization follows an [`Change::AllowProfile`] of it at once.
    SetContext {
        profile: ProfileName,
        /// Digest of profile, policy set and thresholds together.
        policy_digest: Digest,
        /// What it consists of, JSON text.
        json: String,
        /// What it demands, and what of that is looser. Records of earlier versions have none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        rules: Option<Box<ContextRules>>,
    },
    /// The store may be used under another profile next. Checked: that an administrator who is enrolled signed it over this
    /// end of the chain; it is used up by whatever is on record next.
    AllowProfile {
        profile: ProfileName,
        /// Who asked for it, as the system says, JSON text.
        by: String,
        act: Box<SignedProfileAct>,
    },
    /// Batches of telemetry are on disk; their digests enter the chain as one record.
    SealTelemetryBlock {
        /// In the order of their numbers, at most 64.
        batches: Vec<BatchReceipt>,
        /// They lay there when an engine came up, and nobody had sealed them before the last one ended.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        found: bool,
    },
    /// The oldest batches go, because all together take too much room. They are removed once this is on record.
    PruneTelemetry {
        /// The last one that goes.
        through: u64,
    },
    /// Sealed batches are not there any more, and no record says why.
    MissTelemetry {
        /// Numbers, first and last, of each run of them.
        gaps: Vec<[u64; 2]>,
        /// Telemetry files that were put aside and are kept, at most 64.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        aside: Vec<SetAside>,
    },
    /// One batch of telemetry, as earlier versions of the program sealed it.
    SealTelemetry {
        /// The version it is about.
        version: CapabilityId,
        batch: u64,
        /// Its digest, as the telemetry file returned it.
        digest: Digest,
        rows: u64,
    },
    /// A folder elsewhere gets every checkpoint from now on, or no more.
    SetWitness {
        /// Absolute.
        folder: String,
        present: bool,
        /// Who asked for it, as the system says, JSON text.
        by: String,
        /// The administrator who answers for it. Where robots or people are at risk there has to be one; records of
        /// earlier versions have none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        act: Option<Box<SignedWitnessAct>>,
    },
    /// An alarm as it now stands.
    AlarmChange {
        alarm: String,
        /// What it is about.
        subject: String,
        state: AlarmState,
        priority: Priority,
        /// All of it, JSON text.
        json: String,
    },
}

/// A telemetry file that no engine reads any more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetAside {
    /// Its name in the store's folder.
    pub file: String,
    /// Why it was put aside.
    pub problem: String,
}

/// A batch as it is kept; what [`Change::SealTelemetryBlock`] takes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BatchReceipt {
    /// The version it is about.
    pub version: CapabilityId,
    pub batch: u64,
    /// Digest of all its fields.
    pub digest: Digest,
    pub rows: u64,
}

impl Change {
    /// The change that an act about a person is.
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

    /// Whether it lets something in or takes it further. What stops, takes off and writes down does not.
    pub(crate) const fn lets_in(&self) -> bool {
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
                // The predecessor takes over again.
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

/// A request for approval, as stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ApprovalRequest {
    /// Its id, a name.
    pub id: String,
    /// What is to be approved.
    pub version: CapabilityId,
    /// At which row version.
    pub row_version: u64,
    pub evidence_digest: Digest,
    pub policy_digest: Digest,
    pub profile: ProfileName,
    /// How many distinct people.
    pub needed: u32,
    /// When it lapses, also while no engine runs.
    #[serde(rename = "deadline_ms", with = "as_ms")]
    pub until: WallTime,
    pub state: RequestState,
    /// What was shown to the people asked, JSON text.
    pub json: String,
}
