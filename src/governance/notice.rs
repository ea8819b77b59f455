//! What an event, an alarm, a rollback record or a change of state states: a closed set of notices with typed values.
//!
//! Owns no sentence. The crate `holdpoint-wording` makes one of each notice; records keep the notice and its values.

use holdpoint_body::TaskKind;
use serde::{Deserialize, Serialize};

use super::approval::Requester;
use super::cached_result::CacheLocation;
use super::decision::{Reason, ReasonCode};
use super::health::HealthRate;
use super::ids::{CapabilityId, Family};
use super::monitor::{RateTally, SafetyEvent};
use super::past_limit::MeasuredInTask;
use super::policy_hit::PolicyHit;
use super::profile::{ProfileName, SiteName};
use super::profile_downgrade::{AdmissionContext, DowngradeExtent};
use super::rollback::RungFailure;
use super::sensor_health::SensorSignal;
use super::shared_event::SharedEvent;
use super::start_domain::DomainMiss;
use super::startup_stop::StartStoppedReason;
use super::wall_time::ClockMismatch;

crate::closed_set! {
    /// An operation of a person that is a single event of the lifecycle.
    OperatorAct, "operation of a person", {
        /// The promotion is paused.
        Paused = "paused",
        /// The version is resumed.
        Resumed = "resumed",
        /// The version is active again after a safe stop.
        Reactivated = "reactivated",
        /// The version is rejected.
        Rejected = "rejected",
        /// The version returns to evaluation.
        Demoted = "demoted",
        /// A stage is to be run again.
        ToRetry = "to-be-repeated",
    }
}

crate::closed_set! {
    /// Why an approval request is void.
    RequestVoidCause, "cause of a void request", {
        /// The version changed after the request.
        VersionChanged = "version-changed",
        /// The text that approvers were shown changed after the request.
        TextChanged = "text-changed",
    }
}

crate::closed_set! {
    /// A part of what evidence is bound to.
    BoundPart, "part of the binding", {
        /// The profile.
        Profile = "profile",
        /// The policies.
        Policies = "policies",
        /// The robot.
        Robot = "robot",
        /// The site file.
        Site = "site",
        /// The build that computes evidence.
        Build = "build",
        /// The scene.
        Scene = "scene",
    }
}

crate::closed_set! {
    /// Why the tool was not raised clear of everything.
    RetreatObstacle, "obstacle to the retreat", {
        /// The guard refused the way up.
        GuardRefused = "guard-refused",
        /// The arm still touches something.
        Touching = "touching",
        /// The arm did not come to a standstill.
        NoStandstill = "no-standstill",
        /// The tool did not rise.
        NotRisen = "not-risen",
    }
}

/// Why a version is not admitted to the arm under a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AdmissionRefusal {
    /// Its manifest does not name the profile.
    Undeclared,
    /// A demotion blocked it under the profile.
    Blocked,
    /// The gate admitted it under a less strict profile.
    LessStrictGate(AdmissionContext),
}

/// What an event, an alarm, a rollback record or a change of state states, with the values that a sentence about it needs.
/// `notice` names it in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "notice", rename_all = "kebab-case", rename_all_fields = "snake_case", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum Notice {
    /// A rule decided for this reason.
    Decided { reason: Box<Reason> },
    /// A rule decided and gave no reason.
    NoReasonGiven,

    /// The version is registered.
    Submitted { requester: Requester },
    /// The cell was commissioned with the version.
    CommissionedWith,
    /// The family is new.
    FamilyNew,
    /// Its component keeps the first contract.
    ContractOld,
    /// A stage begins.
    StageBegins,
    /// Shadow is passed.
    ShadowPassed,
    /// The gate is passed.
    GatePassed,
    /// The provisional window passed without a trip.
    WindowPassed,
    /// A person did this, for this reason.
    OperatorDid { act: OperatorAct, by: String, reason: String },
    /// A person lifted the restriction.
    RestrictionLifted { by: String, reason: String },
    /// Approvers lifted the restriction.
    RestrictionLiftedByApprovers { by: String },
    /// A person blocked the version under a profile.
    ProfileBlocked { profile: ProfileName, by: String, reason: String },
    /// A person unblocked the version under a profile.
    ProfileUnblocked { profile: ProfileName, by: String, reason: String },
    /// The review of an emergency activation upheld it past a block.
    ProfileUnblockedByReview,
    /// The family has no active version to compare with.
    NoActiveVersion,
    /// The active version or the profile changed during a stage.
    ActiveOrProfileChanged,
    /// The engine restarted, and the interrupted stage does not count.
    StageVoidedByRestart,
    /// The retried stage was interrupted.
    RetryInterrupted,
    /// The engine restarted, and approvers are asked again.
    RequestVoidedByRestart,

    /// Approvers are asked.
    ApproversAsked,
    /// An approval request is void.
    RequestVoid { version: CapabilityId, cause: RequestVoidCause },
    /// An approval request is void, because the lifecycle refuses the approval.
    RequestRefused { version: CapabilityId, problem: String },
    /// Too few people answered in time, and the version is on hold.
    ApprovalLapsed,
    /// Approvers agreed to lift a restriction.
    ReleaseApproved,
    /// An approver refused to lift a restriction.
    ReleaseRefused,
    /// Too few people answered in time, and the version stays restricted.
    ReleaseLapsed,
    /// One person approves by break-glass.
    BreakGlassBegins,
    /// Break-glass was used.
    BreakGlassUsed,
    /// The review of an emergency activation is closed.
    ReviewClosed,

    /// A profile, policies and a robot are in force for the first time.
    BindingFirst,
    /// Evidence is void, because a part of what it is bound to changed. No part: the digest alone differs.
    BindingChanged { parts: Vec<BoundPart> },

    /// An interrupted rollback is finished now.
    RollbackContinued,
    /// A stage ran at the restart, and is run again.
    StageRunAgain,
    /// The version is not admitted under the profile and is demoted.
    RolledBackUnadmitted { profile: ProfileName, refusal: AdmissionRefusal },
    /// The provisional window restarts under a new monitor.
    WindowRestarts,
    /// The version cannot be monitored and is rolled back.
    RolledBackUnmonitored { problem: String },
    /// The approval request stays open.
    RequestStaysOpen { answers: u64 },
    /// Approvers had been asked about an activation, and are asked again.
    ActivationAskedAgain,
    /// Approvers had been asked to lift a restriction, and have to be asked again.
    ReleaseToAskAgain,

    /// A rollback was interrupted.
    RollbackInterrupted,
    /// The store was opened under a profile that does not admit the version.
    OpenedUnderProfile { profile: ProfileName, refusal: AdmissionRefusal },
    /// No monitor could be set up after a restart.
    NoMonitorAfterRestart,
    /// An emergency activation was not reviewed in time.
    ReviewLate,
    /// The review did not uphold an emergency activation.
    ReviewNotUpheld { by: Vec<String> },
    /// A person asked for the rollback.
    OperatorRollback { by: String, reason: String },
    /// The behavior shifted, and there is no rollback target to compare the version with.
    ShiftWithoutTarget,
    /// A re-evaluation did not clear the version.
    DiffersFromShadow { reason: Option<Box<Reason>> },
    /// The concern cannot be settled without a rollback target to compare the version with.
    ConcernWithoutTarget,
    /// The concern that the version was activated with remains on new evidence.
    ConcernRemains,

    /// The command authority of the version is revoked.
    AuthorityRevoked { trigger: Box<NoticeOrText> },
    /// A rung failed, and the family is stopped.
    RollbackFailed { failure: Option<RungFailure>, trigger: Box<NoticeOrText> },

    /// The version gives no command any more.
    NoMoreCommands,
    /// The hook of the version brought the arm to a standstill.
    HookStopped,
    /// The hook of the version did not stop the arm.
    HookDidNotStop,
    /// The rollback hook of the version did not stop the arm: too late, by its code, by a limit or by a contact.
    RollbackHookDidNotStop,
    /// Every joint is at standstill.
    AtStandstill,
    /// A joint still moves after the interrupt.
    StillMoving,
    /// A person stopped the cell, before the retreat or during it, and the arm does not move.
    RetreatSkipped { during: bool },
    /// The tool is clear of everything.
    ToolClear,
    /// The tool could not be raised clear of everything.
    RetreatFailed { obstacle: RetreatObstacle, height_mm: i64 },
    /// The body failed.
    BodyFailed { problem: String },
    /// The arm is at work, and the ladder cannot reach it.
    ArmOutOfReach,
    /// There is no rollback target.
    NoTarget,
    /// The rollback target is not admitted under the profile.
    TargetNotAdmitted { version: CapabilityId, profile: ProfileName, refusal: AdmissionRefusal },
    /// The rollback target could not be read from the store.
    TargetUnreadable { problem: String },
    /// The rollback target is in the store with its registered digest.
    TargetVerified { version: CapabilityId },
    /// The policies and the context in force were compared with those of the profile.
    PoliciesCompared,
    /// The rollback target gives a command that its guard passes.
    TargetReady,
    /// The guard refuses a command of the rollback target that no version may give.
    TargetCommandForbidden { hit: PolicyHit },
    /// The guard refuses every command of the rollback target.
    TargetCommandsDenied { hit: PolicyHit },
    /// The rollback target gives no command.
    TargetSilent,
    /// No monitor can be set up for a rollback target whose window is not passed.
    TargetUnmonitored { version: CapabilityId },
    /// The rollback target has control again. `task`: in flight, and given up with those `planned` after it.
    TargetBound { task: Option<TaskKind>, planned: u64 },
    /// The swap could not be written.
    SwapFailed { problem: String },
    /// The engine ended before it was known whether the family recovered.
    RecoveryUnknown,
    /// A safety event happened under the rollback target.
    UnsafeAfterRollback { event: SafetyEvent, task: u64 },
    /// The task of the rollback target was not reached.
    TargetTaskNotReached { sequences: u64 },
    /// The first tasks under the rollback target were without a safety event.
    SafeAfterRollback { tasks: u64 },

    /// A version was rolled back. `measured`: the safety event behind it; absent for other triggers, and in older records.
    RolledBack {
        version: CapabilityId,
        trigger: Box<NoticeOrText>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        measured: Option<MeasuredInTask>,
    },
    /// A family runs its rollback target and does not work safely.
    NotRecovered { family: Family },
    /// A family is safe-stopped.
    SafeStopped { family: Family, failure: Option<RungFailure> },
    /// A version was rejected.
    Rejected { version: CapabilityId },
    /// A version waits for approval.
    WaitsForApproval { version: CapabilityId },
    /// One person activated a version, and it is not reviewed.
    Unreviewed { version: CapabilityId, by: String },
    /// The monitor asks an operator about a version. Records of older builds have no reason.
    Escalated {
        version: CapabilityId,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<Box<Reason>>,
    },
    /// A version is restricted. Records of older builds have no reason.
    Restricted {
        version: CapabilityId,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<Box<Reason>>,
    },
    /// The behavior of a version shifted. Records of older builds name no version.
    Shifted {
        #[serde(default, skip_serializing_if = "Option::is_none")]
        version: Option<CapabilityId>,
        reasons: Vec<Reason>,
    },
    /// A version has the same event as the one compared with it, in the same scene.
    SharedEvent { version: CapabilityId, with: CapabilityId, shared: SharedEvent },
    /// A version shows no difference from the one compared with it in the rates that rolled that one back, in the same
    /// tasks.
    SharedRates { version: CapabilityId, with: CapabilityId, rates: Vec<RateTally> },
    /// The evidence of the active version does not cover the start of its task. `run_by`: the version that ran the task;
    /// absent if it was refused.
    OutsideDomain { version: CapabilityId, missed: Vec<DomainMiss>, run_by: Option<CapabilityId> },
    /// The active version recovers too seldom. Records of older builds name no version.
    WeakRecovery {
        #[serde(default, skip_serializing_if = "Option::is_none")]
        version: Option<CapabilityId>,
        reasons: Vec<Reason>,
    },
    /// An active version did harm: once as a danger to people, or more often than is normal.
    Harmful { version: CapabilityId, reason: Box<Reason>, sequence: u64 },
    /// A version violated a limit. `measured` is absent in records of older builds.
    LimitViolated {
        version: CapabilityId,
        hit: Option<PolicyHit>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        measured: Option<MeasuredInTask>,
    },
    /// A version performs worse than at commissioning.
    Degraded { version: CapabilityId, rate: HealthRate },
    /// The camera is worse than at commissioning: m for the jitter, a share for missing camera frames.
    CameraDegraded { signal: SensorSignal, value: Option<f64>, limit: f64 },
    /// Cached results differ from their re-run.
    CacheMismatch {
        version: CapabilityId,
        active: CapabilityId,
        place: CacheLocation,
        differing: u64,
        rerun: u64,
    },
    /// Another file lay in place of the compiled form of a version.
    CompiledFormReplaced { version: CapabilityId },
    /// The telemetry file was quarantined.
    TelemetryQuarantined { file: String, missing: u64, problem: String },
    /// Sealed batches of telemetry are missing without a record of the cause.
    TelemetryMissing { batches: u64 },
    /// The end of the audit chain could not be signed or sent to a witness.
    CheckpointFailed { problem: String },
    /// Another program took the name of the socket of the engine.
    SocketNameTaken { times: u64 },
    /// The cell came up stopped.
    CameUpStopped { cause: StartStoppedReason },
    /// The cell does not answer any more, or stopped its arm by itself.
    CellLost { problem: String },
    /// The clock of the machine is not trusted.
    ClockMismatched { mismatch: ClockMismatch },
    /// No administrator authorized the profile. `summary` is in records of older builds, in place of `less_strict`.
    ProfileUnauthorized {
        profile: ProfileName,
        site: Option<SiteName>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        less_strict: Option<DowngradeExtent>,
        #[serde(default, skip_serializing_if = "String::is_empty")]
        summary: String,
    },
    /// The engine is halted.
    EngineHalted { problem: String },
    /// An alarm of an earlier start cannot be read.
    AlarmUnreadable { alarm: String },
}

/// A notice, or the sentence in its place that an older build wrote. The sentence may quote foreign text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(untagged)]
pub enum NoticeOrText {
    /// What is stated.
    Notice(Box<Notice>),
    /// The sentence of an older build, which is shown as it is.
    Text(String),
}

impl Default for NoticeOrText {
    /// The empty text, for a record without one.
    fn default() -> Self {
        Self::Text(String::new())
    }
}

impl From<Notice> for NoticeOrText {
    fn from(notice: Notice) -> Self {
        Self::Notice(Box::new(notice))
    }
}

impl NoticeOrText {
    /// The notice; absent in records of older builds.
    #[must_use]
    pub fn notice(&self) -> Option<&Notice> {
        match self {
            Self::Notice(notice) => Some(notice),
            Self::Text(_) => None,
        }
    }

    /// Whether an alarm that shows this stays as it is: a newer text is equal, or a violation of the same limit by no larger
    /// value.
    #[must_use]
    pub fn covers(&self, newer: &Self) -> bool {
        let is_covered = match (self.notice(), newer.notice()) {
            (
                Some(Notice::LimitViolated { version, hit, measured: Some(measured) }),
                Some(Notice::LimitViolated { version: again, hit: newer_hit, measured: Some(newer) }),
            ) => version == again && hit == newer_hit && !newer.exceeds(measured),
            _ => false,
        };
        is_covered || self == newer
    }

    /// Whether a person, or the end of an approval request, caused what it is about.
    #[must_use]
    pub fn is_by_people(&self) -> bool {
        match self {
            Self::Notice(notice) => match &**notice {
                Notice::OperatorDid { act, .. } => {
                    matches!(act, OperatorAct::Rejected | OperatorAct::Demoted)
                }
                Notice::Decided { reason } => {
                    matches!(reason.code, ReasonCode::ApprovalRefused | ReasonCode::ApprovalTimeout)
                }
                _ => false,
            },
            // The beginnings of the texts of older builds.
            Self::Text(text) => ["rejected by ", "demoted by ", "approval-refused", "approval-timeout"]
                .iter()
                .any(|mark| text.starts_with(mark)),
        }
    }
}

impl Notice {
    /// A rule decided for this reason; no reason is a notice as well.
    #[must_use]
    pub fn decided(reason: Option<&Reason>) -> Self {
        reason.map_or(Self::NoReasonGiven, |reason| Self::Decided { reason: Box::new(reason.clone()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notice_and_an_older_text_read_back_as_they_were_written() {
        let notices = [
            NoticeOrText::from(Notice::StageBegins),
            NoticeOrText::from(Notice::RequestStaysOpen { answers: 2 }),
            NoticeOrText::from(Notice::AuthorityRevoked { trigger: Box::default() }),
        ];
        for notice in notices {
            let json = serde_json::to_string(&notice).unwrap();
            assert_eq!(serde_json::from_str::<NoticeOrText>(&json).unwrap(), notice, "{json}");
        }
        for json in ["\"the stage begins\"", "\"\""] {
            let text: NoticeOrText = serde_json::from_str(json).unwrap();
            assert!(text.notice().is_none());
            assert_eq!(serde_json::to_string(&text).unwrap(), json);
        }
        assert!(serde_json::from_str::<NoticeOrText>("{\"notice\":\"unknown-to-this-build\"}").is_err());
    }
}
