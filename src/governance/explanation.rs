//! What an explanation states of a decision: closed sets and typed values, of which sentences are made.
//!
//! Owns no sentence and computes nothing. The engine fills in the values from the record, and the crate `holdpoint-wording`
//! makes the sentences. No record contains these values.

mod summary;

pub use summary::{
    ActiveTerms, Approver, DecisiveReason, EvidenceExtent, ExplanationSummary, FailureCounts, PassedCheck,
    PendingStep, RecordMoment, SummaryRemark, TwinFailures, VersionPosition,
};

use holdpoint_body::CodeFault;
use holdpoint_body::disturbance::Drift;

use super::approval::{ApprovalDecision, Role};
use super::behavior::{
    BehaviorComponent, ComponentName, HarmComparison, SequenceComparison, SequenceMeasure,
};
use super::cached_result::{CacheLocation, CachedResultUse};
use super::closed_set::Lenient;
use super::decision::{Dimension, Kappa, Reason};
use super::evidence::{DrillKind, DrillTally};
use super::finding::Finding;
use super::harm::HarmKind;
use super::ids::CapabilityId;
use super::lifecycle::State;
use super::notice::NoticeOrText;
use super::past_limit::MeasuredInTask;
use super::permission::PeakQuantity;
use super::phase::WorkPhase;
use super::record::RecordKind;
use super::rollback::{Rung, RungFailure, TriggerKind};

/// What a reason on record found, with its number and its limit. The code of the reason may be of another build.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReasonContent {
    /// The finding; absent in records of older builds, and for a finding of another build.
    pub finding: Option<Finding>,
    /// The sentence in a record of an older build; empty otherwise.
    pub older_text: String,
    /// The measured value; absent if there is none.
    pub evidence: Option<f64>,
    /// The limit the value was compared with; absent if there is none.
    pub limit: Option<f64>,
}

impl From<&Reason> for ReasonContent {
    fn from(reason: &Reason) -> Self {
        Self {
            finding: reason.finding.clone(),
            older_text: reason.older_text.clone(),
            evidence: reason.evidence,
            limit: reason.limit,
        }
    }
}

crate::closed_set! {
    /// A change that removes a reason, known from the code of the reason alone.
    RemedyAction, "remedy", {
        /// The version does no more harm than the active version, beyond the margin.
        CauseNoMoreHarm = "cause-no-more-harm",
        /// The significant worsenings, each within its margin, are smaller together.
        ReduceSum = "reduce-sum",
        /// Be no worse than the family's anchor.
        MatchAnchor = "match-anchor",
        /// A person reviews the tries of the family, then the sandbox is repeated.
        ReviewTries = "review-tries",
        /// The version leaves arm and object as the skills after it need them.
        PreserveHandover = "preserve-handover",
        /// The manifest declares every request of the code, or the code requests no more.
        DeclareRequests = "declare-requests",
        /// The next stage measures it.
        RunNextStage = "run-next-stage",
        /// More paired episodes are run.
        RunMoreEpisodes = "run-more-episodes",
        /// The code takes less processor time in a tick, or the manifest declares more.
        TakeLessTickTime = "take-less-tick-time",
        /// The evaluation takes less wall time, or runs again with a new budget.
        TakeLessEvaluationTime = "take-less-evaluation-time",
        /// The manifest declares every used permission, and no hard stop occurs.
        AvoidHardStop = "avoid-hard-stop",
        /// The drills pass in the phase, too.
        PassDrillsInPhase = "pass-drills-in-phase",
        /// The drills pass as often as those of the active version.
        PassDrillsAsOften = "pass-drills-as-often",
        /// The missing evidence is supplied.
        SupplyEvidence = "supply-evidence",
        /// The code exports the hook.
        ExportHook = "export-hook",
        /// The manifest binds a fallback that is registered and may take over.
        BindFallback = "bind-fallback",
        /// The cell is repaired, and the sandbox repeated.
        RepairCell = "repair-cell",
        /// The manifest declares failure signals that the watcher knows.
        DeclareKnownSignals = "declare-known-signals",
        /// The rollback target loads with its recorded digest.
        RestoreTarget = "restore-target",
        /// The version number rises by more.
        RaiseVersionNumber = "raise-version-number",
        /// The submission declares the change of the interface.
        DeclareInterfaceChange = "declare-interface-change",
        /// Manifest and code agree.
        AlignManifestAndCode = "align-manifest-and-code",
        /// The manifest names a dependency that the registry can meet.
        NameMetDependency = "name-met-dependency",
        /// The field is declared as before.
        DeclareAsBefore = "declare-as-before",
        /// The field is declared as the active version does.
        DeclareAsActive = "declare-as-active",
        /// A policy covers the mode, or the manifest does not reach it.
        CoverByPolicy = "cover-by-policy",
        /// The manifest does not reach the mode.
        ExcludeMode = "exclude-mode",
        /// The manifest declares the permission, or the code does not use it.
        DeclarePermission = "declare-permission",
        /// The manifest admits this profile.
        AdmitProfile = "admit-profile",
        /// The manifest asks for less, or people review it.
        RequestLess = "request-less",
        /// The version is registered again and approved.
        RegisterAgain = "register-again",
        /// Approvers answer by the deadline.
        AnswerRequest = "answer-request",
        /// A person confirms the time.
        ConfirmTime = "confirm-time",
        /// The freeze ends.
        EndFreeze = "end-freeze",
        /// An administrator signs the profile.
        SignProfile = "sign-profile",
        /// An improvement is significant.
        Improve = "improve",
        /// The stages are run again under the present context.
        RunStagesAgain = "run-stages-again",
        /// The twin has no more policy hits and watcher events than the live cell.
        MatchLiveSignals = "match-live-signals",
        /// The version is no worse than the one before it under the conditions of the live cell.
        MatchPredecessorLive = "match-predecessor-live",
        /// The live behavior matches the twins of shadow.
        MatchTwins = "match-twins",
        /// The live behavior matches the sandbox, or the version is evaluated where the two differ.
        MatchSandbox = "match-sandbox",
        /// Nothing: the reason only makes shadow longer.
        WaitForShadow = "wait-for-shadow",
        /// No safety event occurs.
        AvoidSafetyEvents = "avoid-safety-events",
        /// Shadow runs longer.
        RunShadowLonger = "run-shadow-longer",
        /// The version it depends on becomes active first.
        ActivateDependency = "activate-dependency",
        /// The manifest admits other profiles.
        AdmitOtherProfiles = "admit-other-profiles",
        /// The rate stays as it was measured before activation.
        KeepRate = "keep-rate",
        /// Telemetry arrives.
        DeliverTelemetry = "deliver-telemetry",
        /// An operator answers an escalation by its deadline.
        AnswerEscalation = "answer-escalation",
        /// Nothing: an operator requested it.
        OperatorDecides = "operator-decides",
    }
}

/// What would remove a reason, or let a rung of the ladder succeed.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum Remedy {
    /// This action; the finding adds nothing to it.
    Act(RemedyAction),
    /// This action on what was found.
    ActOn(RemedyAction, ReasonContent),
    /// What was found is the case no longer; the code names no action.
    Resolve(ReasonContent),
    /// The worsening of a component lies within its margin. `fewer`: the episodes that have to be better; absent for
    /// what is not counted by episode, or cannot be reached.
    WorsenLess { component: BehaviorComponent, fewer: Option<EpisodeReduction> },
    /// A worsening within its margin is not significant any more: for this component the rules accept none.
    EndSignificance(BehaviorComponent),
    /// The manifest declares what the code asks for, or the code asks for no more than is declared.
    RaiseDeclaration { quantity: PeakQuantity, asked: f64, declared: f64 },
    /// More rollback drills pass.
    PassRollbackDrills { passed: u32, all: u32, needed: u32 },
    /// Recovery, as measured, rises to the least that is needed, first in the drills that pass least often.
    StrengthenRecovery { weakest: DrillKind, tally: DrillTally, recovery: Option<f64>, least: Option<f64> },
    /// More operators approve.
    Approve { missing: u32 },
    /// The condition under which a failed rung of the ladder succeeds is met.
    RepairRung(RungFailure),
}

/// How many episodes have to be better for a bound to lie within its margin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EpisodeReduction {
    /// Episodes that may not be worse any more.
    pub fewer: u64,
    /// All episodes.
    pub of: u64,
}

/// What the stored evidence measured for a reason, beyond the numbers of the reason.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum ReasonMeasurement {
    /// A component of behavior with its bounds, over episode pairs.
    Component { component: BehaviorComponent, pairs: u32 },
    /// Drills of both versions: every kind that was carried out, then the phases in which the candidate failed.
    Drills(Vec<DrillComparison>),
    /// Whole sequences in shadow.
    ShadowSequences(u32),
}

/// Drills of one kind with both versions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrillComparison {
    /// The kind of drill.
    pub kind: DrillKind,
    /// The phase in which they began; absent: all phases.
    pub phase: Option<WorkPhase>,
    /// The candidate's.
    pub candidate: DrillTally,
    /// The active version's.
    pub active: DrillTally,
}

/// A remark in the explanation of a decision that is no reason of a rule.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum DecisionRemark {
    /// A person answered an approval request in a role, for this reason.
    Answer { person: String, role: Role, answer: ApprovalDecision, reason: String },
    /// A person or a deadline changed the state.
    StateChange(NoticeOrText),
    /// What triggered a rollback, at which virtual tick of the live world. `measured`: the live task of a safety
    /// event.
    RollbackTrigger { kind: TriggerKind, tick: u64, notice: NoticeOrText, measured: Option<MeasuredInTask> },
    /// How fast a rollback was: until every joint was at standstill and until the rollback target took over, each
    /// absent if that never happened; and the motion after the trigger.
    RollbackTimes { safe_ms: Option<u64>, restored_ms: Option<u64>, unsafe_continuation_ms: u64 },
    /// How a rung of the ladder ended; without a failure it succeeded.
    RungEnd { rung: Rung, failure: Option<RungFailure>, ms: u64, notice: NoticeOrText },
}

impl DecisionRemark {
    /// The part of the rules it concerns.
    #[must_use]
    pub const fn dimension(&self) -> Dimension {
        match self {
            Self::Answer { .. } | Self::StateChange(_) => Dimension::Approval,
            Self::RollbackTrigger { .. } => Dimension::Monitor,
            Self::RollbackTimes { .. } | Self::RungEnd { .. } => Dimension::Recovery,
        }
    }
}

/// What followed a decision, as one record states it.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum Consequence {
    /// The state of the version changed.
    StateChanged { from: State, to: State },
    /// Approvers were asked.
    ApproversAsked,
    /// The record of the upgrade was closed.
    UpgradeRecordClosed,
    /// The version was blocked or unblocked under profiles.
    ProfilesSet,
    /// A person paused or resumed the version, or lifted its restriction: who and why.
    PersonActed(NoticeOrText),
    /// A person made it its family's anchor.
    AnchorSet,
    /// A person reviewed the tries of its family.
    TriesReviewed,
    /// One person activated it by break-glass.
    BreakGlassUsed,
    /// Approvers reviewed the activation by break-glass.
    BreakGlassReviewed,
    /// The version was found suspicious for these reasons.
    ConcernFound(Vec<Reason>),
    /// The version was re-evaluated, under a drift of the live cell if there was one: the result, then the findings
    /// against the version.
    ReEvaluated { drift: Option<Drift>, reasons: Vec<Reason> },
    /// A confirmation used cached results.
    ConfirmationCached(CachedResultUse),
    /// Cached results differed when they were run again.
    CacheVoided { place: CacheLocation, differing: u64, rerun: u64 },
    /// This build cannot read the record.
    Unreadable { kind: Lenient<RecordKind> },
}

/// The fact that decided a check.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum DecidingFact {
    /// This speaks against the version. `reason`: the first of the rules; absent where it states the same.
    Against { finding: CheckFinding, reason: Option<CheckReason> },
    /// Nothing speaks against the version.
    InFavor { kappa: Option<Kappa>, support: Support },
    /// Nothing is measured yet: the sandbox does that.
    NotMeasured,
}

/// Why nothing speaks against a version.
#[derive(Clone, Debug, PartialEq)]
pub enum Support {
    /// This comes nearest to its limit.
    NearestToLimit(CheckFinding),
    /// The first reason of the rules.
    Reason(CheckReason),
    /// Nothing was found.
    NoFinding,
}

/// A reason as a check states it.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckReason {
    /// What the reason found, with its numbers.
    pub content: ReasonContent,
    /// The fault of confined code that counts as a passed budget, for a hard stop of the sandbox.
    pub overrun: Option<CodeFault>,
}

/// Something that was found in a check.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum CheckFinding {
    /// A component of behavior.
    Component(ComponentFinding),
    /// A measure of harm.
    Harm(HarmComparison),
    /// A comparison of whole sequences. `bound` makes the verdict; absent where the mean does.
    Sequences { comparison: SequenceComparison, bound: Option<DecidingBound> },
    /// Drills of one kind.
    Drills(DrillComparison),
    /// A reason of the rules.
    Reason(CheckReason),
}

/// A component of behavior, counted or averaged over the episodes. A larger value is worse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComponentFinding {
    /// The component.
    pub name: ComponentName,
    /// The values of both versions.
    pub values: ComponentValues,
    /// The accepted worsening.
    pub tolerance: f64,
    /// The bound that makes the verdict; absent where the mean does.
    pub bound: Option<DecidingBound>,
}

/// A component of behavior in the episodes of both versions.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum ComponentValues {
    /// The number of episodes, of all, in which it is bad.
    Episodes { candidate: usize, active: usize, of: usize },
    /// The mean over the episodes.
    Mean { candidate: f64, active: f64 },
}

/// The bound that makes a verdict where the mean lies within the margin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DecidingBound {
    /// At least this worsening is established.
    Established(f64),
    /// Up to this worsening is not excluded.
    NotExcluded(f64),
    /// So few episodes exclude nothing.
    Unbounded,
}

/// What a row of measured values is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MeasuredQuantity {
    /// A component of behavior.
    Component(ComponentName),
    /// A measure of harm, in its unit.
    Harm(HarmKind),
    /// A comparison of whole sequences.
    Sequences(SequenceMeasure),
    /// A metric of a mode of the sandbox, by its name on record.
    Metric(String),
    /// The 95th percentile of a metric, by its name on record.
    Percentile95(String),
}

crate::closed_set! {
    /// What one world of shadow had and the other had not.
    ShadowEvent, "event of shadow", {
        /// Success.
        Success = "success",
        /// A command that policy denied or clamped.
        PolicyHit = "policy-hit",
        /// A failure that the watcher named.
        WatcherEvent = "watcher-event",
    }
}

/// How the two worlds of shadow differed in one sequence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ShadowDifference {
    /// What the twin alone had.
    pub twin: Vec<ShadowEvent>,
    /// What the live world alone had.
    pub live: Vec<ShadowEvent>,
}

impl ShadowDifference {
    /// Whether both worlds had the same.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.twin.is_empty() && self.live.is_empty()
    }
}

/// What a verification of a whole audit chain checked, where it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VerifiedChain {
    /// Checkpoints.
    pub checkpoints: u64,
    /// Whether a public key was there to check their signatures with.
    pub signatures_checked: bool,
    /// Approvals.
    pub approvals: u64,
    /// Sealed batches of telemetry.
    pub batches: u64,
}

crate::closed_set! {
    /// A field of a lookup that takes a text.
    SearchField, "field of a lookup", {
        /// The text that is looked for in the registry.
        Text = "text",
        /// The subject of records of the audit log.
        Subject = "subject",
    }
}

/// Why a lookup in the registry or in the audit log is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum LookupRefusal {
    /// The registry has no such version.
    UnknownVersion(CapabilityId),
    /// The text that is looked for is longer than is allowed.
    TextTooLong { field: SearchField, bytes: usize, max: usize },
}
