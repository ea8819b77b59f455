//! Refusals, and the rules of the lifecycle by name.

use std::borrow::Cow;

use super::{Stage, State};
use holdpoint_text::Hint;

/// Why an event was refused; nothing changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, serde::Serialize)]
#[serde(rename_all = "kebab-case", tag = "refusal")]
pub enum Refusal {
    /// The family has no version at this place.
    #[error("there is no version number {version}")]
    UnknownVersion {
        /// The place that was named, counted from 0.
        version: u16,
    },
    /// The event does not apply in this state.
    #[error("{event} is not possible in the state {state}; it is from {}", names(allowed))]
    State {
        /// What was to be done, as a gerund for the message, e.g. "confirming".
        event: &'static str,
        /// The state the version is in.
        state: State,
        /// States in which the event is possible.
        allowed: Vec<State>,
    },
    /// A person holds the version; it does not advance until it is resumed.
    #[error("the version is paused; resume, reject, demote or roll back are possible")]
    Paused,
    /// Another stage is running, or the named one is not.
    #[error("the running stage is {running:?}, which does not fit")]
    Running {
        /// The stage that is running; `None`: none is.
        running: Option<Stage>,
    },
    /// Evidence, gate pass or approval is missing, or of earlier circumstances.
    #[error("the {what} is missing or was made under other circumstances")]
    Stale {
        /// What is missing or stale: evidence, gate pass or approval.
        what: &'static str,
    },
    /// The version's ladder is under way; nothing else may happen to it.
    #[error("a rollback is under way")]
    RollbackPending,
    /// The family is safe-stopped: it activates by re-arming only.
    #[error("the family is safe-stopped")]
    SafeStopped,
    /// The version is the rollback target of another one and has to stay available.
    #[error("the version is the rollback target of another one and has to stay")]
    Pinned,
    /// An emergency activation of the family is not reviewed yet.
    #[error("the family's emergency activation is not reviewed yet; nothing of it is promoted before")]
    ReviewOpen,
    /// A condition of the event does not hold.
    #[error("{why}")]
    Condition {
        /// The condition in words, as the operator reads it.
        why: &'static str,
    },
}

impl Hint for Refusal {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Stale { .. } => Some("repeat the stage".into()),
            Self::SafeStopped => Some("re-arm it with a version that was active before".into()),
            Self::ReviewOpen => {
                Some("two people review it first: `holdpoint status` shows the question".into())
            }
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

/// The rules of the lifecycle by name: what the transition function asks about, each shown to be needed by the walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LifecycleRule {
    /// Activation replaces the active version in the same step.
    SupersedeOld,
    /// An active version leaves by rollback only.
    ActiveLeavesByRollback,
    /// A rollback target cannot be rejected.
    PinPredecessor,
    /// A rollback restores the predecessor in the same step.
    RestorePredecessor,
    /// Without a target the family is stopped.
    StopWithoutTarget,
    /// Command authority is revoked before the binding moves.
    RevokeFirst,
    /// Activation needs a gate pass of the present circumstances.
    BindGate,
    /// Activation needs approvals of the present circumstances, if the profile asks for them.
    BindApproval,
    /// An approval names the present row version.
    BindRow,
    /// A gate pass needs sandbox and shadow evidence of the present circumstances.
    BindEvidence,
    /// A changed active version voids what was compared with the old one.
    ActiveChangeVoids,
    /// A changed profile, policy or threshold voids what was decided under the old one.
    ContextChangeVoids,
    /// A re-evaluation voids the gate pass and the approvals before it.
    RepeatVoids,
    /// A paused version does not advance.
    PauseBlocks,
    /// Rejected and rolled-back versions stay so.
    TerminalIsFinal,
    /// What ran when the engine stopped is not done.
    RestartAborts,
    /// A safe-stopped family activates by re-arming only.
    StopHolds,
    /// A stage that did not run cannot be passed.
    PassNeedsRun,
    /// While a review is open nothing of the family is promoted.
    ReviewBlocks,
    /// An emergency activation opens a review.
    EmergencyOpensReview,
    /// A review stays open when its version leaves.
    ReviewOutlives,
    /// An unreviewed version is not confirmed.
    ReviewBeforeConfirm,
    /// A restricted version is not confirmed.
    ReleaseBeforeConfirm,
    /// A restriction is lifted with present approvals, if the profile asks for them.
    BindRelease,
    /// A demoted version is re-armed only if it was in control before.
    RearmActedOnly,
    /// Where people decide, a demoted version other than the family's first comes back through the gate.
    RearmThroughGate,
    /// A restricted version that comes back into control without the gate is restricted.
    RestrictionOutlives,
    /// A version that comes back into control without the gate is provisional if its window was not passed.
    WindowOutlives,
    /// A family's first version is never rejected: it is what a stopped family goes back to.
    KeepFirst,
    /// A stage is repeated on a candidate, not on a version in control.
    RepeatOffControl,
    /// Every change is reported, so that it can be written.
    ReportChanges,
}

/// Which rules are demanded: every one, unless a test says otherwise by a type of its own.
pub(super) trait Rules: Copy {
    fn demand(self, _rule: LifecycleRule) -> bool {
        true
    }
}

/// What the program demands: every rule.
#[derive(Clone, Copy)]
pub(super) struct All;

impl Rules for All {}
