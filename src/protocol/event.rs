//! What the engine tells: one value per thing that happened, in order.
//!
//! No wall-clock time is in an event: equal scenarios with equal seeds give equal events.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::explained::blank;
use holdpoint_body::rehearsal::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::approval::Answer;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::{ActivationMode, DimensionOutcome, StageOutcome};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::rollback::{RollbackRecord, Rung, RungFailure};
use holdpoint_governance::submission::{Provenance, Risk};

/// One thing that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// Counts from 1 in one engine's life.
    pub seq: u64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// What.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// A dimension's result, for display.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DimensionResult {
    /// Which.
    pub dimension: Dimension,
    /// The outcome in the dimension's own words.
    pub outcome: DimensionOutcome,
    /// The value; absent where there is no data.
    pub kappa: Option<f64>,
    /// Where the true value lies; absent for what is determined without measuring, and without data.
    pub interval: Option<[f64; 2]>,
    /// The profile's threshold.
    pub threshold: f64,
    /// Measured, or an estimate.
    pub measured: bool,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "event")]
pub enum EventKind {
    /// The engine is up.
    EngineStarted {
        /// The profile.
        profile: ProfileName,
        /// The robot.
        robot: String,
        /// The run's seed.
        seed: u64,
        /// Digest of profile and policies.
        policy: Digest,
        /// Hash of the agent's identity.
        agent: Digest,
        /// Active versions.
        active: Vec<CapabilityId>,
    },
    /// What an interrupted engine had left, and what was done about it.
    Recovered {
        /// The version.
        version: CapabilityId,
        /// One sentence.
        text: String,
    },
    /// A version was taken in (or bootstrapped).
    Registered {
        /// The version.
        version: CapabilityId,
        /// Digest of manifest and bundle.
        digest: Digest,
        /// Who made it.
        author: String,
        /// How.
        provenance: Provenance,
        /// Declared risk.
        risk: Risk,
        /// The version it was made from.
        parent: Option<String>,
    },
    /// A stage began.
    StageStarted {
        /// The version.
        version: CapabilityId,
        /// The stage.
        stage: Stage,
        /// Episodes, drills or sequences it takes.
        budget: u64,
    },
    /// Part of a stage is done.
    Progress {
        /// The version.
        version: CapabilityId,
        /// The stage.
        stage: Stage,
        /// What is being done.
        what: String,
        /// So many are done.
        done: u64,
        /// Of so many.
        budget: u64,
    },
    /// A stage ended with a decision.
    Decided {
        /// The version.
        version: CapabilityId,
        /// The stage.
        stage: Stage,
        /// What was decided.
        outcome: StageOutcome,
        /// The four dimensions as they stand.
        dimensions: Vec<DimensionResult>,
        /// The composite; reported, never gating.
        composite: Option<f64>,
        /// Why, the deciding reasons first.
        reasons: Vec<Reason>,
        /// Under which conditions.
        conditions: Vec<Condition>,
    },
    /// A version's state changed.
    StateChanged {
        /// The version.
        version: CapabilityId,
        /// From.
        from: State,
        /// To.
        to: State,
        /// Why.
        reason: String,
    },
    /// People are asked.
    ApprovalRequested {
        /// The version.
        version: CapabilityId,
        /// The version it would replace.
        replaces: Option<CapabilityId>,
        /// How many distinct people.
        needed: u32,
        /// Until when, virtual ms.
        deadline_ms: u64,
        /// Digest of what is to be signed over.
        evidence: Digest,
        /// Who made it, and so cannot approve it.
        author: String,
        /// Permissions that the active version does not have.
        new_permissions: Vec<String>,
        /// What was not tested, one sentence each.
        untested: Vec<String>,
        /// What happens when it gets worse after activation, one sentence.
        on_drift: String,
    },
    /// Somebody decided.
    ApprovalReceived {
        /// The version.
        version: CapabilityId,
        /// Who.
        by: String,
        /// What they said.
        decision: Answer,
        /// Why.
        reason: String,
        /// Approvals so far.
        have: u32,
        /// Approvals needed.
        needed: u32,
    },
    /// A version took over.
    Activated {
        /// The version.
        version: CapabilityId,
        /// The version it replaced.
        replaced: Option<CapabilityId>,
        /// How it may be active.
        modes: Vec<ActivationMode>,
        /// Under which conditions.
        conditions: Vec<Condition>,
        /// Episodes until it is confirmed.
        provisional_episodes: u32,
    },
    /// A provisional version passed its window.
    Confirmed {
        /// The version.
        version: CapabilityId,
        /// Episodes it worked.
        episodes: u32,
    },
    /// The live world worked a sequence.
    Sequence {
        /// Which.
        index: u64,
        /// Whole sequence done.
        success: bool,
        /// Per task: version, success, violation, anomaly, recovery.
        tasks: Vec<TaskSummary>,
        /// Why the next task was not started.
        refused: Option<String>,
    },
    /// The monitor decided something else than to go on.
    Monitor {
        /// The version.
        version: CapabilityId,
        /// What is done, or how a doubt ended.
        decision: MonitorOutcome,
        /// Why.
        reasons: Vec<Reason>,
    },
    /// One rung of the rollback ladder.
    Rung {
        /// The version.
        version: CapabilityId,
        /// Which rung.
        rung: Rung,
        /// Whether it held.
        ok: bool,
        /// Why it did not.
        failure: Option<RungFailure>,
        /// Simulated time it took, ms.
        ms: u64,
        /// What was found.
        text: String,
    },
    /// A version was taken off (paper appendix F.3).
    RolledBack {
        /// The version.
        version: CapabilityId,
        /// Who took over.
        restored: Option<CapabilityId>,
        /// What triggered it.
        trigger: String,
        /// From the trigger until every joint stood, ms; absent where they never did.
        time_to_safe_ms: Option<u64>,
        /// From the trigger until the predecessor was bound and ready, ms; absent where that failed.
        time_to_rollback_ms: Option<u64>,
        /// Whether the family works again.
        recovered: bool,
        /// All of it, rung by rung.
        record: Box<RollbackRecord>,
    },
    /// A drift set in or ended.
    Drift {
        /// Which; absent where it ended.
        kind: Option<DriftKind>,
        /// How strong; absent (an empty text) where it ended.
        #[serde(with = "blank")]
        #[schemars(with = "String")]
        magnitude: Option<Magnitude>,
    },
    /// Something in the live world broke, or was mended.
    LiveFault {
        /// What is broken; absent where nothing is.
        fault: Option<LiveFault>,
    },
    /// Somebody answered a monitor's question: the version goes on as it is.
    Continued {
        /// The version.
        version: CapabilityId,
        /// Who.
        by: String,
        /// Why.
        reason: String,
    },
    /// The simulated live world works at another pace from now on.
    Pace {
        /// Simulated seconds in a second; absent for as fast as it computes.
        times: Option<f64>,
    },
    /// An alarm changed: raised, cleared, acknowledged, reset, shelved or taken from its shelf.
    Alarm {
        /// Which.
        alarm: String,
        /// What it is about.
        subject: String,
        /// Its state.
        state: AlarmState,
        /// Its priority.
        priority: Priority,
        /// One sentence.
        text: String,
    },
    /// A profile, policy or active version changed and voided a family's passes.
    Voided {
        /// The family.
        family: Family,
        /// Why.
        reason: String,
    },
    /// The record of an upgrade is closed.
    AuditClosed {
        /// The version.
        version: CapabilityId,
        /// How it ended.
        outcome: UpgradeEnd,
        /// Records that are about it.
        records: u64,
    },
    /// The recording of an upgrade is closed, and its digest is on record.
    RecordingKept {
        /// The version.
        version: CapabilityId,
        /// The file's name, in the store's folder of recordings.
        file: String,
        /// SHA-256 of the file.
        digest: Digest,
        /// Its size.
        bytes: u64,
        /// Moments of the live cell in it.
        pictures: u64,
        /// Pictures and events that did not fit into the queue and are not in it.
        dropped: [u64; 2],
    },
    /// Something about scenes: where a viewer may connect, or why a recording is not written. Decides nothing.
    Scene {
        /// One sentence.
        text: String,
        /// Whether something is not shown or not kept.
        failed: bool,
    },
    /// A command was refused.
    CommandRefused {
        /// Its id.
        id: String,
        /// Why.
        text: String,
    },
    /// A fault of the engine's own: the pipeline holds.
    Fault {
        /// What failed.
        text: String,
    },
}

/// What one live task gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TaskSummary {
    /// The version that did it.
    pub version: CapabilityId,
    /// Done.
    pub success: bool,
    /// A limit was passed.
    pub violation: bool,
    /// The watcher named something.
    pub anomaly: bool,
    /// The recovery manager ran.
    pub recovery: bool,
    /// New attempts.
    pub retries: u32,
    /// Duration, s.
    pub time_secs: f64,
}
