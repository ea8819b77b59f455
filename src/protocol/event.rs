//! Events of the engine: one value for each thing that happened, in order.
//!
//! No wall-clock time is in an event: equal scenarios with equal seeds give equal events.

mod subject;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::caller::Caller;
use super::detail::VersionDiff;
use super::explanation::blank;
use super::request_kind::RequestKind;
use super::work_unit::{PartCount, WorkUnit};
use holdpoint_body::disturbance::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::approval::{ApprovalDecision, Requester};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::harm::HarmPast;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::outcome::{ActivationMode, DimensionOutcome, StageOutcome};
use holdpoint_governance::past_limit::PastLimit;
use holdpoint_governance::profile::{ProfileName, SiteName};
use holdpoint_governance::record::{RecordKind, UpgradeEnd};
use holdpoint_governance::rollback::{RollbackRecord, Rung, RungFailure};
use holdpoint_governance::submission::{InterfaceChange, Provenance, Risk};
use holdpoint_governance::wall_time::WallTime;

/// One thing that happened, numbered and with its virtual time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Event {
    /// Counts from 1 in each session.
    pub seq: u64,
    /// Virtual time at which it happened, ms.
    pub at_ms: u64,
    /// The kind of event with its values; `event` names it in JSON.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// Result of one compatibility dimension, for display; nothing decides by it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DimensionResult {
    /// The dimension of compatibility, one of the paper's four.
    pub dimension: Dimension,
    /// The outcome in the dimension's own words.
    pub outcome: DimensionOutcome,
    /// The value; absent if there is no data.
    pub kappa: Option<f64>,
    /// The interval of the true value; absent without data, or if it needs no measurement.
    pub interval: Option<[f64; 2]>,
    /// Least acceptable value under the profile, 0 to 1.
    pub threshold: f64,
    /// Whether the value was measured; otherwise it is an estimate, which opens no gate.
    pub measured: bool,
}

/// What happened. In JSON the field `event` holds the variant's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "event")]
pub enum EventKind {
    /// The engine is up and takes commands.
    EngineStarted {
        /// Profile of this session.
        profile: ProfileName,
        /// Its own name, if it does not come with the program.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        site: Option<SiteName>,
        /// Name of the robot's description.
        robot: String,
        /// Seed of the run, from which every disturbance and every choice follows; absent where the seeds are secret.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seed: Option<u64>,
        /// Digest of profile and policies.
        policy: Digest,
        /// Hash of the agent's identity; upgrades do not change it.
        agent: Digest,
        /// The version in control of each family.
        active: Vec<CapabilityId>,
    },
    /// The remains of an interrupted engine, and their recovery.
    Recovered {
        /// The version that was under way when the engine was interrupted.
        version: CapabilityId,
        /// The finding and the recovery.
        text: NoticeOrText,
    },
    /// A version was registered (or bootstrapped).
    Registered {
        /// The registered version.
        version: CapabilityId,
        /// Digest of its manifest and bundle.
        digest: Digest,
        /// Identity of its author, as the submission has it.
        author: String,
        /// The person who registered it, and so cannot approve it; unknown in events of earlier versions.
        #[serde(default)]
        requester: Requester,
        /// How the version came about, as the submission has it.
        provenance: Provenance,
        /// Risk tier, as the submission estimates it.
        risk: Risk,
        /// The version it was made from, as the submission has it.
        parent: Option<String>,
        /// What its author declares to have changed in the interface.
        #[serde(default)]
        interface_changes: Vec<InterfaceChange>,
        /// What its author should change, though nothing is refused for it.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        notices: Vec<Notice>,
    },
    /// A stage began for a version.
    StageStarted {
        /// The version under evaluation.
        version: CapabilityId,
        /// The stage that began.
        stage: Stage,
        /// Episodes, drills or sequences it takes.
        budget: u64,
    },
    /// Progress of a stage; sent at intervals, not for every episode.
    Progress {
        /// The version under evaluation.
        version: CapabilityId,
        /// The stage that is under way.
        stage: Stage,
        /// The unit of work, e.g. episode pairs or drills.
        what: Lenient<WorkUnit>,
        /// How much of the whole stage is done.
        done: u64,
        /// How much there is in all; an early end may come before.
        budget: u64,
        /// The count of the unit alone; absent where that is the whole, and in events of older builds.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        part: Option<PartCount>,
    },
    /// A stage ended with a decision by its rule.
    Decided {
        /// The version that was judged.
        version: CapabilityId,
        /// The stage that ended.
        stage: Stage,
        /// The outcome, in the words of the stage's rule.
        outcome: StageOutcome,
        /// The current four dimensions.
        dimensions: Vec<DimensionResult>,
        /// The composite score of the four dimensions; reported, never gating.
        composite: Option<f64>,
        /// Why, the deciding reasons first.
        reasons: Vec<Reason>,
        /// Conditions under which the version may be used from here on.
        conditions: Vec<Condition>,
        /// The deployment outcome; absent in events of older builds.
        #[serde(default)]
        deployment: Option<Deployability>,
    },
    /// A version's lifecycle state changed, and the change is on disk.
    StateChanged {
        /// The version whose lifecycle state moved.
        version: CapabilityId,
        /// The state it left.
        from: State,
        /// The state it entered.
        to: State,
        /// The cause.
        reason: NoticeOrText,
    },
    /// An approval request about an activation was made.
    ApprovalRequested {
        /// The version that would be activated.
        version: CapabilityId,
        /// The active version it would replace; absent if there is none.
        replaces: Option<CapabilityId>,
        /// How many distinct people have to approve.
        needed: u32,
        /// When an unanswered request puts the version on hold; 1970 in recordings of earlier versions, which used the
        /// engine's time.
        #[serde(default)]
        until: WallTime,
        /// Digest that the signature covers.
        evidence: Digest,
        /// The author, who cannot approve it.
        author: String,
        /// Permissions that the active version does not have, or has at a lower level.
        new_permissions: Vec<String>,
        /// The whole difference to the active version.
        #[serde(default)]
        changes: Box<VersionDiff>,
        /// Conditions under which it would be used.
        #[serde(default)]
        conditions: Vec<Condition>,
        /// What was not tested, one sentence each.
        untested: Vec<String>,
        /// The response if it gets worse after activation, one sentence.
        on_drift: String,
        /// The kind of request.
        #[serde(default)]
        purpose: RequestKind,
    },
    /// A person's signed answer was accepted and is on record.
    ApprovalReceived {
        /// The version it is about.
        version: CapabilityId,
        /// Identity that signed it.
        by: String,
        /// For or against the activation.
        decision: ApprovalDecision,
        /// Why, in the person's own words.
        reason: String,
        /// Distinct people who have approved so far, this answer included.
        have: u32,
        /// Distinct people whose approval is needed.
        needed: u32,
    },
    /// A version took over control after its gate was passed.
    Activated {
        /// The version in control from now on.
        version: CapabilityId,
        /// The version it replaced.
        replaced: Option<CapabilityId>,
        /// The modes that hold together (paper table 4).
        modes: Vec<ActivationMode>,
        /// Conditions that guard and monitor enforce while it is active.
        conditions: Vec<Condition>,
        /// Live episodes until it is confirmed.
        provisional_episodes: u32,
    },
    /// A provisional version passed its window without a trip and without an open concern.
    Confirmed {
        /// The version that is no longer provisional.
        version: CapabilityId,
        /// Live episodes it ran while provisional.
        episodes: u32,
    },
    /// The live world completed a sequence of tasks.
    Sequence {
        /// Which sequence of the live world, counting from 0.
        index: u64,
        /// Whether every task of the sequence was done.
        success: bool,
        /// Per task: version, success, violation, anomaly, recovery.
        tasks: Vec<TaskSummary>,
        /// Why the next task was not started.
        refused: Option<String>,
    },
    /// The monitor decided something else than to continue.
    Monitor {
        /// The monitored version.
        version: CapabilityId,
        /// The action, or how a concern ended.
        decision: MonitorOutcome,
        /// Why, the deciding reason first.
        reasons: Vec<Reason>,
    },
    /// One rung of the rollback ladder was tried.
    Rung {
        /// The version that is being rolled back.
        version: CapabilityId,
        /// The step of the ladder that was tried.
        rung: Rung,
        /// Whether the rung succeeded.
        ok: bool,
        /// Why it failed; absent if it succeeded.
        failure: Option<RungFailure>,
        /// Simulated time it took, ms.
        ms: u64,
        /// What was found.
        text: NoticeOrText,
    },
    /// A version was rolled back (paper appendix F.3).
    RolledBack {
        /// The version that was rolled back.
        version: CapabilityId,
        /// The rollback target that is active again; absent if there is none.
        restored: Option<CapabilityId>,
        /// The trigger.
        trigger: NoticeOrText,
        /// From the trigger until every joint was at rest, ms; absent if that never happened.
        time_to_safe_ms: Option<u64>,
        /// From the trigger until the rollback target was bound and ready, ms; absent if that failed.
        time_to_rollback_ms: Option<u64>,
        /// Whether the first sequences under the rollback target ended without a safety event.
        recovered: bool,
        /// The whole record of the rollback, rung by rung.
        record: Box<RollbackRecord>,
    },
    /// A drift of the live cell set in or ended.
    Drift {
        /// The kind that set in; absent if the drift ended.
        kind: Option<DriftKind>,
        /// How strong; absent (an empty text) if it ended.
        #[serde(with = "blank")]
        #[schemars(with = "String")]
        magnitude: Option<Magnitude>,
    },
    /// Something in the live world broke or was repaired.
    LiveFault {
        /// What is broken; absent if nothing is.
        fault: Option<LiveFault>,
    },
    /// The agent of the live cell has another goal from the next sequence on.
    GoalSet {
        /// In the words of the agent's goal interpreter.
        goal: String,
        /// The person who set it.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// A person left a note for the next shift.
    ShiftNote {
        /// Its author.
        by: String,
        /// Its text.
        text: String,
    },
    /// An operator answered an escalation: the version continues unchanged.
    Continued {
        /// The active version the question was about.
        version: CapabilityId,
        /// Identity of the person who answered.
        by: String,
        /// Why it may continue, in the person's own words.
        reason: String,
    },
    /// The normal rates of a family were counted over its first live tasks and stored.
    Commissioned {
        /// The version that ran them.
        version: CapabilityId,
        /// Tasks it was counted over.
        tasks: u32,
        /// Of these, not done.
        failures: u32,
        /// Of these, ran into their time limit.
        timeouts: u32,
        /// The largest force in any of them, N.
        peak_force_n: f64,
    },
    /// In a live task a measure of harm was past its limit.
    HarmPastLimit {
        /// The active version that did the task.
        version: CapabilityId,
        /// Which of its live tasks, counting from 1 over its whole life.
        task: u64,
        /// Which sequence of the live world, counting from 0; absent in events of older builds.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sequence: Option<u64>,
        /// The measures, each with value, limit and unit.
        past: Vec<HarmPast>,
        /// Whether a measure is past the value from which it is a danger to people.
        danger: bool,
        /// Its live tasks past a limit so far, this one included.
        tasks_past: u64,
    },
    /// The camera check measured what is normal for the cell over its first live tasks and stored it.
    SensesCommissioned {
        /// Tasks it was measured over, with any active version.
        tasks: u32,
        /// The largest jitter of the camera frames in one task, m.
        picture_jitter_m: f64,
        /// The largest rate of missing camera frames in one task.
        pictures_missing: f64,
    },
    /// A person stopped the cell: no command reaches the arm until a person starts it again.
    CellStopped {
        /// The person's own name, unverified.
        by: String,
        /// The requesting process, as the operating system reports it.
        caller: Caller,
        /// Why, in the person's own words; may be empty.
        reason: String,
    },
    /// The stopped arm is at standstill: every joint, by its measured speed.
    ArmStands {
        /// Ticks from the request to the standstill; 0 if the arm was idle.
        ticks: u64,
    },
    /// The stopped cell runs again.
    CellReleased {
        /// Identity of the person who answers for it.
        by: String,
        /// The requesting process, as the operating system reports it.
        caller: Caller,
        /// Why it is safe, in the person's own words.
        reason: String,
    },
    /// The restriction of an active version was lifted; its window and its charts restart.
    Released {
        /// The active version that has its full envelope again.
        version: CapabilityId,
        /// Identity of the person who lifted it, or of its approvers.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// A version on hold continues from its current state.
    Resumed {
        /// The version that was paused, or on hold by the gate or an unanswered request.
        version: CapabilityId,
        /// Identity of the person who asked for it.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// A person made a version its family's anchor.
    AnchorSet {
        /// The version.
        version: CapabilityId,
        /// The person.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// A person reviewed the tries of a family: their count begins again.
    TriesReviewed {
        /// The version that the person named.
        version: CapabilityId,
        /// The person.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// A profile demotion: a version was blocked under profiles, or unblocked.
    ProfilesSet {
        /// The version it is about.
        version: CapabilityId,
        /// Every profile under which it is blocked from now on.
        closed: Vec<ProfileName>,
        /// Identity of the person who asked for it.
        by: String,
        /// Why, in the person's own words.
        reason: String,
    },
    /// One person activated a version by break-glass; two others have to review it.
    BreakGlass {
        /// The version that becomes active by it.
        version: CapabilityId,
        /// Identity of the person who signed.
        by: String,
        /// The emergency, in the person's own words.
        reason: String,
        /// Deadline of the review, after which it is rolled back; 1970 in recordings of earlier versions.
        #[serde(default)]
        until: WallTime,
    },
    /// A break-glass activation was reviewed.
    Reviewed {
        /// The version activated by break-glass.
        version: CapabilityId,
        /// Whether the reviewers upheld it; if not, it is rolled back.
        upheld: bool,
        /// Identities of the reviewers who decided.
        by: Vec<String>,
    },
    /// The live cell has another pace from now on.
    Pace {
        /// Simulated seconds in a second; absent for as fast as it computes.
        times: Option<f64>,
    },
    /// An alarm changed: raised, cleared, acknowledged, reset, shelved or unshelved.
    Alarm {
        /// Name of the alarm, e.g. `rolled-back:grasp@1.3.0`.
        alarm: String,
        /// What it is grouped by in a flood, e.g. `rollback`.
        subject: String,
        /// The state shown for it from now on.
        state: AlarmState,
        /// How soon an operator has to act.
        priority: Priority,
        /// The problem.
        text: NoticeOrText,
    },
    /// At a start: profile, policies, robot, site, scene or build have changed, and a family's earlier evidence is stale.
    Voided {
        /// The family whose gate passes and approvals no longer count.
        family: Family,
        /// What changed.
        reason: NoticeOrText,
    },
    /// The engine wrote a record that no other event tells of.
    Recorded {
        /// The kind of the record.
        kind: Lenient<RecordKind>,
        /// The version that the record is about; absent if it is about none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        version: Option<CapabilityId>,
        /// Its content, JSON text.
        body: String,
    },
    /// The record of an upgrade is closed.
    AuditClosed {
        /// The version whose upgrade is over.
        version: CapabilityId,
        /// The recorded end of the upgrade.
        outcome: UpgradeEnd,
        /// Audit records that are about the upgrade.
        records: u64,
    },
    /// The recording of an upgrade is closed, and its digest is on record.
    RecordingKept {
        /// The version whose upgrade is recorded.
        version: CapabilityId,
        /// The file's name, in the store's folder of recordings.
        file: String,
        /// SHA-256 of the file.
        digest: Digest,
        /// Size of the file, bytes.
        bytes: u64,
        /// Moments of the live cell in it.
        pictures: u64,
        /// Video frames and events that did not fit into the queue and are not in the recording.
        dropped: [u64; 2],
    },
    /// A notice about scenes: where a viewer can connect, or why a recording is not written. Decides nothing.
    Scene {
        /// The notice, one sentence.
        text: String,
        /// Whether something is not shown or not stored.
        failed: bool,
    },
    /// A command was refused; nothing has changed.
    CommandRefused {
        /// Id of the request, as its sender chose it.
        id: String,
        /// What failed and why, one sentence.
        text: String,
    },
    /// A fault of the engine itself: the engine is halted.
    Fault {
        /// What failed in the engine itself, one sentence.
        text: String,
    },
}

/// The result of one task of the live world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TaskSummary {
    /// The version that did the task.
    pub version: CapabilityId,
    /// The task was done, by inspection at its end.
    pub success: bool,
    /// A measured quantity exceeded its limit, or the guard denied a command.
    pub violation: bool,
    /// The largest value of the first quantity past its limit; absent without one, and in events of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub past: Option<PastLimit>,
    /// The watcher raised a failure signal.
    pub anomaly: bool,
    /// The recovery manager took over during the task.
    pub recovery: bool,
    /// Additional attempts after a failed one.
    pub retries: u32,
    /// How long the task took, simulated s.
    pub time_secs: f64,
    /// The evidence of the version does not cover the start of the task.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub uncovered: bool,
    /// Why the task failed, physically; absent where it was done or cut short, and in events of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<FailureCause>,
}
