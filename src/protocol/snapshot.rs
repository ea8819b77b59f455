//! The current state: everything a screen needs, nothing that grants anything.
//!
//! A value that was not measured is absent, never zero.

use std::cmp::Reverse;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::console_presence::AttachedConsoleView;
use super::detail::VersionDiff;
use super::event::{DimensionResult, TaskSummary};
use super::monitor_chart::ChartView;
use super::video_frame::Scenery;
use super::work_unit::{PartCount, WorkUnit};
use holdpoint_approvals::Nonce;
use holdpoint_body::disturbance::{Drift, LiveFault};
use holdpoint_governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::deployability::Deployability;
use holdpoint_governance::evidence::{DrillTallies, Signature, StaleCause};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::profile::{ProfileName, SiteName};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::version_status::VersionStatus;
use holdpoint_governance::wall_time::{ClockMismatch, WallTime};

mod stopped;
mod version_status;

pub use super::request_kind::RequestKind;
pub use stopped::{RepeatedStop, STOPS_NAMED_MAX, StoppedView};
pub use version_status::{current_progress, is_at_work, re_evaluation, waits_its_turn};

/// The state of the whole engine at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Snapshot {
    /// Virtual time at which it was taken, ms.
    pub at_ms: u64,
    /// The machine's time then, ms since 1970; absent in scripts, which have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_ms: Option<i64>,
    /// Virtual time at which this engine came up, ms; from then on it follows the machine's clock. Absent in scripts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up_since_ms: Option<u64>,
    /// Wall time for approvers' deadlines; a script has its own.
    #[serde(default)]
    pub time: WallTime,
    /// The clock mismatch: nothing is activated until a person confirms the time. Absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock_doubt: Option<ClockMismatchView>,
    /// Profile of this session.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// The site file, safe to print; absent for the built-in site.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_file: Option<String>,
    /// Name of the robot's description.
    pub robot: String,
    /// Seed of the run, from which every disturbance and every choice follows; absent where the seeds are secret.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Digest of profile and policies.
    pub policy: Digest,
    /// Hash of the agent's identity; upgrades do not change it.
    pub agent: Digest,
    /// How far the record is read; absent once every row is verified. Before that, the engine carries out only a stop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading: Option<StartupProgressView>,
    /// What the signature of a request that grants or widens authority covers; absent in a script and before the
    /// record was read, where requests are unsigned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signing: Option<SigningView>,
    /// Why the engine is halted after a fault of its own; absent if it is not.
    pub holding: Option<String>,
    /// The person who stopped the cell, and since when; absent while it runs.
    pub stopped: Option<StoppedView>,
    /// Why no version activates and the arm is at standstill: no administrator authorized this profile. Absent if one
    /// did, or none has to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unauthorized: Option<String>,
    /// Every family in the store, sorted by name.
    pub families: Vec<FamilyView>,
    /// Every current version, the newest last.
    pub candidates: Vec<CandidateView>,
    /// Open approval requests: about activations, releases and reviews.
    pub prompts: Vec<ApprovalRequestView>,
    /// Versions that approvals or the calendar hold back and that one person may activate by break-glass.
    #[serde(default)]
    pub emergencies: Vec<ApprovalRequestView>,
    /// Open escalations.
    pub questions: Vec<EscalationView>,
    /// Alarms that are not normal, in the order of attention.
    pub alarms: Vec<AlarmView>,
    /// Counts for the status line.
    pub alarm_summary: AlarmSummary,
    /// The state of the live world.
    pub live: LiveView,
    /// The fixed objects around the robot.
    pub scenery: Scenery,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
    /// Metrics of this session; `holdpoint metrics` reads the whole store.
    #[serde(default)]
    pub observed: ObservedCounts,
    /// The attached consoles, in order of attachment.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seats: Vec<AttachedConsoleView>,
    /// Seconds without an attached console until the engine exits cleanly; absent if it continues without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ends_alone_s: Option<u64>,
}

impl Snapshot {
    /// The wall time for approvers' deadlines when the engine's clock is at `at_ms`, if the wall clock is not set
    /// before.
    #[must_use]
    pub const fn time_at(&self, at_ms: u64) -> WallTime {
        self.time.plus_ms(at_ms.saturating_sub(self.at_ms))
    }
}

/// A clock mismatch.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ClockMismatchView {
    /// Why.
    pub doubt: ClockMismatch,
    /// The cause in a sentence.
    pub text: String,
    /// The time of the clock, which a person confirms or corrects first.
    pub said: WallTime,
}

/// What a request signature covers beside the request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SigningView {
    /// Whether a command that grants or widens authority needs a signature.
    pub required: bool,
    /// The store.
    pub store_id: String,
    /// Id of this session; signatures made for another session are invalid.
    pub life: Nonce,
    /// Latest virtual time at which a signature made now may expire, ms.
    pub until_ms: u64,
}

/// How far a starting engine has read its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct StartupProgressView {
    /// Records read and verified against their hashes.
    pub read: u64,
    /// Total records, as the store reports.
    pub of: u64,
}

/// An escalation: without an answer the version is rolled back at the deadline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EscalationView {
    /// The active version.
    pub version: CapabilityId,
    /// Its reasons, the deciding one first.
    pub reasons: Vec<Reason>,
    /// Deadline, virtual ms: without an answer the version is rolled back.
    pub deadline_ms: u64,
}

/// A family: its active version and its rollback target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FamilyView {
    /// Name of the family, e.g. `grasp`.
    pub family: Family,
    /// The active version; absent while safe-stopped.
    pub active: Option<CapabilityId>,
    /// The rollback target.
    pub pinned: Option<CapabilityId>,
    /// No version is active until an operator reactivates one.
    pub safe_stopped: bool,
    /// The active version's flags; absent without one.
    pub flags: Option<VersionFlags>,
    /// Episodes of the provisional window: run and needed.
    pub provisional: Option<(u32, u32)>,
    /// The break-glass activation that awaits review; no version of the family is promoted before.
    #[serde(default)]
    pub review: Option<ReviewView>,
}

/// A break-glass activation that two people still have to review.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ReviewView {
    /// The version that one person activated; it may have left meanwhile.
    pub version: CapabilityId,
    /// Deadline of the review, after which the version is demoted.
    pub until: WallTime,
    /// Whether the deadline has passed; the review stays open.
    pub overdue: bool,
}

/// A candidate (or a version that was one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateView {
    /// The version.
    pub version: CapabilityId,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// The lifecycle state it is in.
    pub state: State,
    /// Its previous state; absent while it is in its first.
    pub left: Option<State>,
    /// The stage that ran when it left that state; absent if none did.
    #[serde(default)]
    pub ran: Option<Stage>,
    /// Whether it ever passed its provisional window.
    pub confirmed: bool,
    /// Running stage, pauses, approval requests, restrictions.
    pub flags: VersionFlags,
    /// Counts every change of the version's row; approvals name it.
    pub row_version: u64,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// How the version came about, as the submission has it.
    pub provenance: Provenance,
    /// Risk class by its changes; before the assessment of its dimensions, the submission's estimate.
    pub risk: Risk,
    /// Progress of the running stage; absent if none is running.
    pub progress: Option<ProgressView>,
    /// The latest assessment of the four dimensions, in the order I, P, B, R.
    pub dimensions: Vec<DimensionResult>,
    /// The composite score of the four dimensions; reported, never gating.
    pub composite: Option<f64>,
    /// Paired episodes so far; absent before the first.
    pub pairs: Option<PairsView>,
    /// Drills so far: the candidate's and the active version's.
    pub drills: Option<(DrillTallies, DrillTallies)>,
    /// Shadow sequences so far; absent before the first.
    pub shadow: Option<ShadowView>,
    /// Why the last decision was made, the deciding reasons first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used.
    pub conditions: Vec<Condition>,
    /// Its deployment outcome so far; absent before the first decision.
    #[serde(default)]
    pub deployment: Option<Deployability>,
    /// It does not continue by itself: the gate put it on hold, or no approver answered. `resume` continues it.
    #[serde(default)]
    pub held: bool,
    /// Profiles under which a profile demotion blocks it.
    #[serde(default)]
    pub closed: Vec<ProfileName>,
    /// Why its evidence is stale; empty while it counts. The numbers beside it are from before.
    #[serde(default)]
    pub stale: Vec<StaleCause>,
    /// Its stage has begun and rests: a person paused it, or the stage of another version has come meanwhile.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub parked: bool,
    /// The try that its sandbox counts as; absent before its first pair.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counted: Option<CountedTry>,
    /// Its status by state and record; absent in snapshots of older builds, see [`Snapshot::status`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub status: Option<VersionStatus>,
}

/// Progress of the running stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProgressView {
    /// The stage that is running.
    pub stage: Stage,
    /// The unit of work, e.g. episode pairs or drills.
    pub what: Lenient<WorkUnit>,
    /// Episodes, drills and sequences of the whole stage that are done.
    pub done: u64,
    /// How many there are in all; an early end may come before.
    pub budget: u64,
    /// The count of the unit that runs, against its own budget; absent where that is the whole, and in snapshots of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<PartCount>,
    /// When the stage began, virtual ms.
    pub since_ms: u64,
    /// The condition of an early end, one sentence.
    pub early: String,
}

/// Paired episodes of a sandbox evaluation so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairsView {
    /// Pairs run so far.
    pub n: u64,
    /// The active version's means over the pairs.
    pub active: Signature,
    /// The candidate's means over the same pairs.
    pub candidate: Signature,
    /// Two-sided 95 % Wilson interval of the candidate's success.
    pub candidate_success: [f64; 2],
    /// Two-sided 95 % Wilson interval of the active version's success.
    pub active_success: [f64; 2],
}

/// Shadow sequences so far: the live world against its twin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShadowView {
    /// Whole sequences run so far.
    pub n: u64,
    /// Mean distance of the candidate's commands from the active version's, 0 to 1 of range.
    pub output: f64,
    /// Share of sequences in which the twin raised a governance signal and the live world did not, less the reverse.
    pub governance: f64,
    /// Mean share of the twin's trajectory outside the active version's band, 0 to 1.
    pub envelope: f64,
    /// The profile's limits of the three; absent where a value alone decides nothing.
    pub limits: [Option<f64>; 3],
    /// Output, governance and envelope divergence of each sequence, in order.
    pub series: Vec<[f32; 3]>,
    /// Sequences in which twin and live world did not agree, the newest first; at most fifty.
    pub disagreements: Vec<Disagreement>,
}

/// A shadowed sequence in which the two worlds ended differently.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Disagreement {
    /// Which of the shadowed sequences, counting from 0.
    pub index: u64,
    /// Seed of the disturbances both worlds met.
    pub seed: u64,
    /// The differences between live world and twin, in words.
    pub text: String,
    /// Distance of the candidate's commands from the active version's in this sequence, 0 to 1 of range.
    pub output: f32,
}

/// An open approval request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ApprovalRequestView {
    /// Its id among the open requests.
    pub id: String,
    /// The candidate that would be activated.
    pub version: CapabilityId,
    /// The active version it would replace; absent if there is none.
    pub replaces: Option<CapabilityId>,
    /// Digest of the candidate's manifest and bundle; the signature covers it.
    pub candidate: Digest,
    /// The candidate's row version at the request; a decision names it.
    pub row_version: u64,
    /// Digest of the evidence; the signature covers it.
    pub evidence: Digest,
    /// Digest of profile and policies; the signature covers it.
    pub policy: Digest,
    /// Profile of the activation.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// The quorum.
    pub needed: u32,
    /// Whether the quorum approved: the candidate becomes active after the running sequence.
    #[serde(default)]
    pub granted: bool,
    /// Identities whose approvals count so far.
    pub approved_by: Vec<String>,
    /// Whether a required safety officer's approval is missing.
    #[serde(default)]
    pub officer_missing: bool,
    /// When the unanswered request puts it on hold, also while no engine runs.
    pub until: WallTime,
    /// When a decision signed now expires.
    pub valid_until: WallTime,
    /// Id of the store; a decision signed for it counts in no other.
    pub store_id: String,
    /// When the request was made.
    pub asked: WallTime,
    /// How much friction a decision needs (0, 1 or 2; reference A6).
    pub tier: u8,
    /// The candidate's author and whether verified, e.g. `ada (unverified)`; the author cannot approve it.
    pub author: String,
    /// The person who registered the candidate, and so cannot approve it.
    #[serde(default)]
    pub requester: Requester,
    /// Its risk class with the causes; absent before the assessment, which counts as high.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub risk: Option<RiskClass>,
    /// Permissions that the active version does not have, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version.
    #[serde(default)]
    pub changes: VersionDiff,
    /// The conditions of its activation, one sentence each.
    #[serde(default)]
    pub conditions: Vec<String>,
    /// What decided behavior and recovery, with the numbers and the work that shows it; one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub why: Vec<String>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
    /// The response if it gets worse after activation, one sentence.
    pub on_drift: String,
    /// The kind of request.
    #[serde(default)]
    pub purpose: RequestKind,
    /// The subject of a release or a review, one sentence; empty for an activation.
    #[serde(default)]
    pub about: String,
    /// The request as observers read it. A signer gets separate lines
    /// ([`Command::Question`](crate::command::Command::Question)); if these change, it is another request.
    #[serde(default)]
    pub lines: Vec<String>,
}

/// An alarm that is not normal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmView {
    /// Name of the alarm, e.g. `rolled-back:grasp@1.3.0`.
    pub alarm: String,
    /// What it is grouped by in a flood, e.g. `rollback`.
    pub subject: String,
    /// The displayed state: shelved hides every other.
    pub state: AlarmState,
    /// How soon an operator has to act.
    pub priority: Priority,
    /// The problem.
    pub text: NoticeOrText,
    /// Virtual time of the first raise since it was last normal, ms.
    pub since_ms: u64,
    /// The state without the shelf; as `state` if it is not shelved.
    pub state_below: AlarmState,
    /// Whether it is latched until a reset after its condition has ended.
    pub latching: bool,
    /// Identity that acknowledged it; absent while it calls for attention.
    pub acknowledged_by: Option<String>,
    /// The person who shelved it, the reason, and the end.
    pub shelf: Option<(String, String, WallTime)>,
    /// How often it was raised since it was last normal.
    pub raises: u32,
    /// Whether it recurs so often that it is one row with a count.
    pub chattering: bool,
}

impl AlarmView {
    /// Sort key of attention, lowest first: urgent, then unacknowledged, then still present, then newest.
    #[must_use]
    pub const fn attention_rank(&self) -> (Priority, bool, bool, Reverse<u64>) {
        (self.priority, !self.state.calls(), !self.state.is_present(), Reverse(self.since_ms))
    }
}

impl Snapshot {
    /// The alarm to show where there is room for one; absent if every alarm is normal or shelved.
    #[must_use]
    pub fn foremost_alarm(&self) -> Option<&AlarmView> {
        foremost(self.alarms.iter())
    }
}

fn foremost<'a>(alarms: impl Iterator<Item = &'a AlarmView>) -> Option<&'a AlarmView> {
    let visible = alarms.filter(|alarm| !matches!(alarm.state, AlarmState::Normal | AlarmState::Shelved));
    visible.min_by_key(|alarm| alarm.attention_rank())
}

/// The state of the live world and its recent results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LiveView {
    /// Whole sequences run in this session.
    pub sequences: u64,
    /// Of the last fifty: whole sequences done.
    pub recent_success: Option<f64>,
    /// The number of sequences of that rate.
    pub recent: u64,
    /// The tasks of the last sequence, in the order of work.
    pub last: Vec<TaskSummary>,
    /// Tasks of this session that ran although no evidence covers their start.
    #[serde(default)]
    pub uncovered: u64,
    /// The drift that has set in; absent if there is none.
    pub drift: Option<Drift>,
    /// The present fault, for an exercise.
    pub fault: Option<LiveFault>,
    /// The agent's goal, in the words of its goal interpreter; empty in snapshots of older builds.
    #[serde(default)]
    pub goal: String,
    /// Simulated seconds in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Success of the last sequences, the newest last; at most fifty.
    pub outcomes: Vec<bool>,
    /// Monitors of the provisional or restricted versions.
    pub monitors: Vec<MonitorView>,
}

const fn plain() -> f64 {
    1.0
}

/// A monitor's charts, each against its limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MonitorView {
    /// The active version it watches.
    pub version: CapabilityId,
    /// Live episodes of the version watched so far.
    pub episodes: u32,
    /// Live episodes in the whole provisional window.
    pub needed: u32,
    /// Whether it has capped the version's speed and force.
    pub restricted: bool,
    /// Each chart with its value and its limit.
    pub charts: Vec<ChartView>,
    /// The factor of a condition on the profile's limits; 1 without one. The limits above include it.
    #[serde(default = "plain")]
    pub factor: f64,
    /// Whether the first warning rolls the version back without asking an operator.
    #[serde(default)]
    pub coupled: bool,
}

#[cfg(test)]
mod tests;
