//! A notice of an event, an alarm, a rollback record or a change of state in words.

use holdpoint_governance::cached_result::CacheLocation;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::{
    AdmissionRefusal, BoundPart, Notice, NoticeOrText, OperatorAct, RequestVoidCause, RetreatObstacle,
};
use holdpoint_governance::past_limit::MeasuredInTask;
use holdpoint_governance::policy_hit::PolicyHit;
use holdpoint_governance::profile::{ProfileName, titled};
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::rollback::RungFailure;
use holdpoint_governance::sensor_health::SensorSignal;
use holdpoint_governance::startup_stop::StartStoppedReason;
use holdpoint_governance::wall_time::WallTime;

use crate::clock::clock_mismatch;
use crate::count::{counted, is_or_are};
use crate::past_limit::{after_event, measured, past_limit, sequence_of_engine};
use crate::policy_hit::policy_hit;
use crate::twin::rate_tallies;

/// What is stated, as one sentence without a full stop. A record of an older build has its sentence, which stays as it is.
#[must_use]
pub fn notice(of: &NoticeOrText) -> String {
    match of {
        NoticeOrText::Notice(notice) => notice_sentence(notice),
        NoticeOrText::Text(text) => text.clone(),
    }
}

/// What a notice states, as one sentence without a full stop.
#[must_use]
pub fn notice_sentence(of: &Notice) -> String {
    use Notice as N;
    match of {
        N::Decided { reason } => coded(reason),
        N::NoReasonGiven => "no reason was given".into(),

        N::Submitted { requester } => format!("submitted by {}", requester.name()),
        N::CommissionedWith => "the version the cell was commissioned with".into(),
        N::FamilyNew => "a new family".into(),
        N::ContractOld => "its component keeps contract 1; build the next one against contract 2".into(),
        N::StageBegins => "the stage begins".into(),
        N::ShadowPassed => "shadow is passed".into(),
        N::GatePassed => "the gate is passed".into(),
        N::WindowPassed => "the provisional window passed without a trip".into(),
        N::OperatorDid { act, by, reason } => format!("{} by {by}: {reason}", operator_act(*act)),
        N::RestrictionLifted { by, reason } => format!("restriction lifted by {by}: {reason}"),
        N::RestrictionLiftedByApprovers { by } => format!("restriction lifted by {by}: people approved it"),
        N::ProfileBlocked { profile, by, reason } => {
            format!("it is blocked under the profile {profile}, by {by}: {reason}")
        }
        N::ProfileUnblocked { profile, by, reason } => {
            format!("it is unblocked under the profile {profile}, by {by}: {reason}")
        }
        N::ProfileUnblockedByReview => {
            "the review of the emergency activation upheld it under this profile".into()
        }
        N::NoActiveVersion => "the family has no active version to compare with".into(),
        N::ActiveOrProfileChanged => "the active version or the profile changed meanwhile".into(),
        N::StageVoidedByRestart => "the engine restarted: the interrupted stage does not count".into(),
        N::RetryInterrupted => "the retried stage was interrupted".into(),
        N::RequestVoidedByRestart => "the engine restarted: approvers are asked again".into(),

        N::ApproversAsked => "approvers are asked".into(),
        N::RequestVoid { version, cause } => {
            format!("{version}: {}; the approval request is void", void_cause(*cause))
        }
        N::RequestRefused { version, problem } => {
            format!("{version}: {problem}; the approval request is void")
        }
        N::ApprovalLapsed => "too few people answered in time; the version is on hold".into(),
        N::ReleaseApproved => "people approved that the restriction is lifted".into(),
        N::ReleaseRefused => "an approver refused to lift the restriction".into(),
        N::ReleaseLapsed => "too few people answered in time; the version stays restricted".into(),
        N::BreakGlassBegins => "one person approves, by break-glass".into(),
        N::BreakGlassUsed => "break-glass was used".into(),
        N::ReviewClosed => "the review is closed".into(),

        N::BindingFirst => "a profile, policies and a robot are in force for the first time".into(),
        N::BindingChanged { parts } => binding_changed(parts),

        N::RollbackContinued => "an interrupted rollback is finished now".into(),
        N::StageRunAgain => "a stage was running; it does not count and is run again".into(),
        N::RolledBackUnadmitted { profile, refusal } => {
            format!("it {} and is demoted", admission_refusal(*refusal, *profile))
        }
        N::WindowRestarts => "it is provisional; its window restarts under a new monitor".into(),
        N::RolledBackUnmonitored { problem } => {
            format!("it cannot be monitored ({problem}) and is rolled back")
        }
        N::RequestStaysOpen { answers } => {
            format!("the approval request stays open, with {}", counted(*answers, "answer"))
        }
        N::ActivationAskedAgain => "approvers had been asked; they are asked again".into(),
        N::ReleaseToAskAgain => {
            "approvers had been asked to lift its restriction; it stays restricted until they are asked again"
                .into()
        }

        N::RollbackInterrupted => "a rollback was interrupted".into(),
        N::OpenedUnderProfile { profile, refusal } => format!(
            "the store was opened under the profile {profile}: the version {}",
            admission_refusal(*refusal, *profile)
        ),
        N::NoMonitorAfterRestart => "no monitor could be set up after a restart".into(),
        N::ReviewLate => "its emergency activation was not reviewed in time".into(),
        N::ReviewNotUpheld { by } => {
            format!("the review of its emergency activation did not uphold it: {}", by.join(", "))
        }
        N::OperatorRollback { by, reason } => format!("operator {by}: {reason}"),
        N::ShiftWithoutTarget => {
            "its behavior shifted, and there is no rollback target to compare it with".into()
        }
        N::DiffersFromShadow { reason } => {
            let why =
                reason.as_ref().map_or_else(String::new, |reason| format!("; {}", crate::reason(reason)));
            format!("it is not what its shadow showed{why}")
        }
        N::ConcernWithoutTarget => {
            "its concern cannot be settled: there is no rollback target to compare it with".into()
        }
        N::ConcernRemains => "the concern it was activated with remains on new evidence".into(),

        N::AuthorityRevoked { trigger } => format!("command authority is revoked: {}", notice(trigger)),
        N::RollbackFailed { failure, trigger } => format!(
            "a rung of the rollback failed ({}); the family is stopped ({})",
            rung_failure(*failure),
            notice(trigger)
        ),

        N::NoMoreCommands => "the version gives no command any more".into(),
        N::HookStopped => "the hook brought the arm to a standstill".into(),
        N::HookDidNotStop => "the hook did not stop the arm; the interrupt takes over".into(),
        N::RollbackHookDidNotStop => {
            "the rollback hook did not stop the arm; the next rung takes over".into()
        }
        N::AtStandstill => "every joint is at standstill".into(),
        N::StillMoving => "a joint still moves after the interrupt".into(),
        N::RetreatSkipped { during: false } => "the cell is stopped; the arm stays where it is".into(),
        N::RetreatSkipped { during: true } => {
            "the cell was stopped during the retreat; the arm stays where it is".into()
        }
        N::ToolClear => "the tool is clear of everything".into(),
        N::RetreatFailed { obstacle, height_mm } => {
            let sign = if *height_mm < 0 { "-" } else { "" };
            let (meters, rest) = (height_mm.unsigned_abs() / 1_000, height_mm.unsigned_abs() % 1_000);
            format!("{}, at {sign}{meters}.{rest:03} m", retreat_obstacle(*obstacle))
        }
        N::BodyFailed { problem } => format!("the body failed: {problem}"),
        N::ArmOutOfReach => "the arm is at work and out of reach".into(),
        N::NoTarget => "there is no rollback target".into(),
        N::TargetNotAdmitted { version, profile, refusal } => {
            format!("there is no rollback target: {version} {}", admission_refusal(*refusal, *profile))
        }
        N::TargetUnreadable { problem } => problem.clone(),
        N::TargetVerified { version } => format!("{version} is in the store and true to its digest"),
        N::PoliciesCompared => "policy table and context against the profile".into(),
        N::TargetReady => "the rollback target gives a command that its guard passes".into(),
        N::TargetCommandForbidden { hit } => {
            format!("the guard refuses the command of the rollback target: {}", policy_hit(*hit))
        }
        N::TargetCommandsDenied { hit } => {
            format!("the guard refuses every command of the rollback target: {}", policy_hit(*hit))
        }
        N::TargetSilent => "the rollback target gives no command".into(),
        N::TargetUnmonitored { version } => {
            format!("no monitor can be set up for {version}, whose window is not passed")
        }
        N::TargetBound { task, planned } => {
            let flight = match task {
                Some(task) => {
                    format!("{} in flight and {planned} planned after it are given up", task.name())
                }
                None => "nothing was in flight".into(),
            };
            format!(
                "the rollback target is bound again; {flight}, the next sequence plans the goal from its first task"
            )
        }
        N::SwapFailed { problem } => format!("the swap could not be written: {problem}"),
        N::RecoveryUnknown => "the engine ended before it was known whether the family recovered".into(),
        N::UnsafeAfterRollback { event, task } => {
            format!("{}, a safety event, in task {task} under it", event.name())
        }
        N::TargetTaskNotReached { sequences } => {
            format!("its task was not reached in {}", counted(*sequences, "sequence"))
        }
        N::SafeAfterRollback { tasks: 1 } => "the first task under it was without a safety event".into(),
        N::SafeAfterRollback { tasks } => {
            format!("the first {tasks} tasks under it were without a safety event")
        }

        N::RolledBack { version, trigger, measured } => {
            format!("{version} was rolled back: {}{}", notice(trigger), after_event(measured.as_ref()))
        }
        N::NotRecovered { family } => {
            format!("{family} runs its rollback target and does not work safely")
        }
        N::SafeStopped { family, failure } => {
            format!("the family {family} is safe-stopped ({}): no version is active", rung_failure(*failure))
        }
        N::Rejected { version } => format!("{version} was rejected"),
        N::WaitsForApproval { version } => format!("{version} waits for approval"),
        N::Unreviewed { version, by } => format!("{version} was activated by {by} alone and is not reviewed"),
        N::Escalated { version, reason } => {
            format!("{version}: people are needed{}", because(reason.as_deref()))
        }
        N::Restricted { version, reason } => format!("{version} is restricted{}", because(reason.as_deref())),
        N::Shifted { version, reasons } => {
            format!("{}behavior shifted: {}", about(version.as_ref()), joined(reasons, crate::reason))
        }
        N::SharedEvent { version, with, shared } => {
            let past = shared.past.map_or_else(String::new, |past| format!(", {}", past_limit(&past)));
            format!(
                "{version} has the same event as {with} in the same scene ({}, seed {}): {}{past}",
                shared.scene,
                shared.seed,
                shared.event.name()
            )
        }
        N::SharedRates { version, with, rates } => format!(
            "no difference of {with} from {version} is shown in the same tasks: {}",
            rate_tallies(rates, &version.to_string())
        ),
        N::OutsideDomain { version, missed, run_by } => {
            let missed: Vec<String> = missed.iter().map(ToString::to_string).collect();
            let effect = match run_by {
                Some(id) if id == version => "it ran the task, which counts as uncovered".to_owned(),
                Some(id) => format!("{id} ran the task"),
                None => "the task is refused: a person has to look at the cell".to_owned(),
            };
            let missed = missed.join("; ");
            format!("the evidence of {version} does not cover the start of its task: {missed}; {effect}")
        }
        N::WeakRecovery { version, reasons } => {
            format!("{}{}", about(version.as_ref()), joined(reasons, weakness))
        }
        N::Harmful { version, reason, sequence } => {
            format!("{version}: {}, {}", crate::reason(reason), sequence_of_engine(*sequence))
        }
        N::LimitViolated { version, hit, measured: found } => limit_violated(version, *hit, found.as_ref()),
        N::Degraded { version, rate } => {
            format!("{version} performs worse than when the cell was commissioned: its {rate} rate")
        }
        N::CameraDegraded { signal, value, limit } => camera_degraded(*signal, *value, *limit),
        N::CacheMismatch { version, active, place, differing, rerun } => {
            let (done, next) = cache_place(*place);
            format!(
                "{differing} of {rerun} cached results of {active} differ from their re-run for {version}: a user with the \
                 key falsified them, or this machine computes other results than the one that cached them; {done}, and the \
                 comparison runs every episode; {next}"
            )
        }
        N::CompiledFormReplaced { version } => format!(
            "another file lay in place of the compiled form of {version}; the engine compiled the component again: check who \
             can write to the store's folder"
        ),
        N::TelemetryQuarantined { file, missing, problem } => {
            let lacks = match missing {
                0 => "every sealed batch".to_owned(),
                lost => format!("every sealed batch but {lost}, and what these held is in no metric"),
            };
            format!("telemetry.db was quarantined as {file}; the new one has {lacks}; why: {problem}")
        }
        N::TelemetryMissing { batches } => format!(
            "{} of telemetry {} missing from telemetry.db, and no record gives the reason: the batches or the file were \
             removed, or the disk lost them; they are in no metric; with a copy of the store, `holdpoint metrics` and \
             `audit verify` show their content",
            counted(*batches, "sealed batch"),
            is_or_are(*batches)
        ),
        N::CheckpointFailed { problem } => {
            format!("a truncated audit chain would go undetected: {problem}")
        }
        N::SocketNameTaken { times } => format!(
            "another program took the name of the engine's socket ({times} since the start) and may have answered clients"
        ),
        N::CameUpStopped { cause } => came_up_stopped(*cause).into(),
        N::CellLost { problem } => format!("the engine stopped the cell: {problem}"),
        N::ClockMismatched { mismatch } => {
            format!("{}; nothing is activated until a person confirms the time", clock_mismatch(mismatch))
        }
        N::ProfileUnauthorized { profile, site, less_strict, summary } => {
            let summary =
                less_strict.as_ref().map_or_else(|| summary.clone(), |extent| extent.summary().into_owned());
            format!(
                "no administrator authorized the profile {} as this program has it ({summary}); nothing becomes active and \
                 the arm stays at standstill until one does: end the engine, `holdpoint profile allow --by admin --reason \
                 TEXT`, and start it again",
                titled(*profile, site.as_ref())
            )
        }
        N::EngineHalted { problem } => problem.clone(),
        N::AlarmUnreadable { alarm } => format!("the alarm {alarm} of an earlier start cannot be read"),
    }
}

/// Why a version is not admitted: the second half of a sentence that begins with the version.
#[must_use]
pub fn admission_refusal(refusal: AdmissionRefusal, profile: ProfileName) -> String {
    match refusal {
        AdmissionRefusal::Undeclared => format!("does not admit the profile {profile}"),
        AdmissionRefusal::Blocked => format!("is blocked under the profile {profile}"),
        AdmissionRefusal::LessStrictGate(AdmissionContext { scripted: true, .. }) => {
            format!("passed its gate in a script, and the profile {profile} needs a gate pass of its own")
        }
        AdmissionRefusal::LessStrictGate(AdmissionContext { class, .. }) => {
            format!("passed its gate under the profile {class}, and {profile} needs a gate pass of its own")
        }
    }
}

/// What a person did to a version.
#[must_use]
pub const fn operator_act(act: OperatorAct) -> &'static str {
    match act {
        OperatorAct::Paused => "paused",
        OperatorAct::Resumed => "resumed",
        OperatorAct::Reactivated => "active again",
        OperatorAct::Rejected => "rejected",
        OperatorAct::Demoted => "demoted",
        OperatorAct::ToRetry => "to be repeated",
    }
}

/// Why a cell comes up stopped.
const fn came_up_stopped(cause: StartStoppedReason) -> &'static str {
    match cause {
        StartStoppedReason::UnrecordedStop => "the cell had been stopped, and the stop was not on record",
        StartStoppedReason::UncleanEnd => {
            "the last engine ended suddenly while it worked the cell: look at the cell first"
        }
    }
}

/// The reason of the stop after a sudden end, with the time of the last engine's last record; a script's has none.
#[must_use]
pub fn stop_after_unclean_end(last_record: Option<WallTime>) -> String {
    let text = came_up_stopped(StartStoppedReason::UncleanEnd);
    last_record.map_or_else(|| text.to_owned(), |at| format!("{text}; its last record is of {}", at.label()))
}

/// The sentence of a reason, after its code.
#[must_use]
pub fn coded(reason: &Reason) -> String {
    format!("{}: {}", reason.code, crate::reason(reason))
}

const fn void_cause(cause: RequestVoidCause) -> &'static str {
    match cause {
        RequestVoidCause::VersionChanged => "the version has changed since",
        RequestVoidCause::TextChanged => "the text that approvers were shown has changed since",
    }
}

fn binding_changed(parts: &[BoundPart]) -> String {
    if parts.is_empty() {
        return "the binding of evidence changed; earlier evidence is void".into();
    }
    let names = parts.iter().map(|part| match part {
        BoundPart::Profile => "the profile",
        BoundPart::Policies => "the policies",
        BoundPart::Robot => "the robot",
        BoundPart::Site => "the site file",
        BoundPart::Build => "the build that computes evidence",
        BoundPart::Scene => "the scene",
    });
    format!("changed: {}; evidence gathered before is void", names.collect::<Vec<_>>().join(", "))
}

const fn retreat_obstacle(obstacle: RetreatObstacle) -> &'static str {
    match obstacle {
        RetreatObstacle::GuardRefused => "the guard refused the way up",
        RetreatObstacle::Touching => "the arm still touches something",
        RetreatObstacle::NoStandstill => "the arm did not come to a standstill",
        RetreatObstacle::NotRisen => "the tool did not rise",
    }
}

fn rung_failure(failure: Option<RungFailure>) -> &'static str {
    failure.map_or("a rung failed", RungFailure::name)
}

fn joined(reasons: &[Reason], sentence: fn(&Reason) -> String) -> String {
    reasons.iter().map(sentence).collect::<Vec<_>>().join("; ")
}

fn weakness(reason: &Reason) -> String {
    let text = crate::reason(reason);
    match (reason.evidence, reason.limit) {
        (Some(found), Some(limit)) => format!("{text} ({found:.2}, at least {limit:.2})"),
        _ => text,
    }
}

/// The version that a sentence is about, if the record names one.
fn about(version: Option<&CapabilityId>) -> String {
    version.map_or_else(String::new, |version| format!("{version}: "))
}

fn because(reason: Option<&Reason>) -> String {
    reason.map_or_else(String::new, |reason| format!(": {}", crate::reason(reason)))
}

/// The value with its limit says more than the kind of violation. The kind stands where no value was measured.
fn limit_violated(version: &CapabilityId, hit: Option<PolicyHit>, found: Option<&MeasuredInTask>) -> String {
    let is_measured = found.is_some_and(|found| found.past.is_some());
    let kind = hit.filter(|_| !is_measured).map(|hit| policy_hit(hit).to_owned());
    let parts: Vec<String> = kind.into_iter().chain(found.map(measured)).collect();
    let colon = if parts.is_empty() { "" } else { ": " };
    format!("{version} violated a limit{colon}{}", parts.join(", "))
}

/// The signal, its value, its limit, and the part to inspect.
fn camera_degraded(signal: SensorSignal, value: Option<f64>, limit: f64) -> String {
    let (scale, unit) = match signal {
        SensorSignal::PictureJitter => (1e3, "mm"),
        SensorSignal::PicturesMissing => (100.0, "%"),
    };
    let shown = |value: f64| match signal {
        SensorSignal::PictureJitter => format!("{:.1} {unit}", value * scale),
        SensorSignal::PicturesMissing => format!("{:.0} {unit}", value * scale),
    };
    let found = value.map_or_else(|| "not measured".into(), shown);
    match signal {
        SensorSignal::PictureJitter => format!(
            "the camera shakes: {found} from frame to frame in the last task, above {}; look at its mount",
            shown(limit)
        ),
        SensorSignal::PicturesMissing => format!(
            "the camera loses frames: {found} in the last task, above {}; look at its cable and its load",
            shown(limit)
        ),
    }
}

/// The effect of a cache mismatch, and the next step of the operator.
const fn cache_place(place: CacheLocation) -> (&'static str, &'static str) {
    match place {
        CacheLocation::Store => (
            "every cached result of the store was deleted",
            "find out who writes to the store's telemetry.db and reads its keys",
        ),
        CacheLocation::Folder => (
            "the shared folder is not used again by this run",
            "find out who writes to the folder and reads its key file, then delete both",
        ),
    }
}
