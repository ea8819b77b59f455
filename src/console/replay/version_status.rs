//! The state of the version after each event, from the events alone.
//!
//! Must not guess: before the first event about the version, its state is unknown.

use super::charts::ChartGroup;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_protocol::event::{Event, EventKind};

/// The state of a version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VersionStatus {
    /// Its state; absent before its first event.
    pub state: Option<State>,
    pub flags: VersionFlags,
}

impl VersionStatus {
    /// The charts that matter most in this state.
    #[must_use]
    pub const fn charts(&self) -> ChartGroup {
        match (self.flags.running, self.state) {
            (Some(Stage::Shadow), _) => ChartGroup::Shadow,
            (Some(Stage::Validation | Stage::Sandbox | Stage::Activation), _) => ChartGroup::Kappa,
            (None, Some(State::Active | State::RolledBack)) => ChartGroup::Monitor,
            (None, Some(State::Shadowed)) => ChartGroup::Shadow,
            (
                None,
                Some(
                    State::Validated
                    | State::Sandboxed
                    | State::Rejected
                    | State::Demoted
                    | State::Registered
                    | State::Superseded,
                )
                | None,
            ) => ChartGroup::Kappa,
        }
    }

    /// Whether the version is evaluated apart from the live cell.
    #[must_use]
    pub const fn is_offline(&self) -> bool {
        matches!(self.flags.running, Some(Stage::Validation | Stage::Sandbox))
    }
}

/// The state of `version` after each of the events.
#[must_use]
pub fn after_each(version: &CapabilityId, events: &[Event]) -> Vec<VersionStatus> {
    let mut status = VersionStatus::default();
    let fold = |event: &Event| {
        apply(&mut status, version, &event.kind);
        status
    };
    events.iter().map(fold).collect()
}

fn apply(status: &mut VersionStatus, version: &CapabilityId, kind: &EventKind) {
    let VersionStatus { state, flags } = status;
    match kind {
        EventKind::Registered { version: of, .. } if of == version => *state = Some(State::Registered),
        EventKind::StateChanged { version: of, to, .. } if of == version => {
            *state = Some(*to);
            flags.running = None;
            flags.awaiting_approval = false;
            if *to != State::Active {
                *flags = VersionFlags::default();
            }
        }
        EventKind::StageStarted { version: of, stage, .. } if of == version => flags.running = Some(*stage),
        EventKind::Decided { version: of, .. } if of == version => flags.running = None,
        EventKind::ApprovalRequested { version: of, .. } if of == version => flags.awaiting_approval = true,
        EventKind::ApprovalReceived { version: of, have, needed, .. } if of == version && have >= needed => {
            flags.awaiting_approval = false;
        }
        EventKind::Activated { version: of, provisional_episodes, .. } if of == version => {
            *state = Some(State::Active);
            *flags = VersionFlags { provisional: *provisional_episodes > 0, ..VersionFlags::default() };
        }
        EventKind::Confirmed { version: of, .. } if of == version => flags.provisional = false,
        EventKind::Monitor { version: of, decision, .. } if of == version => match decision {
            MonitorOutcome::Restrict => flags.restricted = true,
            MonitorOutcome::Rollback => flags.rollback_pending = true,
            MonitorOutcome::Continue
            | MonitorOutcome::Escalate
            | MonitorOutcome::Settled
            | MonitorOutcome::DoubtRemains => {}
        },
        EventKind::Rung { version: of, .. } if of == version => flags.rollback_pending = true,
        EventKind::RolledBack { version: of, .. } if of == version => *flags = VersionFlags::default(),
        // An event about another version, or without a change of state.
        _ => {}
    }
}
