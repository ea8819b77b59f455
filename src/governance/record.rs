//! What a store records about versions and acts on them, as plain data: stores, engines and screens share these
//! records.
//!
//! Owns the forms and the hashed content of a record. Reads no store: the registry does.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::closed_set::{Lenient, convert_equal_terms};
use super::ids::{CapabilityId, Digest};
use super::lifecycle::{State, VersionFlags};
use super::rollback::PostStatus;
use super::submission::{Provenance, Risk};
use super::wall_time::WallTime;

/// Domain tag of a record's hash.
const DOMAIN: &str = "holdpoint/audit/v1";

/// What a replay of the chain does with the records of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayClass {
    /// A change of the store's tables: it is applied again. Only the store writes such a record.
    Change,
    /// A note of the engine: it changes no table.
    Note,
}

/// What the records of a kind are about, for lists of some of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordGroup {
    /// Changes, without the bookkeeping that comes with each.
    Events,
    /// Requests to people and their actions.
    People,
    /// What calls a person.
    Alarms,
    /// The store itself: context, recordings, witnesses, pruned telemetry. Without seals, which would crowd out the
    /// rest.
    Store,
    /// Those that an engine also publishes as an event when it writes them: no other event says so.
    Published,
}

/// Makes the kinds of records: documentation, name, replay class and groups of each.
macro_rules! record_kinds {
    ($($(#[$doc:meta])* $kind:ident = $name:literal: $replay:ident, [$($group:ident),*];)+) => {
        crate::closed_set! {
            /// The kind of a record in the audit chain.
            RecordKind, "kind of record", { $($(#[$doc])* $kind = $name),+ }
        }

        impl RecordKind {
            /// What a replay of the chain does with its records.
            #[must_use]
            pub const fn replay_class(self) -> ReplayClass {
                match self { $(Self::$kind => ReplayClass::$replay),+ }
            }

            /// The groups of its records; bookkeeping may be in none.
            #[must_use]
            pub const fn groups(self) -> &'static [RecordGroup] {
                match self { $(Self::$kind => &[$(RecordGroup::$group),*]),+ }
            }
        }
    };
}

record_kinds! {
    /// A version entered the registry, with its digests and provenance.
    VersionRegistered = "version-registered": Change, [Events];
    /// A version's lifecycle state moved.
    StateSet = "state-set": Change, [Events];
    /// A version's flags were replaced as a whole.
    FlagsSet = "flags-set": Change, [];
    /// A validation's `kappa` values, for lists of versions.
    ScoresSet = "scores-set": Change, [];
    /// A family's active pointer moved.
    ActiveSet = "active-set": Change, [Events];
    /// A family was safe-stopped or reactivated.
    FamilySet = "family-set": Change, [Events];
    /// A family's earlier passes were voided.
    FamilyVoided = "family-voided": Change, [Events];
    /// The lifecycle model's own view of a family.
    StandingSet = "standing-set": Change, [];
    /// A piece of evidence, as canonical JSON with its digest.
    EvidencePut = "evidence-put": Change, [];
    /// An approval request was made, or its state changed.
    ApprovalRequested = "approval-requested": Change, [Events, People];
    /// A person's signed decision came in.
    ApprovalPut = "approval-put": Change, [Events, People];
    /// An approval was used by an activation and cannot be used again.
    ApprovalConsumed = "approval-consumed": Change, [People];
    /// An administrator enrolled a person's key: its later signatures may count.
    PersonEnrolled = "person-enrolled": Change, [Events, People];
    /// An administrator with a passphrase-protected key attested a person who was enrolled without one.
    PersonConfirmed = "person-confirmed": Change, [Events, People];
    /// An administrator revoked a person's key: from then on nothing that it signed counts.
    PersonRevoked = "person-revoked": Change, [Events, People];
    /// Profile, policy or thresholds changed.
    ContextSet = "context-set": Change, [Events, Store];
    /// An administrator authorized the next use of the store under a less strict profile: which, who and why.
    ProfileAllowed = "profile-allowed": Change, [Events, People, Store];
    /// A profile that does not come with the program came into force: its texts.
    ProfileLoaded = "profile-loaded": Note, [Events, Store];
    /// A batch of telemetry is on disk.
    TelemetrySealed = "telemetry-sealed": Change, [];
    /// Digests of a block of batches of telemetry.
    TelemetryBlockSealed = "telemetry-block-sealed": Change, [];
    /// The oldest batches of telemetry go, because of their size together.
    TelemetryPruned = "telemetry-pruned": Change, [Events, Store];
    /// Digested batches of telemetry are missing, and no record says why.
    TelemetryMissed = "telemetry-missed": Change, [Events, Store];
    /// An alarm after a change.
    AlarmChanged = "alarm-changed": Change, [Events, Alarms];
    /// Cached results differed from their re-run: none of them counts any more.
    KeptVoided = "kept-voided": Note, [Events, Store];
    /// A stage's decision with its reasons and context.
    Decision = "decision": Note, [Events];
    /// An action of the monitor with its reasons.
    Monitor = "monitor": Note, [Events];
    /// A person's answer to an escalation.
    MonitorAnswer = "monitor-answer": Note, [Events, People];
    /// A version was blocked under profiles, or unblocked: by whom and why.
    ProfilesSet = "profiles-set": Note, [Events, People];
    /// A person made a version its family's anchor: who and why.
    AnchorSet = "anchor-set": Note, [Events, People];
    /// A secret key for seeds was drawn: what it is for, and the commitment to it.
    KeyCommitted = "key-committed": Note, [Events];
    /// A key for seeds is revealed, because nothing runs under it any more.
    KeyRevealed = "key-revealed": Note, [Events];
    /// The sandbox of a version began its pairs: which try of its author and its family that is, and its terms.
    TryCounted = "try-counted": Note, [Events];
    /// A person reviewed the tries of a family, whose count begins again: who and why.
    TriesReviewed = "tries-reviewed": Note, [Events, People];
    /// A person paused a version, or resumed a paused one: who and why.
    PauseSet = "pause-set": Note, [Events, People];
    /// A rollback that a person decided began: what they decided, and how the version leaves.
    RollbackRequested = "rollback-requested": Note, [Events, People];
    /// A version on hold was resumed: by whom and why.
    Resumed = "resumed": Note, [Events, People];
    /// One person activated a version by break-glass: who, why, and the deadline of the review.
    BreakGlass = "break-glass": Note, [Events, People];
    /// The result of a break-glass review, and the reviewers.
    BreakGlassReviewed = "break-glass-reviewed": Note, [Events, People];
    /// The request as displayed to approvers.
    Shown = "shown": Note, [People];
    /// A granted request of a process: the change, and the process as the operating system reports it.
    Asked = "asked": Note, [Events, People];
    /// The machine's clock was set, or is behind the newest record: by how much.
    ClockDoubted = "clock-doubted": Note, [Events];
    /// A person confirmed the time of the machine's clock: who, why, and the time. Only here may recorded wall times go back.
    ClockConfirmed = "clock-confirmed": Note, [Events, People, Published];
    /// Who reset an alarm, and why it was safe.
    AlarmReset = "alarm-reset": Note, [Events, People, Alarms];
    /// A drift set in, or ended, in the live cell.
    Drift = "drift": Note, [Events];
    /// Something in the live cell broke or was repaired.
    LiveFault = "live-fault": Note, [Events];
    /// A person set a goal of the live cell's agent: who and why.
    GoalSet = "goal-set": Note, [Events, People];
    /// The live cell has another pace from then on.
    PaceSet = "pace-set": Note, [Events, People];
    /// A person left a note for the next shift: whose, and its text.
    ShiftNote = "shift-note": Note, [Events, People];
    /// A person stopped the cell.
    CellStopped = "cell-stopped": Note, [Events, People];
    /// A person started the stopped cell again.
    CellReleased = "cell-released": Note, [Events, People];
    /// An engine under `real` or `human` begins to run the cell.
    EngineBegan = "engine-began": Note, [Events, Store];
    /// The engine that ran the cell ended: cleanly, or suddenly, as the next one found.
    EngineEnded = "engine-ended": Note, [Events, Store];
    /// The normal rates of a family were counted, once.
    Commissioned = "commissioned": Note, [Events];
    /// The harm of a version's live tasks so far: after each task past a limit, and from time to time without one.
    LiveHarm = "live-harm": Note, [Events];
    /// What is normal for the camera check was measured, once.
    SensesCommissioned = "senses-commissioned": Note, [Events];
    /// The record of an upgrade is closed.
    AuditClosed = "audit-closed": Note, [Events];
    /// A scene recording was closed with its digest.
    Recording = "recording": Note, [Events, Store];
    /// A scene recording's file was removed, with the reason.
    RecordingRemoved = "recording-removed": Note, [Events, Store];
    /// A witness was added or removed: which, and by whom.
    WitnessSet = "witness-set": Change, [Events, People, Store];
    /// The store's tables were rebuilt from the chain: by whom, why, and which rows had differed.
    StoreRebuilt = "store-rebuilt": Change, [Events, People, Store];
}

impl RecordKind {
    /// Telemetry digests: by far the most records of a long-running store.
    pub const SEALS: [Self; 2] = [Self::TelemetrySealed, Self::TelemetryBlockSealed];
}

crate::closed_set! {
    /// The end of an upgrade, when its record is closed.
    UpgradeEnd, "end of an upgrade", {
        /// The version is active and no longer provisional.
        Confirmed = "confirmed",
        /// It was rejected by a rule or a person.
        Rejected = "rejected",
        /// It was rolled back and never runs again.
        RolledBack = "rolled-back",
        /// It was rolled back and returned to evaluation.
        Demoted = "demoted",
        /// Its rollback failed: the family is stopped.
        SafeStopped = "safe-stopped",
    }
}

convert_equal_terms! { PostStatus => UpgradeEnd: RolledBack, Demoted, SafeStopped }

crate::closed_set! {
    /// Why a family's active pointer moved.
    ActivationCause, "cause of an activation", {
        /// The family's first version.
        Bootstrap = "bootstrap",
        /// A candidate passed the gate and took over.
        Gate = "gate",
        /// The rollback target became active again.
        Restore = "restore",
        /// No version is active; the family is stopped.
        Vacate = "vacate",
        /// An operator reactivated an earlier version of a stopped family.
        Rearm = "rearm",
    }
}

crate::closed_set! {
    /// The versions in a list of the registry.
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
    /// Its lifecycle state.
    pub state: State,
    /// Counts every change of the version's row; approvals name it.
    pub row_version: u64,
    /// Running stage, pauses, approval requests, restrictions.
    pub flags: VersionFlags,
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
    /// When that was by the machine's clock; absent in scripts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changed_at: Option<WallTime>,
    /// It became active by break-glass and is not reviewed yet.
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
    pub kind: Lenient<RecordKind>,
    /// Its subject: `family`, `family@version`, an alarm, or empty.
    pub subject: String,
    /// Its content, JSON text.
    pub body: String,
    /// Wall time, ms since 1970; not hashed.
    pub wall_ms: i64,
}

impl AuditRecord {
    /// The wall time at which it was written; absent in scripts.
    #[must_use]
    pub fn wall(&self) -> Option<WallTime> {
        (self.wall_ms > 0).then(|| WallTime::from_ms(self.wall_ms))
    }

    /// The hash that the record's fields must have; a verifier compares it with the stored one.
    #[must_use]
    pub fn expected_hash(&self) -> Digest {
        self.hashed().expected_hash()
    }

    /// The hashed content.
    #[must_use]
    pub fn hashed(&self) -> RecordRef<'_> {
        let kind = match &self.kind {
            Lenient::Known(kind) => kind.name(),
            Lenient::Unknown(text) => text,
        };
        let Self { seq, prev, hash, at_ms, subject, body, .. } = self;
        RecordRef { seq: *seq, prev: *prev, hash: *hash, at_ms: *at_ms, kind, subject, body }
    }
}

/// The hashed content of a record, borrowed without copies.
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
    /// Its subject.
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

    /// A record of another build preserves its kind letter by letter: its hash covers it.
    #[test]
    fn an_unknown_kind_is_preserved() {
        let record = |kind: &str| AuditRecord {
            seq: 1,
            prev: Digest::of_parts("t", &[]),
            hash: Digest::of_parts("t", &[]),
            at_ms: 0,
            kind: Lenient::read(kind.to_owned()),
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
    fn only_bookkeeping_is_in_no_group() {
        use RecordKind as K;
        let hidden: Vec<K> = K::ALL.into_iter().filter(|kind| kind.groups().is_empty()).collect();
        let bookkeeping = [K::FlagsSet, K::ScoresSet, K::StandingSet, K::EvidencePut];
        assert_eq!(hidden, [&bookkeeping[..], &K::SEALS[..]].concat());
        assert!(hidden.iter().all(|kind| kind.replay_class() == ReplayClass::Change), "{hidden:?}");
    }

    /// The engine publishes what it notes itself; a change has an event of its own.
    #[test]
    fn only_notes_are_published() {
        for kind in RecordKind::ALL.into_iter().filter(|kind| kind.groups().contains(&RecordGroup::Published))
        {
            assert_eq!(kind.replay_class(), ReplayClass::Note, "{kind}");
        }
    }

    #[test]
    fn rollback_end_and_upgrade_end_share_their_names() {
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
