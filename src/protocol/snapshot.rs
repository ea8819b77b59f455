//! How things stand, for whoever looks: everything a screen needs, nothing that grants anything.
//!
//! What has not been measured is absent, never zero.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::event::{DimensionResult, TaskSummary};
use super::picture::Scenery;
use holdpoint_body::rehearsal::{Drift, LiveFault};
use holdpoint_governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::evidence::{Drills, Signature};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Flags, Stage, State};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::{Provenance, Risk};

/// The whole picture at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Snapshot {
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The profile.
    pub profile: ProfileName,
    /// The robot.
    pub robot: String,
    /// The run's seed.
    pub seed: u64,
    /// Digest of profile and policies.
    pub policy: Digest,
    /// Hash of the agent's identity.
    pub agent: Digest,
    /// Why the engine holds, where it does.
    pub holding: Option<String>,
    /// Families, by name.
    pub families: Vec<FamilyView>,
    /// Every version that is not history, the newest last.
    pub candidates: Vec<CandidateView>,
    /// What waits for people.
    pub prompts: Vec<PromptView>,
    /// Monitors' questions that wait for an answer.
    pub questions: Vec<QuestionView>,
    /// Alarms that are not normal, in the order of attention.
    pub alarms: Vec<AlarmView>,
    /// Counts for the status line.
    pub alarm_summary: AlarmSummary,
    /// The live world.
    pub live: LiveView,
    /// What stands round the robot.
    pub scenery: Scenery,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
}

/// A monitor's question: people are needed, or the version is rolled back at the deadline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct QuestionView {
    /// About which active version.
    pub version: CapabilityId,
    /// Why it asks.
    pub reasons: Vec<Reason>,
    /// Until when, virtual ms.
    pub deadline_ms: u64,
}

/// A family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FamilyView {
    /// Its name.
    pub family: Family,
    /// The active version; absent while safe-stopped.
    pub active: Option<CapabilityId>,
    /// The rollback target.
    pub pinned: Option<CapabilityId>,
    /// Stopped until somebody re-arms it.
    pub safe_stopped: bool,
    /// The active version's flags.
    pub flags: Option<Flags>,
    /// Episodes of the provisional window: worked and needed.
    pub provisional: Option<(u32, u32)>,
}

/// A candidate (or a version that was one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateView {
    /// The version.
    pub version: CapabilityId,
    /// Digest of manifest and bundle.
    pub digest: Digest,
    /// Its state.
    pub state: State,
    /// Its flags.
    pub flags: Flags,
    /// Row version; approvals name it.
    pub row_version: u64,
    /// Who made it.
    pub author: String,
    /// How.
    pub provenance: Provenance,
    /// Declared risk.
    pub risk: Risk,
    /// The running stage: done, budget, what.
    pub progress: Option<ProgressView>,
    /// The four dimensions as they stand.
    pub dimensions: Vec<DimensionResult>,
    /// The composite; reported, never gating.
    pub composite: Option<f64>,
    /// Paired episodes so far.
    pub pairs: Option<PairsView>,
    /// Drills so far: the candidate's and the active version's.
    pub drills: Option<(Drills, Drills)>,
    /// Shadow so far.
    pub shadow: Option<ShadowView>,
    /// Why the last decision was made.
    pub reasons: Vec<Reason>,
    /// Conditions of use.
    pub conditions: Vec<Condition>,
}

/// How far a stage is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProgressView {
    /// The stage.
    pub stage: Stage,
    /// What is being done.
    pub what: String,
    /// Done.
    pub done: u64,
    /// Of.
    pub budget: u64,
    /// When the stage began, virtual ms.
    pub since_ms: u64,
    /// What would end it early, one sentence.
    pub early: String,
}

/// Paired episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairsView {
    /// Pairs.
    pub n: u64,
    /// Means of the active version.
    pub active: Signature,
    /// Means of the candidate.
    pub candidate: Signature,
    /// Two-sided 95 % Wilson interval of the candidate's success.
    pub candidate_success: [f64; 2],
    /// Two-sided 95 % Wilson interval of the active version's success.
    pub active_success: [f64; 2],
}

/// Shadow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShadowView {
    /// Sequences.
    pub n: u64,
    /// Mean output divergence.
    pub output: f64,
    /// Share of sequences in which the twin raised a governance signal and the live world did not, less the reverse.
    pub governance: f64,
    /// Mean envelope divergence.
    pub envelope: f64,
    /// The profile's limits of the three; absent where one decides nothing by itself.
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
    /// Its seed.
    pub seed: u64,
    /// What the live world showed that the twin did not, and the reverse, in words.
    pub text: String,
    /// Output divergence.
    pub output: f32,
}

/// Something that waits for people.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PromptView {
    /// Its id.
    pub id: String,
    /// What is to be approved.
    pub version: CapabilityId,
    /// What it would replace.
    pub replaces: Option<CapabilityId>,
    /// Digest of manifest and bundle.
    pub candidate: Digest,
    /// Row version.
    pub row_version: u64,
    /// Digest of the evidence.
    pub evidence: Digest,
    /// Digest of profile and policies.
    pub policy: Digest,
    /// The profile.
    pub profile: ProfileName,
    /// Distinct people needed.
    pub needed: u32,
    /// Who has approved.
    pub approved_by: Vec<String>,
    /// Until when, virtual ms.
    pub deadline_ms: u64,
    /// Until when a decision signed now is good, virtual ms.
    pub valid_until_ms: u64,
    /// The store it belongs to.
    pub store_id: String,
    /// When people were asked, virtual ms.
    pub asked_ms: u64,
    /// How much friction a decision needs (0, 1 or 2; reference A6).
    pub tier: u8,
    /// Who made the candidate, and so cannot approve it.
    pub author: String,
    /// Permissions that the active version does not have.
    pub new_permissions: Vec<String>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
    /// What happens when it gets worse after activation, one sentence.
    pub on_drift: String,
}

/// An alarm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmView {
    /// Which.
    pub alarm: String,
    /// What it is about.
    pub subject: String,
    /// Its state.
    pub state: AlarmState,
    /// Its priority.
    pub priority: Priority,
    /// One sentence.
    pub text: String,
    /// Since when, virtual ms.
    pub since_ms: u64,
    /// The state below a shelf; as `state` where there is none.
    pub state_below: AlarmState,
    /// Whether it stays until reset.
    pub latching: bool,
    /// Who has acknowledged it.
    pub acknowledged_by: Option<String>,
    /// Who set it aside, why, and until when, virtual ms.
    pub shelf: Option<(String, String, u64)>,
    /// How often it was raised since it was last normal.
    pub raises: u32,
    /// Whether it comes so often that it is one row with a count.
    pub chattering: bool,
}

/// The live world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LiveView {
    /// Sequences worked.
    pub sequences: u64,
    /// Of the last fifty: whole sequences done.
    pub recent_success: Option<f64>,
    /// Of how many that is.
    pub recent: u64,
    /// The last sequence.
    pub last: Vec<TaskSummary>,
    /// The drift that has set in.
    pub drift: Option<Drift>,
    /// What is broken.
    pub fault: Option<LiveFault>,
    /// Simulated seconds in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Success of the last sequences, the newest last; at most fifty.
    pub outcomes: Vec<bool>,
    /// Monitors of provisional and restricted versions.
    pub monitors: Vec<MonitorView>,
}

/// A monitor's charts against their limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MonitorView {
    /// The version it watches.
    pub version: CapabilityId,
    /// Episodes watched.
    pub episodes: u32,
    /// Episodes of the provisional window.
    pub needed: u32,
    /// Whether it has tightened the envelope.
    pub restricted: bool,
    /// Each chart's name, where it stands and its limit.
    pub charts: Vec<(String, f64, f64)>,
}
