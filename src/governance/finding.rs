//! What a rule found: a closed set of findings, each with the values that a sentence about it needs.
//!
//! Owns no sentence. The crate `holdpoint-wording` makes one of each finding; records keep the finding and its numbers.

use serde::{Deserialize, Serialize};

use super::behavior::{ComponentName, SequenceMeasure};
use super::cell_ability::CellAbility;
use super::decision::{Dimension, ReasonCode};
use super::distribution_shift::ShiftSignal;
use super::early_stop::EarlyStopReason;
use super::evidence::{DrillKind, HardStop};
use super::harm::HarmKind;
use super::ids::{CapabilityId, Family};
use super::mode::{ModeKey, RequiredCommand};
use super::monitor::{Rate, SafetyEvent};
use super::outcome::BehaviorOutcome;
use super::phase::WorkPhase;
use super::profile::ProfileName;
use super::submission::InterfaceChange;
use super::wall_time::{ClockMismatch, WallTime};
use holdpoint_body::{FailureSignal, TaskKind};

pub use vote_flaw::VoteFlaw;

mod vote_flaw;

crate::closed_set! {
    /// Part of an interface that has fields.
    FieldPart, "part of an interface", {
        /// An input of a call.
        Input = "input",
        /// A parameter of a call.
        Parameter = "parameter",
        /// An output of a call.
        Output = "output",
    }
}

crate::closed_set! {
    /// How a field of a candidate breaks calls that were written for the active version.
    FieldBreak, "break of a field", {
        /// It is new and required, and a default is declared that no caller supplies.
        RequiredWithDefault = "required-with-default",
        /// It is new and required, without a default.
        RequiredWithoutDefault = "required-without-default",
        /// It became required, and a default is declared that no caller supplies.
        BecameRequiredWithDefault = "became-required-with-default",
        /// It became required, without a default.
        BecameRequired = "became-required",
        /// Its type, unit or frame is another one.
        OtherKind = "other-kind",
        /// It does not take every value that it took.
        NarrowerInput = "narrower-input",
        /// It can take values that it could not take.
        WiderOutput = "wider-output",
        /// It was always present and can be absent now.
        OptionalOutput = "optional-output",
    }
}

crate::closed_set! {
    /// Why evidence cannot be assessed.
    EvidenceGap, "gap in the evidence", {
        /// It was gathered for another version, profile, policy or environment.
        OtherBinding = "other-binding",
        /// There are too few episodes or sequences.
        NoEpisodes = "no-episodes",
        /// A value is not finite or not plausible.
        Implausible = "implausible",
        /// A seed occurs twice.
        RepeatedSeed = "repeated-seed",
        /// Declared traces are not finite.
        TracesNotFinite = "traces-not-finite",
        /// A worsening is not finite.
        WorseningNotFinite = "worsening-not-finite",
        /// A component cannot be bounded.
        ComponentUnbounded = "component-unbounded",
        /// Success cannot be bounded.
        SuccessUnbounded = "success-unbounded",
        /// A measure of harm cannot be bounded.
        HarmUnbounded = "harm-unbounded",
        /// Only some episodes were measured for harm.
        HarmPartlyMeasured = "harm-partly-measured",
        /// A signal of shadow cannot be bounded.
        SignalUnbounded = "signal-unbounded",
        /// A pass rate is not a rate.
        PassRateInvalid = "pass-rate-invalid",
        /// `rho` is not a rate.
        RhoInvalid = "rho-invalid",
        /// Nothing was measured yet.
        NotMeasured = "not-measured",
        /// The code could not be read.
        CodeUnread = "code-unread",
        /// The policies were compiled for another profile.
        OtherProfile = "other-profile",
        /// No mode can be reached.
        NoMode = "no-mode",
    }
}

crate::closed_set! {
    /// A resource that a version asks for.
    ResourceKind, "resource", {
        /// Processor time, microseconds a tick.
        CpuPerTick = "cpu-us-per-tick",
        /// Memory, KiB.
        Memory = "memory-kib",
        /// Ticks a task.
        TicksPerTask = "ticks-per-task",
        /// Commands a task.
        CommandsPerTask = "commands-per-task",
    }
}

crate::closed_set! {
    /// A signal that shadow compares between the twin and the live cell.
    TwinSignal, "signal of shadow", {
        /// Failures of the task.
        Failure = "failure",
        /// Commands that the policy denies or clamps.
        PolicyHit = "policy-hit",
        /// Events of the task anomaly detector.
        WatcherEvent = "watcher-event",
        /// New attempts.
        Retry = "retry",
        /// Policy warnings.
        PolicyWarning = "policy-warning",
    }
}

crate::closed_set! {
    /// A recovery hook that a manifest declares.
    HookKind, "recovery hook", {
        /// The hook that undoes what the version did.
        Rollback = "rollback",
        /// The hook that ends a task safely.
        SafeAbort = "safe-abort",
    }
}

crate::closed_set! {
    /// Whose drills.
    DrillSide, "side of the drills", {
        /// The candidate.
        Candidate = "candidate",
        /// The active version.
        Active = "active",
    }
}

crate::closed_set! {
    /// What is not known about recovery.
    RecoveryUnknown, "unknown of recovery", {
        /// Whether the rollback target does not load.
        TargetLoads = "target-loads",
        /// Whether the digest of the rollback target differs.
        TargetDigest = "target-digest",
        /// Whether the fallback resolves.
        Fallback = "fallback",
    }
}

macro_rules! findings {
    ($($(#[$doc:meta])* $name:ident $({ $($(#[$attribute:meta])* $field:ident: $type:ty),* $(,)? })? => $code:ident,)*) => {
        /// What a rule found, with the values that a sentence about it needs. `finding` names it in JSON.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
        #[serde(tag = "finding", rename_all = "kebab-case", rename_all_fields = "snake_case", deny_unknown_fields)]
        #[allow(missing_docs, reason = "a field is named as the thing that it is")]
        pub enum Finding {
            $($(#[$doc])* $name $({ $($(#[$attribute])* $field: $type),* })?,)*
        }

        impl Finding {
            /// The stable name of what was found.
            #[must_use]
            pub const fn code(&self) -> ReasonCode {
                match self { $(Self::$name { .. } => ReasonCode::$code,)* }
            }
        }
    };
}

findings! {
    /// Every call that was valid stays valid, and outputs are as before.
    InterfaceCompatible => InterfaceCompatible,
    /// The code could not be read, so its exports are unknown.
    ExportsUnknown => InterfaceNoData,
    /// An entry point is declared and not exported.
    EntryPointNotExported { name: String } => InterfaceExportMismatch,
    /// A field is declared and unknown to the code.
    FieldUnknownToCode { part: FieldPart, name: String } => InterfaceExportMismatch,
    /// A field has another type, unit or frame in the code.
    FieldDiffersInCode { part: FieldPart, name: String } => InterfaceExportMismatch,
    /// The code needs an input that is not declared.
    InputUndeclared { name: String } => InterfaceExportMismatch,
    /// The code raises a failure signal that is not declared.
    SignalUndeclared { signal: FailureSignal } => InterfaceExportMismatch,
    /// An entry point of the active version is gone.
    EntryPointGone { name: String } => InterfaceSignatureBreaking,
    /// An input or a parameter is gone.
    ArgumentGone { part: FieldPart, name: String } => InterfaceSignatureBreaking,
    /// An input or a parameter breaks callers.
    ArgumentBroken { part: FieldPart, name: String, how: FieldBreak } => InterfaceSignatureBreaking,
    /// An output is gone.
    OutputGone { name: String } => InterfaceSchemaBreaking,
    /// An output breaks callers.
    OutputBroken { name: String, how: FieldBreak } => InterfaceSchemaBreaking,
    /// A precondition on an input is stronger; the dispatcher checks it before each call.
    PreconditionChecked { name: String } => InterfaceConditionAdaptable,
    /// A precondition is stronger.
    PreconditionStronger { name: String } => InterfaceConditionBreaking,
    /// A postcondition is weaker.
    PostconditionWeaker { name: String } => InterfaceConditionBreaking,
    /// No registered version meets a dependency.
    DependencyUnmet { family: Family, requirement: String } => InterfaceDependencyBreaking,
    /// A registered version meets a dependency, the active one does not.
    DependencyNotActive { family: Family, requirement: String } => InterfaceDependencyAdaptable,
    /// The dependencies lead back to the family.
    DependencyCycle => InterfaceDependencyBreaking,
    /// The version number promises more compatibility than was found.
    VersionMislabeled { from: String, to: String } => InterfaceVersionMislabelled,
    /// The submission does not declare a change that was found.
    ChangeUndeclared { change: InterfaceChange } => InterfaceUndeclaredChange,
    /// A declared change was not found.
    ChangeNotFound { change: InterfaceChange } => InterfaceUndeclaredChange,

    /// Every mode that matters is covered and allowed.
    PolicyCompatible => PolicyCompatible,
    /// The policies cannot be applied.
    PolicyGap { gap: EvidenceGap } => PolicyNoData,
    /// The code needs a sensor that the permissions do not declare.
    SensorUndeclared { name: String } => PolicyUndeclaredImport,
    /// The code needs a tool that the permissions do not declare.
    ToolUndeclared { name: String } => PolicyUndeclaredImport,
    /// The code needs a command that the permissions do not declare.
    CommandUndeclared { need: RequiredCommand } => PolicyUndeclaredImport,
    /// The declared environments do not admit the profile.
    EnvironmentNotAdmitted { profile: ProfileName } => PolicyEnvironmentNotAdmitted,
    /// A resource that is asked for exceeds the profile.
    ResourceExceeded { resource: ResourceKind } => PolicyResourcesExceeded,
    /// A mode needs a review.
    ModeReviewed { mode: ModeKey, because: Vec<String> } => PolicyAuthorityReview,
    /// A mode is forbidden.
    ModeForbidden { mode: ModeKey, because: Vec<String> } => PolicyForbiddenMode,
    /// No policy covers a mode of high risk. `errors` are those of policies that could not be evaluated.
    HighRiskUncovered {
        mode: ModeKey,
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        errors: Vec<String>,
    } => PolicyUncoveredHighRisk,
    /// No policy covers a mode; the guard denies it. `errors` are those of policies that could not be evaluated.
    ModeUncovered {
        mode: ModeKey,
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        errors: Vec<String>,
    } => PolicyUncoveredMode,
    /// Some modes are allowed in a tighter envelope than declared. Of speed and force only those that are less than declared
    /// are present; findings of older builds have both.
    EnvelopeTighter {
        #[serde(default, skip_serializing_if = "Option::is_none")]
        speed_m_s: Option<f64>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        force_n: Option<f64>,
    } => PolicyTighterEnvelope,
    /// The declared environments admit simulation alone.
    SimulationOnlyDeclared => PolicySimulationOnly,
    /// Policies cover too few of the reachable modes.
    CoverageLow => PolicyBelowThreshold,
    /// It asks for more authority than the profile grants.
    AuthorityAboveProfile => PolicyAuthorityReview,
    /// A permission is new.
    PermissionNew { permission: String } => PolicyNewPermission,
    /// A permission is higher.
    PermissionHigher { permission: String } => PolicyEscalation,

    /// No component is worse beyond its tolerance.
    BehaviorCompatible => BehaviorCompatible,
    /// A component is significantly worse.
    ComponentWorse { component: ComponentName } => BehaviorEstablishedWorse,
    /// A component is worse in the pairs of an evaluation that ended early.
    ComponentWorseSoFar { component: ComponentName } => BehaviorEstablishedWorse,
    /// A component may be worse beyond its tolerance.
    ComponentPossiblyWorse { component: ComponentName } => BehaviorSuspicious,
    /// Success rose while a component of safety is significantly worse.
    SafetyTraded { component: ComponentName } => BehaviorSafetyTraded,
    /// A component is better.
    ComponentBetter { component: ComponentName } => BehaviorImproved,
    /// The worsenings add up, none of them significant.
    WorseningsAddUp => BehaviorSuspicious,
    /// The mean of a measure of harm is significantly worse beyond its tolerance.
    HarmWorse { measure: HarmKind, candidate: f64, active: f64, tolerance: f64 } => BehaviorHarmEstablished,
    /// The mean of a measure of harm may be worse beyond its tolerance.
    HarmPossiblyWorse { measure: HarmKind, candidate: f64, active: f64, tolerance: f64 } => BehaviorHarmSuspicious,
    /// A measure of harm passes its limit significantly more often.
    HarmLimitWorse { measure: HarmKind, limit: f64, candidate: f64, active: f64, tolerance: f64 } => BehaviorHarmEstablished,
    /// A measure of harm may pass its limit more often.
    HarmLimitPossiblyWorse { measure: HarmKind, limit: f64, candidate: f64, active: f64, tolerance: f64 } => BehaviorHarmSuspicious,
    /// It asks for more speed or force than it declares.
    AsksMore { asked: u64, episodes: u64 } => BehaviorAsksMore,
    /// A hard stop happened in the sandbox.
    SandboxHardStop { stop: HardStop } => BehaviorHardStop,
    /// A hard stop in a scene that gave no valid episode of the version compared with.
    StopUncompared { stop: HardStop } => BehaviorSuspicious,
    /// Episodes under stress were unsafe.
    UnsafeUnderStress { unsafe_episodes: u32, episodes: u64 } => BehaviorSuspicious,
    /// A search found a place where the candidate alone passes a limit.
    SearchedPlace { candidate_only: u64, active_only: u64, pairs: u64, place: Vec<(String, f64)> } => BehaviorSuspicious,
    /// A rule ended the pairs before their budget.
    PairsEndedEarly { rule: EarlyStopReason, seen: u64, budget: u64 } => BehaviorEndedEarly,
    /// There are fewer pairs than the budget.
    TooFewPairs => BehaviorInconclusive,
    /// The median tick of its code takes far more processor time than it declares.
    TicksTooSlow { measured_us: f64, declared_us: u32 } => BehaviorTickTooSlow,
    /// The evaluation has taken the wall time that the profile allows.
    EvaluationTooLong { worked_min: f64, budget_min: u32 } => BehaviorTimeSpent,
    /// There are fewer live-like pairs than a third of the budget.
    TooFewLiveLikePairs => BehaviorInconclusive,
    /// It is significantly worse in the live-like pairs: by what it would be in all pairs.
    LiveLikeWorse { by: Box<Finding> } => BehaviorLiveLikeWorse,
    /// It may be worse in the live-like pairs, likewise.
    LiveLikePossiblyWorse { by: Box<Finding> } => BehaviorLiveLikeSuspicious,
    /// The episodes cannot be assessed.
    BehaviorGap { gap: EvidenceGap } => BehaviorNoData,
    /// The values are an estimate from declared or earlier traces.
    Estimated => BehaviorEstimated,
    /// In whole sequences a measure is significantly worse.
    SequenceWorse { measure: SequenceMeasure, active: f64, candidate: f64, tolerance: f64, pairs: u32, ends: Option<SequenceEnds>, seed: Option<u64> } => BehaviorSequenceWorse,
    /// In whole sequences a measure may be worse.
    SequencePossiblyWorse { measure: SequenceMeasure, active: f64, candidate: f64, tolerance: f64, pairs: u32, ends: Option<SequenceEnds>, seed: Option<u64> } => BehaviorSequenceSuspicious,
    /// Another family has no active version, so no sequence could run.
    SequencesNotRun => BehaviorSequenceSuspicious,
    /// Fewer sequences ran than were asked for.
    TooFewSequences { ran: u64, asked: u64 } => BehaviorSequenceSuspicious,
    /// Too few sequences reached the handover.
    TooFewHandovers { reached: u64, ran: u64 } => BehaviorSequenceSuspicious,
    /// The sequences cannot be assessed.
    SequenceGap { gap: EvidenceGap } => BehaviorSequenceSuspicious,

    /// It is significantly worse than the family's anchor: by what it would be against the active version.
    AnchorWorse { anchor: CapabilityId, by: Box<Finding> } => BehaviorAnchorWorse,
    /// It may be worse than the family's anchor, likewise.
    AnchorPossiblyWorse { anchor: CapabilityId, by: Box<Finding> } => BehaviorAnchorSuspicious,
    /// The family's anchor is another version, and its episodes are missing.
    AnchorMissing => BehaviorNoData,
    /// The episodes of the anchor cannot be assessed.
    AnchorGap { anchor: CapabilityId, gap: EvidenceGap } => BehaviorNoData,

    /// At the level of its try, the pairs do not exclude that success is lower by the margin.
    TryOpen { number: u32, level: f64 } => BehaviorTryOpen,
    /// The tries of an author, or of a family, wait for a person's review.
    TriesSpent { author: String, family: Family, by_author: u32, in_family: u32 } => BehaviorTriesSpent,
    /// The same content was rejected in the same circumstances, under this version number.
    TriedBefore { version: CapabilityId } => BehaviorTriedBefore,
    /// The same content was measured under this version number in the same circumstances, and demoted.
    HeldBefore { version: CapabilityId } => BehaviorTriedBefore,

    /// Recovery is as good as that of the active version.
    RecoveryCompatible => RecoveryCompatible,
    /// Everything that recovery needs is present; the drills decide.
    RecoveryReady => RecoveryCompatible,
    /// `kappa_R` is below its threshold.
    RecoveryWorse => RecoveryBelowThreshold,
    /// Recovery is below half of the floor.
    RecoveryFarBelowFloor => RecoveryFarBelowFloor,
    /// Rollback drills pass less often than the floor.
    RollbackDrillsFail => RecoveryRollbackBelowFloor,
    /// Recovery is below the floor.
    RecoveryFragile => RecoveryFragile,
    /// Recovery is above the floor and clearly below that of the active version.
    RecoveryConditional => RecoveryConditional,
    /// Drills of a kind lean toward passing less often.
    DrillsLean { drill: DrillKind } => RecoveryLeaning,
    /// Drills of a kind pass significantly less often.
    DrillsWorse { drill: DrillKind } => RecoveryEstablishedWorse,
    /// The candidate alone fails drills of a kind more often than the active version alone: a sequential test.
    DrillsSettledWorse { drill: DrillKind, failed: u32, drills: u32, active: u32 } => RecoveryEstablishedWorse,
    /// The candidate alone failed drills of a kind, and the most drills have not settled it.
    DrillsUnsettled { drill: DrillKind, failed: u32, drills: u32, active: u32 } => RecoveryUnsettled,
    /// The candidate alone failed drills of a kind, and more drills show no clear excess.
    DrillsSettled { drill: DrillKind, failed: u32, drills: u32, active: u32 } => RecoverySettled,
    /// Drills of a kind fail in a phase.
    PhaseFails { drill: DrillKind, phase: WorkPhase } => RecoveryPhaseFailing,
    /// Drills of a kind pass significantly less often in a phase.
    PhaseWorse { drill: DrillKind, phase: WorkPhase } => RecoveryPhaseWorse,
    /// Drills of the active version pass too seldom.
    ActiveWeak { drill: DrillKind, phase: Option<WorkPhase> } => RecoveryActiveWeak,
    /// A rule ended the drills before their budget.
    DrillsEndedEarly { rule: EarlyStopReason, seen: u64, budget: u64 } => RecoveryEndedEarly,
    /// The drills cannot be assessed.
    RecoveryGap { gap: EvidenceGap } => RecoveryNoData,
    /// Too few drills of a kind could be carried out.
    TooFewDrills { side: DrillSide, drill: DrillKind } => RecoveryNoData,
    /// Too few drills of the candidate could be carried out in a phase that the active version shows.
    TooFewPhaseDrills { drill: DrillKind, phase: WorkPhase } => RecoveryNoData,
    /// The active version cannot do the drills of a kind, so they say nothing about the candidate: a fault of the cell.
    ActiveUndrillable { drill: DrillKind } => RecoveryCellFault,
    /// Something about recovery is not known.
    RecoveryUnknown { unknown: RecoveryUnknown } => RecoveryNoData,
    /// The rollback target does not load.
    TargetNotLoadable => RecoveryPredecessorNotLoadable,
    /// The digest of the rollback target is not the recorded one.
    TargetDigestDiffers => RecoveryPredecessorNotLoadable,
    /// No registered version meets the fallback binding.
    FallbackUnmet => RecoveryFallbackUnresolved,
    /// Registered versions meet the fallback binding, and none of them may take over: a fault of the cell.
    FallbackNotInCell { family: Family, requirement: String } => RecoveryCellFault,
    /// No fallback is bound.
    FallbackUnbound => RecoveryFallbackUnresolved,
    /// A recovery hook is not declared.
    HookUndeclared { hook: HookKind } => RecoveryHookMissing,
    /// The code does not export a recovery hook.
    HookNotExported { hook: HookKind, name: String } => RecoveryHookMissing,
    /// The task anomaly detector does not know a failure signal.
    SignalUnknown { signal: FailureSignal } => RecoverySignalUnknown,

    /// Every dimension is compatible.
    EveryDimensionCompatible => CompositionEligible,
    /// A restriction caps the recommendation at shadow.
    CappedAtShadow => CompositionRestricted,
    /// A value is missing.
    ValueMissing => CompositionNoData,

    /// No signal is significantly more frequent.
    ShadowClean => ShadowClean,
    /// A signal is significantly more frequent than under the active version.
    SignalWorse { signal: TwinSignal } => ShadowGovernanceDivergence,
    /// A signal leans toward more than under the active version.
    SignalLeans { signal: TwinSignal } => ShadowLeaning,
    /// The twin spends more of its time near its limits.
    NearLimitsMore => ShadowLeaning,
    /// The outputs differ.
    OutputsDiffer => ShadowOutputDivergence,
    /// The twin leaves the band of the active version.
    EnvelopeLeft => ShadowEnvelopeDivergence,
    /// A signal is worse in shadow than the sandbox showed.
    ShiftedInShadow { signal: ShiftSignal, live: f64, sequences: u64, sandbox: f64, pairs: u64 } => ShadowShifted,
    /// A version with an open concern was re-evaluated under the conditions of the live cell, in shadow.
    ReEvaluatedInShadow { outcome: BehaviorOutcome, pairs: u64 } => ShadowWorkedAgain,
    /// A hard stop happened in shadow.
    ShadowHardStop { stop: HardStop } => GateHardLimit,
    /// The sequences of shadow cannot be assessed.
    ShadowGap { gap: EvidenceGap } => ShadowNoData,
    /// More sequences are needed.
    MoreSequencesNeeded => ShadowNoData,
    /// The twins began at the observed state: the largest differences to it over the sequences.
    TwinObserved { sequences: u64, joints_rad: f64, width_m: f64, object_m: Option<f64> } => ShadowTwinObserved,
    /// The cell has no twin; the profile permits that shadow rests on outputs alone.
    OutputsAlone { missing: Vec<CellAbility> } => ShadowOutputsAlone,
    /// The cell has no twin, and outputs alone are not enough under the profile.
    TwinMissing { missing: Vec<CellAbility> } => ShadowTwinMissing,

    /// Every demand of the profile is met.
    GatePassed => GatePassed,
    /// A dimension is incompatible.
    DimensionIncompatible { of: Dimension } => GateDimensionFailed,
    /// A dimension has no conclusive data.
    DimensionInconclusive { of: Dimension } => GateNoData,
    /// A dimension was skipped outside an experiment.
    DimensionSkipped { of: Dimension } => GateSkipped,
    /// An experiment leaves a part out.
    LeftOut => GateSkipped,
    /// A review is needed and the profile has no approver.
    ReviewWithoutApprover => GateDimensionFailed,
    /// The value of a dimension is an estimate.
    NotMeasured { of: Dimension } => GateNotMeasured,
    /// A dimension has no value.
    NoValue { of: Dimension } => GateNoData,
    /// There is no evidence.
    NoEvidence => GateNoData,
    /// The evidence is of other circumstances.
    EvidenceStale => GateStaleEvidence,
    /// The circumstances of the decision are not those of the evidence.
    CircumstancesDiffer => GateStaleEvidence,
    /// The compiled policies are not those that the decision is made under.
    PoliciesDiffer => GateStaleEvidence,
    /// Shadow did not run.
    ShadowNotRun => GateNoData,
    /// Shadow ran fewer sequences than a condition demands.
    ShadowTooShort => GateShadowTooShort,
    /// Shadow failed.
    ShadowFailed => GateDimensionFailed,
    /// Shadow is not conclusive.
    ShadowInconclusive => GateNoData,
    /// A site policy forbids the activation.
    SitePolicyForbids { because: Vec<String> } => GateSitePolicyForbids,
    /// The version is blocked under the profile.
    ProfileBlocked { profile: ProfileName } => GateProfileClosed,
    /// No active version meets a dependency.
    DependenciesNotActive { dependencies: Vec<String> } => GateDependencyUnmet,
    /// No enrolled person is on record as requester.
    RequesterUnknown => GateRequesterUnknown,
    /// A review after break-glass is open.
    ReviewOpen => GateReviewOpen,
    /// No administrator authorized the profile.
    ProfileUnauthorized => GateProfileUnauthorized,
    /// Change is frozen.
    Frozen { until: WallTime, reason: String } => GateFrozen,
    /// The clock is not believed.
    ClockMismatched { mismatch: ClockMismatch } => GateClockDoubted,
    /// The version is for simulation alone, and the profile is another one.
    NotASimulation { profile: ProfileName } => GateSimulationOnly,
    /// The profile demands an improvement and none is significant.
    NoImprovement => GateNoImprovement,
    /// No improvement is significant; the profile waives it.
    ImprovementWaived => GateImprovementWaived,
    /// An improvement of success is significant.
    Improved => GateImproved,
    /// No approver was asked yet.
    NotAskedYet => ApprovalPending,
    /// The count of approvals while the approvers are asked; only a display has it.
    ApprovalsSoFar { given: u32, needed: u32 } => ApprovalPending,
    /// Fewer people approved than are needed.
    QuorumNotReached => ApprovalPending,
    /// The approvals are present.
    ApprovalsPresent => ApprovalGranted,
    /// Too few people answered in time.
    AnsweredTooLate => ApprovalTimeout,

    /// Enough distinct people approved.
    QuorumReached => ApprovalGranted,
    /// Break-glass was used.
    BreakGlassUsed => ApprovalBreakGlass,
    /// The profile asks no approver for this.
    ApprovalNotNeeded => ApprovalNotNeeded,
    /// Approvals are missing.
    ApprovalsMissing => ApprovalPending,
    /// The approval of a safety officer is missing.
    SafetyOfficerMissing => ApprovalPending,
    /// A person refused; the reason is absent in records of older builds.
    Refused {
        person: String,
        #[serde(default, skip_serializing_if = "String::is_empty")]
        reason: String,
    } => ApprovalRefused,
    /// Too few people answered by the deadline.
    DeadlinePassed { until: WallTime } => ApprovalTimeout,
    /// A person answered twice.
    AnsweredTwice { person: String } => ApprovalDuplicate,
    /// A person has the key of another person who answered.
    KeyShared { person: String } => ApprovalDuplicate,
    /// An answer does not count; the code of the reason is that of the flaw ([`VoteFlaw::code`]).
    AnswerVoid { person: String, flaw: VoteFlaw } => ApprovalStale,

    /// Nothing out of the ordinary.
    MonitorHealthy => MonitorHealthy,
    /// The provisional window passed without a trip.
    WindowPassed => MonitorConfirmed,
    /// A safety event.
    SafetyTrip { event: SafetyEvent } => MonitorSafetyTrip,
    /// A trip holds until the version is rolled back.
    TripHolds => MonitorSafetyTrip,
    /// A rate is significantly worse.
    RateWorse { rate: Rate } => MonitorRateTrip,
    /// A measure of harm of a live task is past the value from which it is a danger to people.
    DangerLive { measure: HarmKind, value: f64, limit: f64 } => MonitorSafetyTrip,
    /// The rates of live tasks past a limit of harm are above normal; the measure with the most evidence.
    HarmRoseLive { measure: HarmKind, past: u64, any: u64, tasks: u64, normal: f64 } => MonitorHarmTrip,
    /// A rate drifts.
    RateDrifts { rate: Rate } => MonitorRateWarning,
    /// The version is rollback-coupled: the first warning rolls it back.
    RollbackCoupled => MonitorCoupledTrip,
    /// A signal is worse in live tasks than shadow showed.
    ShiftedLive { signal: ShiftSignal, live: f64, tasks: u64, twin: f64, twins: u64 } => MonitorShifted,
    /// An active version with an open concern was re-evaluated.
    ReEvaluatedLive { outcome: BehaviorOutcome, pairs: u64 } => MonitorWorkedAgain,
    /// Telemetry is silent.
    TelemetrySilent => MonitorTelemetryMissing,
    /// No one answered an escalation by its deadline.
    EscalationUnanswered => MonitorEscalationUnanswered,
    /// An operator asked for the action, in these words: of a caller of the monitor, and in records of older builds.
    OperatorAsked { words: String } => MonitorOperator,
    /// An operator restricted the version.
    OperatorRestricted { by: String, reason: String } => MonitorOperator,
    /// An operator rolled the version back.
    OperatorRolledBack { by: String, reason: String } => MonitorOperator,
}

/// In which task the sequences end that do not finish, and how often.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SequenceEnds {
    /// The task that fails.
    pub task: TaskKind,
    /// Whether it is the next task after that of the candidate.
    pub is_next: bool,
    /// Sequences that end there with the candidate in its place.
    pub candidate: u64,
    /// Sequences that end there with the active version in its place.
    pub active: u64,
}
