//! What an engine learns of its store when it opens it.

use crate::change::{Change, QuarantinedFile};
use holdpoint_audit::chain::Head;
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::wall_time::WallTime;

/// The state of the store when it was opened.
#[derive(Clone, Debug)]
pub struct OpenReport {
    /// Whether the store is new.
    pub created: bool,
    /// The end of the chain; virtual time must continue from its `at_ms`.
    pub head: Head,
    /// Wall time of the newest record; absent in a store of scripts alone.
    pub newest_record: Option<WallTime>,
    /// Unfinished operations of an earlier engine, to finish or undo.
    pub interrupted: Vec<InterruptedWork>,
    /// News of the telemetry, for this engine to put on record.
    pub telemetry: StartupTelemetry,
    pub profiles: ProfileHistory,
}

/// An operation that was running when the last engine ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InterruptedWork {
    /// A stage was running; its result does not count and must be run again.
    Stage { version: CapabilityId, stage: Stage },
    /// An activation is provisional: monitor it before its next tick, or roll it back.
    Provisional { version: CapabilityId },
    /// A rollback was begun: finish it.
    RollbackPending { version: CapabilityId },
}

/// Differences between telemetry and chain at a start.
#[derive(Clone, Debug, Default)]
pub struct StartupTelemetry {
    /// The change that puts them on record.
    pub changes: Vec<Change>,
    /// Batches that were sealed and are not there.
    pub missing: u64,
    /// Batches that were not sealed when the last engine ended.
    pub unsealed: u64,
    /// Quarantined telemetry files that no record names yet.
    pub aside: Vec<QuarantinedFile>,
}
