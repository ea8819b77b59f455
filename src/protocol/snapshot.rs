//! How things stand, for whoever looks: everything a screen needs, nothing that grants anything.
//!
//! What has not been measured is absent, never zero.

use std::cmp::Reverse;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::caller::Caller;
use super::detail::Changes;
use super::event::{DimensionResult, TaskSummary};
use super::picture::Scenery;
use super::seat::SeatView;
use holdpoint_approvals::Nonce;
use holdpoint_body::rehearsal::{Drift, LiveFault};
use holdpoint_governance::alarms::{AlarmState, AlarmSummary, Priority};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::evidence::{Drills, Signature, StaleCause};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Flags, Stage, State};
use holdpoint_governance::metrics::observed::ObservedCounts;
use holdpoint_governance::profile::{ProfileName, SiteName};
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_governance::vocabulary::Deployability;
use holdpoint_governance::wall_time::{ClockDoubt, WallTime};

pub use super::purpose::Purpose;

/// How everything stands at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Snapshot {
    /// Virtual time at which it was taken, ms.
    pub at_ms: u64,
    /// The machine's time then, ms since 1970; absent in scripts, which know none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_ms: Option<i64>,
    /// The time that people's deadlines are held against; a script has one of its own.
    #[serde(default)]
    pub time: WallTime,
    /// Why the machine's clock is not believed: nothing is activated until a person confirms the time. Absent if it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock_doubt: Option<ClockDoubtView>,
    /// Profile that everything is judged under.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// Name of the robot's description.
    pub robot: String,
    /// Seed of the run: every disturbance and every choice follows from it.
    pub seed: u64,
    /// Digest of profile and policies.
    pub policy: Digest,
    /// Hash of the agent's identity; upgrades do not change it.
    pub agent: Digest,
    /// How far the record was read; absent once every row was held against all of it. Before that nothing shown here is
    /// verified, and nothing is carried out but a stop.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading: Option<ReadingView>,
    /// What a request that gives or widens authority is signed over; absent where nobody signs requests: in a script,
    /// and before the record was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signing: Option<SigningView>,
    /// Why the engine holds after a fault of its own; absent if it does not.
    pub holding: Option<String>,
    /// Who stopped the cell, and since when; absent while it works.
    pub stopped: Option<StoppedView>,
    /// Why nothing becomes active and the arm stands: no administrator authorized the profile as this program has it. Absent
    /// where one did, or none has to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unauthorized: Option<String>,
    /// Every family in the store, sorted by name.
    pub families: Vec<FamilyView>,
    /// Every version that is not history, the newest last.
    pub candidates: Vec<CandidateView>,
    /// Questions that wait for people: about activations, releases and reviews.
    pub prompts: Vec<PromptView>,
    /// Versions that people or the calendar hold back, and that one person may let in by the emergency door.
    #[serde(default)]
    pub emergencies: Vec<PromptView>,
    /// Monitors' questions that wait for an answer.
    pub questions: Vec<QuestionView>,
    /// Alarms that are not normal, in the order of attention.
    pub alarms: Vec<AlarmView>,
    /// Counts for the status line.
    pub alarm_summary: AlarmSummary,
    /// What the live world is doing.
    pub live: LiveView,
    /// What stands round the robot and does not move.
    pub scenery: Scenery,
    /// The profile's limits of kappa I, P, B, R.
    pub thresholds: [f64; 4],
    /// What this engine has counted of the metrics since it came up; `holdpoint metrics` reads the whole store.
    #[serde(default)]
    pub observed: ObservedCounts,
    /// Who looks at this engine, in the order of sitting down.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seats: Vec<SeatView>,
    /// The engine was begun by a console and ends in good order once nobody has sat at it for so long, s; absent if it goes
    /// on with nobody.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ends_alone_s: Option<u64>,
}

impl Snapshot {
    /// The time that people's deadlines are held against when the engine's clock stands at `at_ms`, if the wall clock is not
    /// set before.
    #[must_use]
    pub const fn time_at(&self, at_ms: u64) -> WallTime {
        self.time.plus_ms(at_ms.saturating_sub(self.at_ms))
    }
}

/// A machine's clock that is not believed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ClockDoubtView {
    /// Why.
    pub doubt: ClockDoubt,
    /// The same in a sentence.
    pub text: String,
    /// What the clock says: what a person confirms, or sets right first.
    pub said: WallTime,
}

/// What a signature under a request is bound to, beside the request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SigningView {
    /// Whether a command that gives or widens authority is refused without a signature.
    pub required: bool,
    /// The store.
    pub store_id: String,
    /// This life of the engine; what was signed in another counts for nothing.
    pub life: Nonce,
    /// Virtual time at which a signature that is made now may expire at the latest, ms.
    pub until_ms: u64,
}

/// How far an engine that comes up has read its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ReadingView {
    /// Records that were read and held against their hashes.
    pub read: u64,
    /// Records there are, by the store's own word.
    pub of: u64,
}

impl std::fmt::Display for ReadingView {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "not verified yet: {} of {} records read", self.read, self.of)
    }
}

/// A cell that a person stopped.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StoppedView {
    /// Who stopped it, as they called themselves.
    pub by: String,
    /// Whose process asked, as the system has it.
    pub caller: Caller,
    /// Why, in the person's own words; may be empty.
    pub reason: String,
    /// Virtual time since when, ms.
    pub since_ms: u64,
    /// Ticks from the request to the standing arm; absent until every joint stands.
    pub stood_after_ticks: Option<u64>,
    /// Who stopped it again since, by the time of each one's last stop: the last [`STOPS_NAMED_MAX`] of them.
    #[serde(default)]
    pub again: Vec<StopAgain>,
    /// How many more times it was stopped again, between the first and those.
    #[serde(default)]
    pub unnamed: u64,
    /// How many times it was stopped since it last worked, the first included; whoever lets it work again says how many
    /// of them they know of.
    #[serde(default)]
    pub stops: u64,
}

/// The most people that are named as having stopped a cell again that was stopped already.
pub const STOPS_NAMED_MAX: usize = 4;

/// A stop of a cell that was stopped already. Whoever lets it work again answers for this one too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StopAgain {
    /// Who stopped it, as they called themselves.
    pub by: String,
    /// Whose process asked, as the system has it.
    pub caller: Caller,
    /// Why, in the person's own words; may be empty.
    pub reason: String,
    /// Virtual time of it, ms.
    pub at_ms: u64,
}

impl StoppedView {
    /// A stop that nobody has added to yet; the arm may still move.
    #[must_use]
    pub const fn first(by: String, caller: Caller, reason: String, since_ms: u64) -> Self {
        Self {
            by,
            caller,
            reason,
            since_ms,
            stood_after_ticks: None,
            again: Vec::new(),
            unnamed: 0,
            stops: 1,
        }
    }

    /// Somebody stops the stopped cell. The same one with the same reason is named once, at the last time.
    pub fn note_again(&mut self, stop: StopAgain) {
        let is_same =
            |one: &StopAgain| one.by == stop.by && one.caller == stop.caller && one.reason == stop.reason;
        self.stops += 1;
        self.again.retain(|one| !is_same(one));
        self.again.push(stop);
        if self.again.len() > STOPS_NAMED_MAX {
            self.again.remove(0);
            self.unnamed += 1;
        }
    }

    /// Virtual time of the last stop, ms.
    #[must_use]
    pub fn last_ms(&self) -> u64 {
        self.again.last().map_or(self.since_ms, |stop| stop.at_ms)
    }
}

/// A monitor's question: people are needed, or the version is rolled back at the deadline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct QuestionView {
    /// The active version it is about.
    pub version: CapabilityId,
    /// Why the monitor asks, the deciding reason first.
    pub reasons: Vec<Reason>,
    /// Virtual time at which an unanswered question becomes a rollback, ms.
    pub deadline_ms: u64,
}

/// A family as it stands: who is in control, and what may take over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FamilyView {
    /// Name of the family, e.g. `grasp`.
    pub family: Family,
    /// The active version; absent while safe-stopped.
    pub active: Option<CapabilityId>,
    /// The version that takes over if the active one is rolled back.
    pub pinned: Option<CapabilityId>,
    /// Nobody is in control until an operator re-arms the family.
    pub safe_stopped: bool,
    /// The active version's flags; absent without one.
    pub flags: Option<Flags>,
    /// Episodes of the provisional window: worked and needed.
    pub provisional: Option<(u32, u32)>,
    /// The emergency activation that nobody has reviewed yet; nothing of the family is promoted before.
    #[serde(default)]
    pub review: Option<ReviewView>,
}

/// An emergency activation (break-glass) that two people still have to review.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ReviewView {
    /// The version that one person let in; it may have left meanwhile.
    pub version: CapabilityId,
    /// By when it has to be reviewed, or it is taken off.
    pub until: WallTime,
    /// Whether that time is over; the review stays open.
    pub overdue: bool,
}

/// A candidate (or a version that was one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateView {
    /// The version this row is about.
    pub version: CapabilityId,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// The lifecycle state it is in.
    pub state: State,
    /// The state it was in before; absent while it is in its first.
    pub left: Option<State>,
    /// The stage that ran when it left that state; absent if none did.
    #[serde(default)]
    pub ran: Option<Stage>,
    /// Whether it ever passed its provisional window.
    pub confirmed: bool,
    /// Stage running, pauses, questions, restrictions.
    pub flags: Flags,
    /// Counts every change of the version's row; approvals name it.
    pub row_version: u64,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// How the version came about, as the submission has it.
    pub provenance: Provenance,
    /// Risk tier, as the submission estimates it.
    pub risk: Risk,
    /// How far the running stage is; absent if none is running.
    pub progress: Option<ProgressView>,
    /// The four dimensions as they were last assessed, in the order I, P, B, R.
    pub dimensions: Vec<DimensionResult>,
    /// The composite score of the four dimensions; reported, never gating.
    pub composite: Option<f64>,
    /// Paired episodes so far; absent before there are any to compare.
    pub pairs: Option<PairsView>,
    /// Drills so far: the candidate's and the active version's.
    pub drills: Option<(Drills, Drills)>,
    /// Shadow sequences so far; absent before the first.
    pub shadow: Option<ShadowView>,
    /// Why the last decision was made, the deciding reasons first.
    pub reasons: Vec<Reason>,
    /// Conditions under which it may be used.
    pub conditions: Vec<Condition>,
    /// Which of the paper's four deployment outcomes it comes to so far; absent before the first decision.
    #[serde(default)]
    pub deployment: Option<Deployability>,
    /// It is not gone on with by itself, because the gate holds it or nobody answered; resuming lets it go on.
    #[serde(default)]
    pub held: bool,
    /// Profiles that are closed to it by a profile demotion.
    #[serde(default)]
    pub closed: Vec<ProfileName>,
    /// Why what was measured of it does not count any more; empty while it does. The numbers beside it are those of
    /// then.
    #[serde(default)]
    pub stale: Vec<StaleCause>,
}

impl CandidateView {
    /// That its evidence does not count, and why; absent while it does.
    #[must_use]
    pub fn stale_line(&self) -> Option<String> {
        if self.stale.is_empty() {
            return None;
        }
        let causes: Vec<&str> = self.stale.iter().map(|cause| cause.name()).collect();
        Some(format!("STALE, measured under another {}", causes.join(", ")))
    }
}

/// How far the running stage is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProgressView {
    /// The stage that is running.
    pub stage: Stage,
    /// What is being worked, e.g. episode pairs or drills.
    pub what: String,
    /// Episodes, drills or sequences that are done.
    pub done: u64,
    /// How many there are in all; an early end may come before.
    pub budget: u64,
    /// When the stage began, virtual ms.
    pub since_ms: u64,
    /// What would end it early, one sentence.
    pub early: String,
}

/// Paired episodes of a sandbox evaluation so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairsView {
    /// Pairs worked so far.
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
    /// Whole sequences worked so far.
    pub n: u64,
    /// Mean distance of the candidate's commands from the active version's, 0 to 1 of range.
    pub output: f64,
    /// Share of sequences in which the twin raised a governance signal and the live world did not, less the reverse.
    pub governance: f64,
    /// Mean share of the twin's trajectory outside the active version's band, 0 to 1.
    pub envelope: f64,
    /// The profile's limits of the three; absent if one decides nothing by itself.
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
    /// What the live world showed that the twin did not, and the reverse, in words.
    pub text: String,
    /// Distance of the candidate's commands from the active version's in this sequence, 0 to 1 of range.
    pub output: f32,
}

/// A question that waits for people.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PromptView {
    /// Identifies the question among those that wait.
    pub id: String,
    /// The candidate that would be activated.
    pub version: CapabilityId,
    /// The active version it would replace; absent if there is none.
    pub replaces: Option<CapabilityId>,
    /// Digest of the candidate's manifest and bundle; the signature covers it.
    pub candidate: Digest,
    /// The candidate's row version when people were asked; a decision names it.
    pub row_version: u64,
    /// Digest of the evidence the decision is over; the signature covers it.
    pub evidence: Digest,
    /// Digest of profile and policies; the signature covers it.
    pub policy: Digest,
    /// Profile that the activation would be under.
    pub profile: ProfileName,
    /// Its own name, if it does not come with the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// Distinct people who have to approve.
    pub needed: u32,
    /// Whether enough people approved: it takes over when the sequence that runs is over.
    #[serde(default)]
    pub granted: bool,
    /// Identities whose approvals count so far.
    pub approved_by: Vec<String>,
    /// Whether it takes a safety officer's approval, and none of them has approved.
    #[serde(default)]
    pub officer_missing: bool,
    /// When the unanswered question becomes a hold, also while no engine runs.
    pub until: WallTime,
    /// Until when a decision signed now is good.
    pub valid_until: WallTime,
    /// Id of the store; a decision signed for it counts in no other.
    pub store_id: String,
    /// When people were asked.
    pub asked: WallTime,
    /// How much friction a decision needs (0, 1 or 2; reference A6).
    pub tier: u8,
    /// Who made the candidate and how far that is known, e.g. `ada (unverified)`; they cannot approve it.
    pub author: String,
    /// Who registered the candidate, and so cannot approve it.
    #[serde(default)]
    pub requester: Requester,
    /// Its risk class with the causes; absent before it was assessed, which counts as high.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub risk: Option<RiskClass>,
    /// Permissions that the active version does not have, or has at a lower level.
    pub new_permissions: Vec<String>,
    /// The whole difference to the active version.
    #[serde(default)]
    pub changes: Changes,
    /// What it would be let in under, one sentence each.
    #[serde(default)]
    pub conditions: Vec<String>,
    /// What decided on behaviour and recovery, with the numbers, and which work shows it; one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub why: Vec<String>,
    /// What was not tested, one sentence each.
    pub untested: Vec<String>,
    /// What happens when it gets worse after activation, one sentence.
    pub on_drift: String,
    /// What is asked.
    #[serde(default)]
    pub purpose: Purpose,
    /// What a release or a review is about, one sentence; empty for an activation.
    #[serde(default)]
    pub about: String,
    /// The question as whoever looks on reads it. Who signs gets lines of their own
    /// ([`Command::Question`](crate::command::Command::Question)); where these change, it is another question.
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
    /// The state that is shown: a shelf covers every other.
    pub state: AlarmState,
    /// How soon an operator has to act.
    pub priority: Priority,
    /// What is wrong, one sentence for the operator.
    pub text: String,
    /// Virtual time of the first raise since it was last normal, ms.
    pub since_ms: u64,
    /// The state below a shelf; as `state` if there is none.
    pub state_below: AlarmState,
    /// Whether it stays after its condition has ended, until it is reset.
    pub latching: bool,
    /// Identity that acknowledged it; absent while it calls for attention.
    pub acknowledged_by: Option<String>,
    /// Who set it aside, why, and until when.
    pub shelf: Option<(String, String, WallTime)>,
    /// How often it was raised since it was last normal.
    pub raises: u32,
    /// Whether it comes so often that it is one row with a count.
    pub chattering: bool,
}

impl AlarmView {
    /// Its place in the order of attention, the least first: the more urgent; of these what nobody has acknowledged;
    /// of these what is still there; of these the newest.
    #[must_use]
    pub const fn attention(&self) -> (Priority, bool, bool, Reverse<u64>) {
        (self.priority, !self.state.calls(), !self.state.is_present(), Reverse(self.since_ms))
    }
}

impl Snapshot {
    /// The alarm that is told first where there is room for one; absent if every alarm is normal or set aside.
    #[must_use]
    pub fn foremost_alarm(&self) -> Option<&AlarmView> {
        foremost(self.alarms.iter())
    }
}

fn foremost<'a>(alarms: impl Iterator<Item = &'a AlarmView>) -> Option<&'a AlarmView> {
    let told = alarms.filter(|alarm| match alarm.state {
        AlarmState::Unacknowledged
        | AlarmState::ReturnedUnacknowledged
        | AlarmState::Acknowledged
        | AlarmState::Latched => true,
        AlarmState::Normal | AlarmState::Shelved => false,
    });
    told.min_by_key(|alarm| alarm.attention())
}

/// What the live world is doing, and how it went lately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LiveView {
    /// Whole sequences worked in this engine's life.
    pub sequences: u64,
    /// Of the last fifty: whole sequences done.
    pub recent_success: Option<f64>,
    /// Over how many sequences that share is.
    pub recent: u64,
    /// The tasks of the last sequence, in the order of work.
    pub last: Vec<TaskSummary>,
    /// The drift that has set in; absent if there is none.
    pub drift: Option<Drift>,
    /// What is broken at present, for a rehearsal.
    pub fault: Option<LiveFault>,
    /// What the agent works towards, in the words of its goal interpreter; empty in snapshots of older builds.
    #[serde(default)]
    pub goal: String,
    /// Simulated seconds in a second; absent for as fast as it computes.
    pub pace: Option<f64>,
    /// Success of the last sequences, the newest last; at most fifty.
    pub outcomes: Vec<bool>,
    /// Monitors of the versions that are provisional or restricted.
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
    /// Each chart's name, its value and its limit.
    pub charts: Vec<(String, f64, f64)>,
    /// The factor that a condition puts on the profile's limits; 1 without one. The limits above have it in them.
    #[serde(default = "plain")]
    pub factor: f64,
    /// Whether the first warning takes the version off without asking.
    #[serde(default)]
    pub coupled: bool,
}

#[cfg(test)]
mod tests;
