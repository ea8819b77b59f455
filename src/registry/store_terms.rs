//! The closed sets of terms that only the store has. The schema repeats each set as a CHECK.

use holdpoint_governance::closed_set;
use holdpoint_governance::record::RecordKind;

/// Whether only the store writes records of a kind; callers may not use it.
pub(crate) const fn is_own(kind: RecordKind) -> bool {
    match kind {
        RecordKind::VersionRegistered
        | RecordKind::StateSet
        | RecordKind::FlagsSet
        | RecordKind::ScoresSet
        | RecordKind::ActiveSet
        | RecordKind::FamilySet
        | RecordKind::FamilyVoided
        | RecordKind::StandingSet
        | RecordKind::EvidencePut
        | RecordKind::ApprovalRequested
        | RecordKind::ApprovalPut
        | RecordKind::ApprovalConsumed
        | RecordKind::PersonEnrolled
        | RecordKind::PersonConfirmed
        | RecordKind::PersonRevoked
        | RecordKind::ContextSet
        | RecordKind::TelemetrySealed
        | RecordKind::TelemetryBlockSealed
        | RecordKind::TelemetryPruned
        | RecordKind::TelemetryMissed
        | RecordKind::AlarmChanged
        | RecordKind::WitnessSet
        | RecordKind::ProfileAllowed
        | RecordKind::StoreRebuilt => true,
        RecordKind::ProfileLoaded
        | RecordKind::Decision
        | RecordKind::Monitor
        | RecordKind::MonitorAnswer
        | RecordKind::ProfilesSet
        | RecordKind::AnchorSet
        | RecordKind::KeyCommitted
        | RecordKind::KeyRevealed
        | RecordKind::TryCounted
        | RecordKind::TriesReviewed
        | RecordKind::PauseSet
        | RecordKind::Resumed
        | RecordKind::BreakGlass
        | RecordKind::BreakGlassReviewed
        | RecordKind::Shown
        | RecordKind::ClockDoubted
        | RecordKind::ClockConfirmed
        | RecordKind::AlarmReset
        | RecordKind::Asked
        | RecordKind::Drift
        | RecordKind::KeptVoided
        | RecordKind::LiveFault
        | RecordKind::GoalSet
        | RecordKind::PaceSet
        | RecordKind::ShiftNote
        | RecordKind::CellStopped
        | RecordKind::CellReleased
        | RecordKind::EngineBegan
        | RecordKind::EngineEnded
        | RecordKind::Commissioned
        | RecordKind::LiveHarm
        | RecordKind::SensesCommissioned
        | RecordKind::AuditClosed
        | RecordKind::Recording
        | RecordKind::RecordingRemoved => false,
    }
}

closed_set! {
    /// The subject of a piece of evidence.
    EvidenceKind, "kind of evidence", {
        /// Compatibility report (the four checks).
        Compat = "compat",
        Sandbox = "sandbox",
        Shadow = "shadow",
        Gate = "gate",
        Activation = "activation",
        /// Monitor decision or summary.
        Monitor = "monitor",
        Rollback = "rollback",
        Drill = "drill",
    }
}

closed_set! {
    /// The state of a request for approval.
    RequestState, "state of an approval request", {
        Open = "open",
        /// It has enough approvals.
        Granted = "granted",
        Refused = "refused",
        /// No answer in time: the version is on hold.
        Expired = "expired",
        /// Its subject has changed.
        Void = "void",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::ApprovalDecision;
    use holdpoint_governance::lifecycle::{Stage, State};

    #[test]
    fn stored_names_are_those_of_lifecycle_and_schema() {
        let schema = include_str!("schema/store-1.sql");
        let all = (State::ALL.map(State::name).into_iter())
            .chain(Stage::ALL.map(Stage::name))
            .chain(EvidenceKind::ALL.map(EvidenceKind::name))
            .chain(ApprovalDecision::ALL.map(ApprovalDecision::name))
            .chain(RequestState::ALL.map(RequestState::name));
        for name in all {
            assert!(schema.contains(&format!("'{name}'")), "{name}");
        }
        assert!("Active".parse::<State>().is_err());
    }
}
