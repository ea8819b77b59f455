//! What a store keeps about versions and what was done to them, as plain data: everybody who reads a store, asks an
//! engine or shows an answer speaks of the same records.
//!
//! Owns the forms and what a record's hash covers. Reads no store: that is for the registry.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ids::{CapabilityId, Digest};
use super::lifecycle::{Flags, State};
use super::rollback::PostStatus;
use super::submission::{Provenance, Risk};
use super::words::{Word, same_words};

/// Domain tag of a record's hash.
const DOMAIN: &str = "holdpoint/audit/v1";

crate::words! {
    /// What a record of the audit chain is about.
    RecordKind, "kind of record", {
        /// A version entered the registry, with its digests and provenance.
        VersionRegistered = "version-registered",
        /// A version's lifecycle state moved.
        StateSet = "state-set",
        /// A version's flags were replaced as a whole.
        FlagsSet = "flags-set",
        /// A validation's `kappa` values, for lists of versions.
        ScoresSet = "scores-set",
        /// A family's active pointer moved.
        ActiveSet = "active-set",
        /// A family was stopped or re-armed.
        FamilySet = "family-set",
        /// A family's earlier passes were voided.
        FamilyVoided = "family-voided",
        /// The lifecycle model's own view of a family.
        StandingSet = "standing-set",
        /// A piece of evidence, as canonical JSON with its digest.
        EvidencePut = "evidence-put",
        /// People were asked, or a request stands otherwise.
        ApprovalRequested = "approval-requested",
        /// A person's signed decision came in.
        ApprovalPut = "approval-put",
        /// An approval was used by an activation and cannot be used again.
        ApprovalConsumed = "approval-consumed",
        /// An administrator enrolled a person's key: from then on what it signs may count.
        PersonEnrolled = "person-enrolled",
        /// An administrator with a protected key vouched for a person who was enrolled without one.
        PersonConfirmed = "person-confirmed",
        /// An administrator revoked a person's key: from then on nothing that it signed counts.
        PersonRevoked = "person-revoked",
        /// Profile, policy or thresholds changed.
        ContextSet = "context-set",
        /// An administrator let the store be used under a looser profile next: which, who and why.
        ProfileAllowed = "profile-allowed",
        /// A profile that does not come with the program came into force: its texts.
        ProfileLoaded = "profile-loaded",
        /// A batch of telemetry is on disk.
        TelemetrySealed = "telemetry-sealed",
        /// Digests of a block of batches of telemetry.
        TelemetryBlockSealed = "telemetry-block-sealed",
        /// The oldest batches of telemetry go, because of their size together.
        TelemetryPruned = "telemetry-pruned",
        /// Batches of telemetry that were sealed are not there any more, and no record says why.
        TelemetryMissed = "telemetry-missed",
        /// An alarm as it stands after a change.
        AlarmChanged = "alarm-changed",
        /// Kept results came out otherwise when they were run again: none of them counts any more.
        KeptVoided = "kept-voided",
        /// A stage's decision with its reasons and what it was made under.
        Decision = "decision",
        /// An action of the monitor with its reasons.
        Monitor = "monitor",
        /// A person's answer to the monitor's question.
        MonitorAnswer = "monitor-answer",
        /// Profiles were closed to a version, or opened again: by whom and why.
        ProfilesSet = "profiles-set",
        /// A held version was let go on: by whom and why.
        Resumed = "resumed",
        /// One person let a version in by the emergency door: who, why, and until when it has to be reviewed.
        BreakGlass = "break-glass",
        /// What the review of an emergency activation came to, and who reviewed it.
        BreakGlassReviewed = "break-glass-reviewed",
        /// What was shown to people who decided.
        Shown = "shown",
        /// A process asked for a change and was granted it: what, and whose process, as the system has it.
        Asked = "asked",
        /// The machine's clock was set, or is behind the newest record: by how much.
        ClockDoubted = "clock-doubted",
        /// A person confirmed what the machine's clock says: who, why, and the time. Wall times of records may go back here alone.
        ClockConfirmed = "clock-confirmed",
        /// Who reset an alarm, and why it was safe.
        AlarmReset = "alarm-reset",
        /// A drift set in, or ended, in the simulated cell.
        Drift = "drift",
        /// Something in the simulated live world broke, or was mended.
        LiveFault = "live-fault",
        /// The agent of the live cell was given a goal: by whom and why.
        GoalSet = "goal-set",
        /// The simulated live cell works at another pace from then on.
        PaceSet = "pace-set",
        /// A person left a note for those who come after: whose, and what it says.
        ShiftNote = "shift-note",
        /// A person stopped the cell.
        CellStopped = "cell-stopped",
        /// A person let the stopped cell work again.
        CellReleased = "cell-released",
        /// An engine under `real` or `human` begins to work the cell.
        EngineBegan = "engine-began",
        /// The engine that began to work the cell ended: in good order, or, as the next one found, suddenly.
        EngineEnded = "engine-ended",
        /// What is normal for a family was counted, once.
        Commissioned = "commissioned",
        /// What is normal for the cell's senses was measured, once.
        SensesCommissioned = "senses-commissioned",
        /// The record of an upgrade is closed.
        AuditClosed = "audit-closed",
        /// A scene recording was closed with its digest.
        Recording = "recording",
        /// A scene recording's file was removed, with the reason.
        RecordingRemoved = "recording-removed",
        /// A witness was added or removed: a folder elsewhere that gets every checkpoint, and by whom.
        WitnessSet = "witness-set",
        /// The store's tables were made anew from the chain: by whom, why, and which rows had differed.
        StoreRebuilt = "store-rebuilt",
    }
}

impl RecordKind {
    /// Seals of telemetry: of a store that has worked for long, by far the most of its records.
    pub const SEALS: [Self; 2] = [Self::TelemetrySealed, Self::TelemetryBlockSealed];
}

crate::words! {
    /// How an upgrade ended, when its record is closed.
    UpgradeEnd, "end of an upgrade", {
        /// The version is active and no longer provisional.
        Confirmed = "confirmed",
        /// It was refused for good, by a rule or a person.
        Rejected = "rejected",
        /// It was taken off and never runs again.
        RolledBack = "rolled-back",
        /// It was taken off and sent back to evaluation.
        Demoted = "demoted",
        /// Its rollback failed: the family is stopped.
        SafeStopped = "safe-stopped",
    }
}

same_words! { PostStatus => UpgradeEnd: RolledBack, Demoted, SafeStopped }

crate::words! {
    /// Why a family's active pointer moved.
    ActivationCause, "cause of an activation", {
        /// The family's first version.
        Bootstrap = "bootstrap",
        /// A candidate passed the gate and took over.
        Gate = "gate",
        /// The pinned predecessor took over again.
        Restore = "restore",
        /// Nobody is active; the family is stopped.
        Vacate = "vacate",
        /// An operator re-armed a stopped family with an earlier version.
        Rearm = "rearm",
    }
}

crate::words! {
    /// Which versions of the registry a list is about.
    #[derive(Default)]
    VersionGroup, "group of versions", {
        /// Every version, in whatever state.
        #[default]
        All = "all",
        /// The version in control; at most one for each family.
        Active = "active",
        /// On the way: registered, validated, sandboxed, shadowed, demoted.
        Candidate = "candidate",
        /// Done: superseded, rolled back, rejected.
        History = "history",
    }
}

impl VersionGroup {
    /// The lifecycle states of the group's versions.
    #[must_use]
    pub const fn states(self) -> &'static [State] {
        use State as S;
        match self {
            Self::All => &S::ALL,
            Self::Active => &[S::Active],
            Self::Candidate => &[S::Registered, S::Validated, S::Sandboxed, S::Shadowed, S::Demoted],
            Self::History => &[S::Superseded, S::RolledBack, S::Rejected],
        }
    }
}

/// A version as a list shows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VersionSummary {
    /// Name of the version, `family@version`.
    pub version: CapabilityId,
    /// Where it stands in its lifecycle.
    pub state: State,
    /// Counts every change of the version's row; approvals name it.
    pub row_version: u64,
    /// Stage running, pauses, questions, restrictions.
    pub flags: Flags,
    /// kappa I, P, B, R; absent if not measured.
    pub kappas: [Option<f64>; 4],
    /// Whether it was its family's first version, active without a gate.
    pub baseline: bool,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// How it came about.
    pub provenance: Provenance,
    /// The author's estimate of the risk tier.
    pub risk: Risk,
    /// Virtual time of its last change, ms.
    pub changed_ms: u64,
    /// It became active by the emergency door, and people have not reviewed that yet.
    #[serde(default)]
    pub unreviewed: bool,
}

/// One record of the audit chain, hashed together with the record before it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AuditRecord {
    /// 1, 2, 3, ... without gaps.
    pub seq: u64,
    /// Hash of the record before; zeros for the first.
    pub prev: Digest,
    /// SHA-256 over prev, seq, virtual time, kind, subject and body, each with its length, behind a domain tag.
    pub hash: Digest,
    /// Virtual time at which it was written, ms; hashed.
    pub at_ms: u64,
    /// What the record is about; a word of another build is kept as it is.
    pub kind: Word<RecordKind>,
    /// What it is about: `family`, `family@version`, an alarm, or empty.
    pub subject: String,
    /// Its content, JSON text.
    pub body: String,
    /// Wall time, ms since 1970; not hashed.
    pub wall_ms: i64,
}

impl AuditRecord {
    /// The hash that the record's fields must have; a verifier compares it with the stored one.
    #[must_use]
    pub fn expected_hash(&self) -> Digest {
        let kind = match &self.kind {
            Word::Known(kind) => kind.name(),
            Word::Unknown(text) => text,
        };
        let Self { seq, prev, hash, at_ms, subject, body, .. } = self;
        RecordRef { seq: *seq, prev: *prev, hash: *hash, at_ms: *at_ms, kind, subject, body }.expected_hash()
    }
}

/// What is hashed of a record, where it lies: nothing of it is copied.
#[derive(Clone, Copy, Debug)]
pub struct RecordRef<'a> {
    /// 1, 2, 3, ... without gaps.
    pub seq: u64,
    /// Hash of the record before.
    pub prev: Digest,
    /// The hash it bears; not hashed.
    pub hash: Digest,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The word of its kind, also one of another build.
    pub kind: &'a str,
    /// What it is about.
    pub subject: &'a str,
    /// Its content, JSON text.
    pub body: &'a str,
}

impl RecordRef<'_> {
    /// The hash that its fields must have.
    #[must_use]
    pub fn expected_hash(&self) -> Digest {
        Digest::of_parts(
            DOMAIN,
            &[
                self.prev.bytes(),
                &self.seq.to_le_bytes(),
                &self.at_ms.to_le_bytes(),
                self.kind.as_bytes(),
                self.subject.as_bytes(),
                self.body.as_bytes(),
            ],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record of another build keeps its kind, letter by letter: its hash covers it.
    #[test]
    fn a_kind_that_is_not_known_is_kept() {
        let record = |kind: &str| AuditRecord {
            seq: 1,
            prev: Digest::of_parts("t", &[]),
            hash: Digest::of_parts("t", &[]),
            at_ms: 0,
            kind: Word::read(kind.to_owned()),
            subject: String::new(),
            body: "{}".to_owned(),
            wall_ms: 0,
        };
        assert_eq!(record("drift").kind, RecordKind::Drift);
        let later = record("of-a-later-build");
        assert_eq!((later.kind.known(), later.kind.to_string().as_str()), (None, "of-a-later-build"));
        assert_ne!(later.expected_hash(), record("of-an-earlier-build").expected_hash());
        let json = serde_json::to_string(&later).unwrap();
        assert_eq!(serde_json::from_str::<AuditRecord>(&json).unwrap(), later);
    }

    #[test]
    fn every_end_of_a_rollback_ends_an_upgrade_by_the_same_name() {
        for status in PostStatus::ALL {
            assert_eq!(UpgradeEnd::from(status).name(), status.name());
        }
    }

    #[test]
    fn every_state_is_in_one_group() {
        for state in State::ALL {
            let groups = [VersionGroup::Active, VersionGroup::Candidate, VersionGroup::History];
            assert_eq!(groups.iter().filter(|group| group.states().contains(&state)).count(), 1, "{state}");
        }
    }
}
