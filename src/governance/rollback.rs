//! The record of a rollback: what triggered it, how each rung of the ladder ended, and how fast.
//!
//! Plain values with the words they are stored as (paper appendix F.3; design rules 3.8 and 3.11). Climbs
//! nothing and measures nothing: the pipeline fills it in.

use holdpoint_body::RATE_HZ;
use serde::{Deserialize, Serialize};

use super::decision::{Reason, ReasonCode};
use super::ids::CapabilityId;
use super::lifecycle::Leave;
use super::monitor::SafetyEvent;
use super::words::same_words;

crate::words! {
    /// What a version is taken off for.
    TriggerKind, "cause of a rollback", {
        /// A safety event, in the tick it happened.
        SafetyEvent = "safety-event",
        /// A charted rate is established as worse than before activation, or, rollback-coupled, drifts.
        RateTrip = "rate-trip",
        /// Nobody answered an escalation by its deadline.
        EscalationUnanswered = "escalation-unanswered",
        /// A person asked for the rollback.
        Operator = "operator",
        /// Telemetry stayed away, and nobody answered the escalation it raised.
        TelemetrySilence = "telemetry-silence",
        /// The engine came up again and found a rollback unfinished, or a version it cannot watch.
        Restart = "restart",
        /// The doubt it was let in with remained on fresh evidence at the end of its window.
        OpenDoubt = "open-doubt",
        /// The store was opened under a profile that the version does not admit, such as another than simulation.
        ProfileNotAdmitted = "profile-not-admitted",
        /// It was let in by the emergency door, and nobody reviewed that in time.
        Unreviewed = "unreviewed",
    }
}

impl TriggerKind {
    /// The kind that goes with the deciding reason of a monitor. `silent`: the escalation that was not
    /// answered had been raised for want of telemetry.
    #[must_use]
    pub fn of(reasons: &[Reason], silent: bool) -> Self {
        match reasons.first().map(|reason| reason.code) {
            Some(ReasonCode::MonitorRateTrip | ReasonCode::MonitorCoupledTrip) => Self::RateTrip,
            Some(ReasonCode::MonitorOperator) => Self::Operator,
            Some(ReasonCode::MonitorEscalationUnanswered) if silent => Self::TelemetrySilence,
            Some(ReasonCode::MonitorEscalationUnanswered) => Self::EscalationUnanswered,
            // What else a monitor rolls back for is a safety event; so is a reason that got lost.
            _ => Self::SafetyEvent,
        }
    }
}

crate::words! {
    /// The steps of the ladder, in their order (design rule 3.11).
    Rung, "rung of the ladder", {
        /// The version gives no command any more.
        RevokeAuthority = "revoke-authority",
        /// The version's own hook brings the arm to a stand.
        SafeAbort = "safe-abort",
        /// The interrupt that no version can refuse; every joint stands.
        Hold = "hold",
        /// The tool rises clear of everything.
        Retract = "retract",
        /// The predecessor is read from the store again, true to its digest.
        LoadPredecessor = "load-predecessor",
        /// Policy table and context are those of the profile.
        VerifyPolicy = "verify-policy",
        /// Beside the standing arm the predecessor gives a command that its guard passes.
        ReadyPredecessor = "ready-predecessor",
        /// Binding, pointer and record move together.
        SwapBinding = "swap-binding",
        /// The agent plans again, and the first sequences are worked under the predecessor.
        Resume = "resume",
    }
}

crate::words! {
    /// Why a rung did not hold.
    RungFailure, "failure of a rung", {
        /// The version's hook did not bring the arm to a stand; the interrupt is there for that.
        HookFailed = "hook-failed",
        /// A joint still moves, or no telemetry shows that it does not.
        NoStandstill = "no-standstill",
        /// The tool could not be lifted clear of what is around it.
        RetreatBlocked = "retreat-blocked",
        /// There is no predecessor to go back to.
        PredecessorMissing = "predecessor-missing",
        /// The predecessor in the store does not load, or is not what was registered.
        DigestMismatch = "digest-mismatch",
        /// The policies in force are not those of the profile.
        PolicyMismatch = "policy-mismatch",
        /// The store could not be read or written.
        StoreFailed = "store-failed",
        /// The predecessor gave no command that its guard passes, or one that no version may give.
        PredecessorFailed = "predecessor-failed",
        /// The first sequences under the predecessor had a safety event, or none could be worked.
        NotRecovered = "not-recovered",
    }
}

impl RungFailure {
    /// Whether the family is stopped for it. A hook that fails is no failed ladder, and after the swap the
    /// predecessor is in control: what it does then is said, with an alarm, and is for people to judge.
    #[must_use]
    pub const fn ends_ladder(self) -> bool {
        !matches!(self, Self::HookFailed | Self::NotRecovered)
    }
}

/// How one rung of the ladder ended, and how long it took.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RungRecord {
    /// The step of the ladder that was tried.
    pub rung: Rung,
    /// Why it did not hold; absent if it held.
    pub failure: Option<RungFailure>,
    /// Simulated time it took, ticks; what only reads and writes takes none.
    pub ticks: u64,
    /// [`RungRecord::ticks`] in simulated ms, rounded down.
    pub ms: u64,
    /// What was found, one sentence for the operator.
    pub text: String,
}

impl RungRecord {
    /// A rung with its result and its time.
    #[must_use]
    pub fn new(rung: Rung, failure: Option<RungFailure>, ticks: u64, text: impl Into<String>) -> Self {
        Self { rung, failure, ticks, ms: ticks_to_ms(ticks), text: text.into() }
    }

    /// Whether the ladder goes on after it.
    #[must_use]
    pub const fn goes_on(&self) -> bool {
        match self.failure {
            None => true,
            Some(failure) => !failure.ends_ladder(),
        }
    }
}

/// What set a rollback off, and when.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trigger {
    /// The class of the cause, as statistics count it.
    pub kind: TriggerKind,
    /// The safety event, if the kind is one.
    pub event: Option<SafetyEvent>,
    /// What happened, one sentence for the operator.
    pub text: String,
    /// When it was triggered, in virtual ticks of the live world; times of the rollback count from here.
    pub tick: u64,
}

crate::words! {
    /// Where a rollback left the version, or its family.
    PostStatus, "end of a rollback", {
        /// Taken off for good: the version never runs again.
        RolledBack = "rolled-back",
        /// Taken off and sent back to evaluation.
        Demoted = "demoted",
        /// The ladder failed: the family is stopped.
        SafeStopped = "safe-stopped",
    }
}

same_words! { Leave => PostStatus: RolledBack, Demoted }

/// One rollback (paper appendix F.3). Times count from the trigger.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RollbackRecord {
    /// The version that was taken off, once a candidate.
    pub candidate: CapabilityId,
    /// The version that is in control again; absent if nobody is.
    pub predecessor: Option<CapabilityId>,
    /// What set the rollback off.
    pub trigger: Trigger,
    /// Whether the arm was at work under the version when it was triggered.
    pub in_flight: bool,
    /// Until every joint stood, ticks; absent if they never did.
    pub time_to_safe_ticks: Option<u64>,
    /// [`RollbackRecord::time_to_safe_ticks`] in simulated ms, rounded down.
    pub time_to_safe_ms: Option<u64>,
    /// Until the predecessor was bound and had given a command its guard passes, ticks; absent if that failed.
    pub time_to_restored_ticks: Option<u64>,
    /// [`RollbackRecord::time_to_restored_ticks`] in simulated ms, rounded down.
    pub time_to_restored_ms: Option<u64>,
    /// Motion that went on after the trigger, without what braking takes, ms.
    pub unsafe_continuation_ms: u64,
    /// The rungs that were tried, in order.
    pub rungs: Vec<RungRecord>,
    /// How the version, or its family, stands after it.
    pub post_status: PostStatus,
    /// Whether the first tasks under the predecessor ended without a safety event; absent before they were worked.
    pub recovered: Option<bool>,
    /// Tasks the predecessor had worked when that was judged.
    pub resumed_tasks: u32,
}

impl RollbackRecord {
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
    fn names_are_what_is_stored() {
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
            (ReasonCode::MonitorEscalationUnanswered, true, TriggerKind::TelemetrySilence),
            (ReasonCode::MonitorEscalationUnanswered, false, TriggerKind::EscalationUnanswered),
            (ReasonCode::MonitorOperator, false, TriggerKind::Operator),
        ] {
            let reasons = [Reason::new(code, Dimension::Monitor, "why")];
            assert_eq!(TriggerKind::of(&reasons, silent), kind, "{code}");
        }
        assert_eq!(TriggerKind::of(&[], false), TriggerKind::SafetyEvent);
    }

    #[test]
    fn a_failed_hook_is_no_failed_ladder() {
        let rung = |failure| RungRecord::new(Rung::SafeAbort, failure, 24, "");
        for (failure, goes_on) in [
            (None, true),
            (Some(RungFailure::HookFailed), true),
            (Some(RungFailure::NotRecovered), true),
            (Some(RungFailure::NoStandstill), false),
            (Some(RungFailure::StoreFailed), false),
        ] {
            assert_eq!(rung(failure).goes_on(), goes_on, "{failure:?}");
        }
        assert_eq!(rung(None).ms, 100);
    }
}
