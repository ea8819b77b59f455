//! The record of a rollback: what triggered it, how each rung of the ladder ended, and how fast.
//!
//! Plain values with the words they are stored as (paper appendix F.3; design rules 3.8 and 3.11). Climbs
//! nothing and measures nothing: the pipeline fills it in.

use holdpoint_body::RATE_HZ;
use serde::{Deserialize, Serialize};

use super::closed_set::convert_equal_terms;
use super::decision::{Reason, ReasonCode};
use super::finding::Finding;
use super::ids::CapabilityId;
use super::lifecycle::DeactivationKind;
use super::monitor::{Rate, RateComparison, SafetyEvent};
use super::notice::NoticeOrText;
use super::past_limit::MeasuredInTask;
use super::shared_event::{SharedEvent, UncomparedReason};

crate::closed_set! {
    /// What a version is rolled back for.
    TriggerKind, "cause of a rollback", {
        /// A safety event, in the tick it happened.
        SafetyEvent = "safety-event",
        /// A charted rate is significantly worse than before activation, or, rollback-coupled, drifts.
        RateTrip = "rate-trip",
        /// No operator answered an escalation by its deadline.
        EscalationUnanswered = "escalation-unanswered",
        /// A person requested the rollback.
        Operator = "operator",
        /// Telemetry stayed away, and its escalation was not answered.
        TelemetrySilence = "telemetry-silence",
        /// The engine came up again and found a rollback unfinished, or a version it cannot watch.
        Restart = "restart",
        /// The concern it was activated with remained on fresh evidence at the end of its window.
        OpenDoubt = "open-doubt",
        /// The store was opened under a profile that the version does not admit, such as another than simulation.
        ProfileNotAdmitted = "profile-not-admitted",
        /// It was activated by break-glass and not reviewed in time.
        Unreviewed = "unreviewed",
    }
}

impl TriggerKind {
    /// The kind that goes with the deciding reason of a monitor. `silent`: the escalation that was not
    /// answered had been raised for want of telemetry.
    #[must_use]
    pub fn of(reasons: &[Reason], silent: bool) -> Self {
        match reasons.first().map(|reason| reason.code) {
            Some(
                ReasonCode::MonitorRateTrip | ReasonCode::MonitorCoupledTrip | ReasonCode::MonitorHarmTrip,
            ) => Self::RateTrip,
            Some(ReasonCode::MonitorOperator) => Self::Operator,
            Some(ReasonCode::MonitorEscalationUnanswered) if silent => Self::TelemetrySilence,
            Some(ReasonCode::MonitorEscalationUnanswered) => Self::EscalationUnanswered,
            // All other causes of a monitor count as a safety event; so does a lost reason.
            _ => Self::SafetyEvent,
        }
    }

    /// Whether the version's own hooks may stop the arm first. Otherwise the interrupt does, and no code of the
    /// version commands the arm any more: after a safety event its code or its guard has failed, at a restart the state of
    /// the arm is unknown, and a version that is not admitted may not move it.
    #[must_use]
    pub const fn permits_hook(self) -> bool {
        match self {
            Self::SafetyEvent | Self::Restart | Self::ProfileNotAdmitted => false,
            Self::RateTrip
            | Self::EscalationUnanswered
            | Self::Operator
            | Self::TelemetrySilence
            | Self::OpenDoubt
            | Self::Unreviewed => true,
        }
    }

    /// Whether only a difference from the rollback target in a fork of the task ends the version for good. Without a
    /// difference, or without a comparison, the version is demoted.
    #[must_use]
    pub const fn needs_difference(self) -> bool {
        matches!(self, Self::SafetyEvent)
    }

    /// Whether the drift monitor decided on the rollback, so that it is about the version's conduct. One by a person, or
    /// by an engine that came up, is not.
    #[must_use]
    pub const fn is_by_monitor(self) -> bool {
        match self {
            Self::SafetyEvent
            | Self::RateTrip
            | Self::EscalationUnanswered
            | Self::TelemetrySilence
            | Self::OpenDoubt => true,
            Self::Operator | Self::Restart | Self::ProfileNotAdmitted | Self::Unreviewed => false,
        }
    }
}

/// The reasons of a rollback by a monitor. Where no one answered a question about rates, the rates are among them.
#[must_use]
pub fn rollback_reasons(decided: &[Reason], question: &[Reason]) -> Vec<Reason> {
    let is_unanswered =
        decided.first().is_some_and(|first| first.code == ReasonCode::MonitorEscalationUnanswered);
    let asked = question.iter().filter(|reason| is_unanswered && rate_of(reason).is_some());
    decided.iter().chain(asked).cloned().collect()
}

/// The rate that a reason is about.
const fn rate_of(reason: &Reason) -> Option<Rate> {
    match reason.finding {
        Some(Finding::RateWorse { rate } | Finding::RateDrifts { rate }) => Some(rate),
        _ => None,
    }
}

/// How a version leaves after a rollback by its monitor for these reasons, unless it shows no difference from the rollback
/// target. People who step in show no difference in its conduct, and anyone may stop the cell: their interventions alone
/// never end a version for good.
#[must_use]
pub fn deactivation_for(reasons: &[Reason]) -> DeactivationKind {
    let mut rates = reasons.iter().filter_map(rate_of).peekable();
    if rates.peek().is_some() && rates.all(|rate| rate == Rate::Intervention) {
        DeactivationKind::Demoted
    } else {
        DeactivationKind::RolledBack
    }
}

crate::closed_set! {
    /// The steps of the ladder, in their order (design rule 3.11).
    Rung, "rung of the ladder", {
        /// The version gives no command any more.
        RevokeAuthority = "revoke-authority",
        /// The version's own rollback hook brings the arm to standstill; left out unless the version passed its rollback drills,
        /// and where no code of it may command the arm.
        RollbackHook = "rollback-hook",
        /// The version's own hook brings the arm to standstill; left out where no code of it may command the arm,
        /// and where the rollback hook did.
        SafeAbort = "safe-abort",
        /// The interrupt that no version can refuse; every joint comes to rest.
        Hold = "hold",
        /// The tool rises clear of everything.
        Retract = "retract",
        /// The rollback target is read from the store again and matches its digest.
        LoadPredecessor = "load-predecessor",
        /// Policy table and context are those of the profile.
        VerifyPolicy = "verify-policy",
        /// With the arm at standstill, the rollback target gives a command that its guard passes.
        ReadyPredecessor = "ready-predecessor",
        /// Binding, pointer and record move together.
        SwapBinding = "swap-binding",
        /// The agent plans again, and the first sequences run under the rollback target.
        Resume = "resume",
    }
}

crate::closed_set! {
    /// Why a rung failed.
    RungFailure, "failure of a rung", {
        /// The version's hook did not bring the arm to standstill; the next rung does.
        HookFailed = "hook-failed",
        /// A joint still moves, or no telemetry shows that it does not.
        NoStandstill = "no-standstill",
        /// The tool could not be lifted clear of its surroundings.
        RetreatBlocked = "retreat-blocked",
        /// There is no rollback target.
        PredecessorMissing = "predecessor-missing",
        /// The rollback target does not load, or differs from its registration.
        DigestMismatch = "digest-mismatch",
        /// The policies in force are not those of the profile.
        PolicyMismatch = "policy-mismatch",
        /// The store could not be read or written.
        StoreFailed = "store-failed",
        /// The rollback target gave no command that its guard passes, or one that no version may give.
        PredecessorFailed = "predecessor-failed",
        /// The first sequences under the rollback target had a safety event, or none could run.
        NotRecovered = "not-recovered",
    }
}

impl RungFailure {
    /// Whether the family is stopped for it. A failed hook does not fail the ladder, and after the swap the rollback
    /// target is in control: an alarm reports its effect, and people judge it.
    #[must_use]
    pub const fn ends_ladder(self) -> bool {
        !matches!(self, Self::HookFailed | Self::NotRecovered)
    }
}

/// How one rung of the ladder ended, and how long it took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RungRecord {
    /// The step of the ladder that was tried.
    pub rung: Rung,
    /// Why it failed; absent if it succeeded.
    pub failure: Option<RungFailure>,
    /// Simulated time it took, ticks; reads and writes take none.
    pub ticks: u64,
    /// [`RungRecord::ticks`] in simulated ms, rounded down.
    pub ms: u64,
    /// What was found.
    pub text: NoticeOrText,
}

impl RungRecord {
    /// A rung with its result and its time.
    #[must_use]
    pub fn new(rung: Rung, failure: Option<RungFailure>, ticks: u64, text: impl Into<NoticeOrText>) -> Self {
        Self { rung, failure, ticks, ms: ticks_to_ms(ticks), text: text.into() }
    }

    /// Whether the ladder continues after it.
    #[must_use]
    pub const fn continues(&self) -> bool {
        match self.failure {
            None => true,
            Some(failure) => !failure.ends_ladder(),
        }
    }
}

/// The trigger of a rollback and its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// The class of the cause, as statistics count it.
    pub kind: TriggerKind,
    /// The safety event, if the kind is one.
    pub event: Option<SafetyEvent>,
    /// The rates that decided, if any did: the rollback target is compared in each. Absent in older records.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rates: Vec<Rate>,
    /// What happened.
    pub text: NoticeOrText,
    /// When it was triggered, in virtual ticks of the live world; times of the rollback count from here.
    pub tick: u64,
    /// The live task of a safety event, with the value and the limit; absent for other kinds, and in older records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredInTask>,
}

crate::closed_set! {
    /// Where a rollback left the version, or its family.
    PostStatus, "end of a rollback", {
        /// Rolled back finally: the version never runs again.
        RolledBack = "rolled-back",
        /// Rolled back and returned to evaluation.
        Demoted = "demoted",
        /// The ladder failed: the family is stopped.
        SafeStopped = "safe-stopped",
    }
}

convert_equal_terms! { DeactivationKind => PostStatus: RolledBack, Demoted }

/// One rollback (paper appendix F.3). Times count from the trigger.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RollbackRecord {
    /// The version that was rolled back, once a candidate.
    pub candidate: CapabilityId,
    /// The version that is in control again; absent if there is none.
    pub predecessor: Option<CapabilityId>,
    /// The trigger of the rollback.
    pub trigger: Trigger,
    /// Whether the arm was at work under the version when it was triggered.
    pub in_flight: bool,
    /// Until every joint was at rest, ticks; absent if that never happened.
    pub time_to_safe_ticks: Option<u64>,
    /// [`RollbackRecord::time_to_safe_ticks`] in simulated ms, rounded down.
    pub time_to_safe_ms: Option<u64>,
    /// Until the rollback target was bound and had given a command its guard passes, ticks; absent if that failed.
    pub time_to_restored_ticks: Option<u64>,
    /// [`RollbackRecord::time_to_restored_ticks`] in simulated ms, rounded down.
    pub time_to_restored_ms: Option<u64>,
    /// Motion that went on after the trigger, braking included, without the rollback hook's, ms. The interrupt of an arm without
    /// a task or a hook counts as none.
    pub unsafe_continuation_ms: u64,
    /// The rungs that were tried, in order.
    pub rungs: Vec<RungRecord>,
    /// The state of the version, or its family, after it.
    pub post_status: PostStatus,
    /// Whether the first tasks under the rollback target ended without a safety event; absent before they ran.
    pub recovered: Option<bool>,
    /// Tasks of the rollback target when that was judged.
    pub resumed_tasks: u32,
    /// The safety event, where the rollback target has the same in a fork of the same task: the version is demoted then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shared: Option<SharedEvent>,
    /// The rates that decided, in forks of the version's live tasks that the rollback target ran: without a difference
    /// the version is demoted. Absent in older records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rates: Option<RateComparison>,
    /// Why the rollback target was not compared on the task of the safety event, or in the rates that decided: the version
    /// is demoted then, too. In older records it was rolled back for good.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncompared: Option<UncomparedReason>,
}

impl RollbackRecord {
    /// The record of a rollback that was triggered and has done nothing yet: the arm was idle, and nothing is in control.
    #[must_use]
    pub const fn triggered(candidate: CapabilityId, trigger: Trigger) -> Self {
        Self {
            candidate,
            predecessor: None,
            trigger,
            in_flight: false,
            time_to_safe_ticks: None,
            time_to_safe_ms: None,
            time_to_restored_ticks: None,
            time_to_restored_ms: None,
            unsafe_continuation_ms: 0,
            rungs: Vec::new(),
            post_status: PostStatus::SafeStopped,
            recovered: None,
            resumed_tasks: 0,
            shared: None,
            rates: None,
            uncompared: None,
        }
    }

    /// Whether the comparison with the rollback target shows no difference, or there is none: then the version is demoted.
    #[must_use]
    pub fn is_unproven(&self) -> bool {
        let is_same = self.rates.as_ref().is_some_and(|rates| !rates.differs());
        is_same || self.shared.is_some() || self.uncompared.is_some()
    }

    /// The failure the family was stopped for.
    #[must_use]
    pub fn stopped_by(&self) -> Option<RungFailure> {
        self.rungs.iter().filter_map(|rung| rung.failure).find(|failure| failure.ends_ladder())
    }
}

/// Simulated milliseconds in a number of ticks, rounded down.
#[must_use]
pub const fn ticks_to_ms(ticks: u64) -> u64 {
    ticks.saturating_mul(1000) / RATE_HZ as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decision::Dimension;

    #[test]
    fn rollback_names_equal_the_stored_names() {
        let name = |value: serde_json::Result<serde_json::Value>| value.unwrap().as_str().unwrap().to_owned();
        for kind in TriggerKind::ALL {
            assert_eq!(name(serde_json::to_value(kind)), kind.name());
        }
        for rung in Rung::ALL {
            assert_eq!(name(serde_json::to_value(rung)), rung.name());
        }
        for failure in RungFailure::ALL {
            assert_eq!(name(serde_json::to_value(failure)), failure.name());
        }
    }

    #[test]
    fn the_deciding_reason_names_the_trigger() {
        for (code, silent, kind) in [
            (ReasonCode::MonitorSafetyTrip, false, TriggerKind::SafetyEvent),
            (ReasonCode::MonitorRateTrip, true, TriggerKind::RateTrip),
            (ReasonCode::MonitorHarmTrip, false, TriggerKind::RateTrip),
            (ReasonCode::MonitorEscalationUnanswered, true, TriggerKind::TelemetrySilence),
            (ReasonCode::MonitorEscalationUnanswered, false, TriggerKind::EscalationUnanswered),
            (ReasonCode::MonitorOperator, false, TriggerKind::Operator),
        ] {
            let reasons = [Reason::coded(code, Dimension::Monitor, Finding::TripHolds)];
            assert_eq!(TriggerKind::of(&reasons, silent), kind, "{code}");
        }
        assert_eq!(TriggerKind::of(&[], false), TriggerKind::SafetyEvent);
    }

    #[test]
    fn interventions_alone_end_no_version_for_good() {
        let of = |finding| Reason::new(Dimension::Monitor, finding);
        let worse = |rate| of(Finding::RateWorse { rate });
        let drifts = |rate| of(Finding::RateDrifts { rate });
        let coupled = || of(Finding::RollbackCoupled);
        let (demoted, rolled_back) = (DeactivationKind::Demoted, DeactivationKind::RolledBack);
        for (reasons, expected) in [
            (vec![worse(Rate::Intervention), drifts(Rate::Intervention)], demoted),
            (vec![coupled(), drifts(Rate::Intervention)], demoted),
            (vec![worse(Rate::Failure), drifts(Rate::Intervention)], rolled_back),
            (vec![coupled(), drifts(Rate::Failure)], rolled_back),
            (vec![of(Finding::EscalationUnanswered)], rolled_back),
            (vec![of(Finding::EscalationUnanswered), drifts(Rate::Intervention)], demoted),
            (Vec::new(), rolled_back),
        ] {
            assert_eq!(deactivation_for(&reasons), expected, "{reasons:?}");
        }
    }

    #[test]
    fn an_unanswered_question_about_rates_names_them() {
        let of = |finding| Reason::new(Dimension::Monitor, finding);
        let unanswered = of(Finding::EscalationUnanswered);
        let drifts = of(Finding::RateDrifts { rate: Rate::Failure });
        let question = [drifts.clone(), of(Finding::TelemetrySilent)];
        let decided = [unanswered.clone()];
        assert_eq!(rollback_reasons(&decided, &question), [unanswered, drifts.clone()]);
        assert_eq!(rollback_reasons(&decided, &[of(Finding::TelemetrySilent)]), decided);
        let worse = [of(Finding::RateWorse { rate: Rate::Retry })];
        assert_eq!(rollback_reasons(&worse, &question), worse, "it does not rest on the question");
    }

    #[test]
    fn no_hook_after_a_safety_event_a_restart_or_without_admission() {
        let without: Vec<_> = TriggerKind::ALL.into_iter().filter(|kind| !kind.permits_hook()).collect();
        let expected = [TriggerKind::SafetyEvent, TriggerKind::Restart, TriggerKind::ProfileNotAdmitted];
        assert_eq!(without, expected);
    }

    #[test]
    fn failed_hook_does_not_end_the_ladder() {
        let rung = |failure| RungRecord::new(Rung::SafeAbort, failure, 24, NoticeOrText::default());
        for (failure, goes_on) in [
            (None, true),
            (Some(RungFailure::HookFailed), true),
            (Some(RungFailure::NotRecovered), true),
            (Some(RungFailure::NoStandstill), false),
            (Some(RungFailure::StoreFailed), false),
        ] {
            assert_eq!(rung(failure).continues(), goes_on, "{failure:?}");
        }
        assert_eq!(rung(None).ms, 100);
    }
}
