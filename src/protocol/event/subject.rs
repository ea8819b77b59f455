//! The version that an event is about.

use holdpoint_governance::ids::CapabilityId;

use super::EventKind;

impl EventKind {
    /// The version of an event; absent if the event concerns the whole cell, or a file.
    #[must_use]
    pub const fn version(&self) -> Option<&CapabilityId> {
        match self {
            Self::Recovered { version, .. }
            | Self::Registered { version, .. }
            | Self::StageStarted { version, .. }
            | Self::Progress { version, .. }
            | Self::Decided { version, .. }
            | Self::StateChanged { version, .. }
            | Self::ApprovalRequested { version, .. }
            | Self::ApprovalReceived { version, .. }
            | Self::Activated { version, .. }
            | Self::Confirmed { version, .. }
            | Self::Monitor { version, .. }
            | Self::HarmPastLimit { version, .. }
            | Self::Rung { version, .. }
            | Self::RolledBack { version, .. }
            | Self::Continued { version, .. }
            | Self::Released { version, .. }
            | Self::Resumed { version, .. }
            | Self::ProfilesSet { version, .. }
            | Self::AnchorSet { version, .. }
            | Self::TriesReviewed { version, .. }
            | Self::BreakGlass { version, .. }
            | Self::Reviewed { version, .. }
            | Self::AuditClosed { version, .. } => Some(version),
            Self::Recorded { version, .. } => version.as_ref(),
            Self::EngineStarted { .. }
            | Self::Sequence { .. }
            | Self::Drift { .. }
            | Self::LiveFault { .. }
            | Self::GoalSet { .. }
            | Self::ShiftNote { .. }
            | Self::Commissioned { .. }
            | Self::SensesCommissioned { .. }
            | Self::CellStopped { .. }
            | Self::ArmStands { .. }
            | Self::CellReleased { .. }
            | Self::Pace { .. }
            | Self::Alarm { .. }
            | Self::Voided { .. }
            | Self::RecordingKept { .. }
            | Self::Scene { .. }
            | Self::CommandRefused { .. }
            | Self::Fault { .. } => None,
        }
    }
}
