//! Refusals, and the rules of the lifecycle as switches for the exhaustive walk.

use std::borrow::Cow;

use super::{Stage, State};
use holdpoint_text::Hint;

/// Why an event was refused; nothing changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, serde::Serialize)]
#[serde(rename_all = "kebab-case", tag = "refusal")]
pub enum Refusal {
    /// The family has no such version.
    #[error("there is no version number {version}")]
    UnknownVersion {
        /// The number.
        version: u16,
    },
    /// The event does not apply in this state.
    #[error("{event} is not possible in the state {state}; it is from {}", names(allowed))]
    State {
        /// The event.
        event: &'static str,
        /// The state.
        state: State,
        /// States it is possible from.
        allowed: Vec<State>,
    },
    /// The version is paused.
    #[error("the version is paused; resume, reject, demote or roll back are possible")]
    Paused,
    /// Another stage is running, or the named one is not.
    #[error("the running stage is {running:?}, which does not fit")]
    Running {
        /// What runs.
        running: Option<Stage>,
    },
    /// Evidence, gate pass or approval is missing, or of earlier circumstances.
    #[error("the {what} is missing or was made under other circumstances")]
    Stale {
        /// Which.
        what: &'static str,
    },
    /// A rollback is under way.
    #[error("a rollback is under way")]
    RollbackPending,
    /// The family is safe-stopped.
    #[error("the family is safe-stopped")]
    SafeStopped,
    /// The version is a rollback target.
    #[error("the version is the rollback target of another one and has to stay")]
    Pinned,
    /// A condition of the event does not hold.
    #[error("{why}")]
    Condition {
        /// Which.
        why: &'static str,
    },
}

impl Hint for Refusal {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Stale { .. } => Some("repeat the stage".into()),
            Self::SafeStopped => Some("re-arm it with a version that was active before".into()),
            Self::UnknownVersion { .. }
            | Self::State { .. }
            | Self::Paused
            | Self::Running { .. }
            | Self::RollbackPending
            | Self::Pinned
            | Self::Condition { .. } => None,
        }
    }
}

fn names(states: &[State]) -> String {
    states.iter().map(|state| state.name()).collect::<Vec<_>>().join(", ")
}

/// The rules, each of which can be switched off by the exhaustive walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "one switch for each rule")]
pub struct Rules {
    /// Activation replaces the active version in the same step.
    pub supersede_old: bool,
    /// An active version leaves by rollback only.
    pub active_leaves_by_rollback: bool,
    /// A rollback target cannot be rejected.
    pub pin_predecessor: bool,
    /// A rollback restores the predecessor in the same step.
    pub restore_predecessor: bool,
    /// Without a target the family is stopped.
    pub stop_without_target: bool,
    /// Command authority is revoked before the binding moves.
    pub revoke_first: bool,
    /// Activation needs a gate pass of the present circumstances.
    pub bind_gate: bool,
    /// Activation needs approvals of the present circumstances, where the profile asks for them.
    pub bind_approval: bool,
    /// An approval names the present row version.
    pub bind_row: bool,
    /// A gate pass needs sandbox and shadow evidence of the present circumstances.
    pub bind_evidence: bool,
    /// A changed active version voids what was compared with the old one.
    pub active_change_voids: bool,
    /// A changed profile, policy or threshold voids what was decided under the old one.
    pub context_change_voids: bool,
    /// A re-evaluation voids the gate pass and the approvals before it.
    pub repeat_voids: bool,
    /// A paused version does not advance.
    pub pause_blocks: bool,
    /// Rejected and rolled-back versions stay so.
    pub terminal_is_final: bool,
    /// What ran when the engine stopped is not done.
    pub restart_aborts: bool,
    /// A safe-stopped family activates by re-arming only.
    pub stop_holds: bool,
    /// A stage that did not run cannot be passed.
    pub pass_needs_run: bool,
    /// Every change is reported, so that it can be written.
    pub report_changes: bool,
}

impl Rules {
    /// Every rule: what the program uses.
    pub const ALL: Self = Self {
        supersede_old: true,
        active_leaves_by_rollback: true,
        pin_predecessor: true,
        restore_predecessor: true,
        stop_without_target: true,
        revoke_first: true,
        bind_gate: true,
        bind_approval: true,
        bind_row: true,
        bind_evidence: true,
        active_change_voids: true,
        context_change_voids: true,
        repeat_voids: true,
        pause_blocks: true,
        terminal_is_final: true,
        restart_aborts: true,
        stop_holds: true,
        pass_needs_run: true,
        report_changes: true,
    };
}
