//! Refusals, and the rules of the lifecycle by name.

use std::borrow::Cow;

use super::{Stage, State};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// Why an event was refused; nothing changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, serde::Serialize)]
#[serde(rename_all = "kebab-case", tag = "refusal")]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum LifecycleRefusal {
    /// The family has no version at this place.
    #[error("there is no version number {version}")]
    UnknownVersion { version: u16 },
    /// The event, a gerund such as "confirming", does not apply in this state.
    #[error("{event} is not possible in the state {state}; it is from {}", names(allowed))]
    State { event: &'static str, state: State, allowed: Vec<State> },
    /// A person paused the version; it does not advance until it is resumed.
    #[error("the version is paused; resume, reject, demote or roll back are possible")]
    Paused,
    /// Another stage is running, or the named one is not.
    #[error("the running stage is {running:?}, which does not fit")]
    Running { running: Option<Stage> },
    /// Evidence, gate pass or approval is missing, or of earlier circumstances.
    #[error("the {what} is missing or was made under other circumstances")]
    Stale { what: &'static str },
    /// The version's rollback is running; nothing else may happen to it.
    #[error("a rollback is under way")]
    RollbackPending,
    /// The family is safe-stopped: only a reactivation activates.
    #[error("the family is safe-stopped")]
    SafeStopped,
    /// The version is the rollback target of another one and has to stay available.
    #[error("the version is the rollback target of another one and has to stay")]
    Pinned,
    /// A break-glass activation of the family is not reviewed yet.
    #[error("the family's emergency activation is not reviewed yet; nothing of it is promoted before")]
    ReviewOpen,
    /// A condition of the event is not met.
    #[error("{why}")]
    Condition { why: &'static str },
}

impl Hint for LifecycleRefusal {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::UnknownVersion { .. } => ErrorReason::NotFound.into(),
            Self::Stale { .. } => ErrorReason::Stale.into(),
            Self::State { .. }
            | Self::Paused
            | Self::Running { .. }
            | Self::RollbackPending
            | Self::SafeStopped
            | Self::Pinned
            | Self::ReviewOpen
            | Self::Condition { .. } => ErrorReason::NotNow.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Stale { .. } => Some("repeat the stage".into()),
            Self::SafeStopped => Some("reactivate it with a version that was active before".into()),
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

/// The rules of the lifecycle by name; the walk shows that each is needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LifecycleRule {
    /// Activation replaces the active version in the same step.
    SupersedeOld,
    /// An active version leaves by rollback only.
    ActiveLeavesByRollback,
    /// A rollback target cannot be rejected.
    PinPredecessor,
    /// A rollback restores the rollback target in the same step.
    RestorePredecessor,
    /// Without a target the family is stopped.
    StopWithoutTarget,
    /// Command authority is revoked before the binding moves.
    RevokeFirst,
    /// Activation needs a gate pass of the present circumstances.
    BindGate,
    /// Activation needs current approvals, if the profile requires them.
    BindApproval,
    /// An approval names the present row version.
    BindRow,
    /// A gate pass needs sandbox and shadow evidence of the present circumstances.
    BindEvidence,
    /// A changed active version voids comparisons with the old one.
    ActiveChangeVoids,
    /// A changed profile, policy or threshold voids decisions under the old one.
    ContextChangeVoids,
    /// A re-evaluation voids the gate pass and the approvals before it.
    RepeatVoids,
    /// A paused version does not advance.
    PauseBlocks,
    /// Rejected and rolled-back versions stay so.
    TerminalIsFinal,
    /// A stage that ran when the engine stopped is not passed.
    RestartAborts,
    /// In a safe-stopped family, only a reactivation activates.
    StopHolds,
    /// A stage that did not run cannot be passed.
    PassNeedsRun,
    /// While a review is open nothing of the family is promoted.
    ReviewBlocks,
    /// A break-glass activation opens a review.
    EmergencyOpensReview,
    /// A review stays open when its version leaves.
    ReviewOutlives,
    /// An unreviewed version is not confirmed.
    ReviewBeforeConfirm,
    /// A restricted version is not confirmed.
    ReleaseBeforeConfirm,
    /// Lifting a restriction needs current approvals, if the profile requires them.
    BindRelease,
    /// Only a demoted version that was in control before is reactivated.
    RearmActedOnly,
    /// Where people decide, a demoted version other than the family's first comes back through the gate.
    RearmThroughGate,
    /// A restricted version that comes back into control without the gate is restricted.
    RestrictionOutlives,
    /// A version that comes back into control without the gate is provisional if its window was not passed.
    WindowOutlives,
    /// A family's first version is never rejected: a stopped family returns to it.
    KeepFirst,
    /// A stage is repeated on a candidate, not on a version in control.
    RepeatOffControl,
    /// Every change is reported, so that it can be written.
    ReportChanges,
}

/// The rules in force: every one, unless a test's own type omits one.
pub(super) trait LifecycleRules: Copy {
    fn demand(self, _rule: LifecycleRule) -> bool {
        true
    }
}

/// The rules of the program: every one.
#[derive(Clone, Copy)]
pub(super) struct AllLifecycleRules;

impl LifecycleRules for AllLifecycleRules {}
