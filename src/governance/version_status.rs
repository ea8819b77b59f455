//! What a version is now, from its lifecycle row, and which reasons can explain that.
//!
//! One total function. The evidence of a version keeps the reasons of its newest decision also after its state has changed for
//! another cause; those reasons explain the new state no longer. Owns no sentence and no history.

use super::decision::ReasonCode;
use super::lifecycle::{State, VersionFlags};

crate::closed_set! {
    /// What a version is now. Of several that apply, the one that has to end first.
    VersionCondition, "condition of a version", {
        /// A candidate that waits for its next stage.
        Queued = "queued",
        /// A stage runs.
        Running = "running",
        /// A person paused it before it was active.
        Paused = "paused",
        /// Approvers are asked about its activation.
        AwaitingApproval = "awaiting-approval",
        /// The gate or an unanswered request holds it until a person resumes it.
        Held = "held",
        /// It left evaluation or control, and waits for a person to evaluate it again.
        Demoted = "demoted",
        /// It is in control, and its provisional window is not over.
        Provisional = "provisional",
        /// It is in control, and a person paused its promotion.
        PromotionPaused = "promotion-paused",
        /// It is in control within a tighter envelope.
        Restricted = "restricted",
        /// It is in control and confirmed.
        Confirmed = "confirmed",
        /// It is in control, and the rollback ladder takes that away.
        Leaving = "leaving",
        /// Another version replaced it.
        Superseded = "superseded",
        /// It was rejected, for good.
        Rejected = "rejected",
        /// It was rolled back, for good.
        RolledBack = "rolled-back",
    }
}

impl VersionCondition {
    /// The condition of a version; `held` if the gate or an unanswered request holds it.
    #[must_use]
    pub const fn of(state: State, flags: &VersionFlags, held: bool) -> Self {
        match state {
            State::Rejected => Self::Rejected,
            State::RolledBack => Self::RolledBack,
            State::Superseded => Self::Superseded,
            State::Active if flags.rollback_pending => Self::Leaving,
            State::Active if flags.paused => Self::PromotionPaused,
            State::Active if flags.restricted => Self::Restricted,
            State::Active if flags.provisional => Self::Provisional,
            State::Active => Self::Confirmed,
            State::Registered | State::Validated | State::Sandboxed | State::Shadowed | State::Demoted => {
                if flags.paused {
                    Self::Paused
                } else if flags.running.is_some() {
                    Self::Running
                } else if flags.awaiting_approval {
                    Self::AwaitingApproval
                } else if held {
                    Self::Held
                } else if matches!(state, State::Demoted) {
                    Self::Demoted
                } else {
                    Self::Queued
                }
            }
        }
    }

    /// Whether a reason of the version's newest decision can explain the condition. A version that left for a cause is not
    /// explained by what spoke for it, and one in control not by a question before its activation.
    #[must_use]
    pub const fn is_explained_by(self, code: ReasonCode) -> bool {
        match self {
            Self::Queued | Self::Running | Self::Paused | Self::AwaitingApproval | Self::Held => true,
            Self::Provisional
            | Self::PromotionPaused
            | Self::Restricted
            | Self::Confirmed
            | Self::Leaving
            | Self::Superseded => !matches!(code, ReasonCode::ApprovalPending),
            Self::Demoted | Self::Rejected | Self::RolledBack => !matches!(
                code,
                ReasonCode::InterfaceCompatible
                    | ReasonCode::PolicyCompatible
                    | ReasonCode::BehaviorCompatible
                    | ReasonCode::BehaviorImproved
                    | ReasonCode::RecoveryCompatible
                    | ReasonCode::ShadowClean
                    | ReasonCode::GatePassed
                    | ReasonCode::GateImproved
                    | ReasonCode::ApprovalGranted
                    | ReasonCode::ApprovalNotNeeded
                    | ReasonCode::ApprovalPending
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::lifecycle::Stage;
    use super::*;

    /// Every state with every combination of flags: more than the lifecycle reaches.
    fn rows() -> impl Iterator<Item = (State, VersionFlags, bool)> {
        let stages = || [None].into_iter().chain(Stage::ALL.map(Some));
        State::ALL.into_iter().flat_map(move |state| {
            stages().flat_map(move |running| {
                (0_u8..64).map(move |bits| {
                    let bit = |at: u8| (bits >> at) & 1 == 1;
                    let flags = VersionFlags {
                        running,
                        paused: bit(0),
                        awaiting_approval: bit(1),
                        provisional: bit(2),
                        restricted: bit(3),
                        rollback_pending: bit(4),
                    };
                    (state, flags, bit(5))
                })
            })
        })
    }

    #[test]
    fn no_state_shows_a_reason_of_another() {
        for (state, flags, held) in rows() {
            let condition = VersionCondition::of(state, &flags, held);
            let explained = |code| condition.is_explained_by(code);
            let row = format!("{state} {flags:?} {held}: {condition}");
            if matches!(state, State::Active | State::Superseded | State::Rejected | State::RolledBack) {
                assert!(!explained(ReasonCode::ApprovalPending), "no person is asked: {row}");
            }
            if matches!(state, State::Rejected | State::RolledBack) {
                assert!(!explained(ReasonCode::ShadowClean) && !explained(ReasonCode::GatePassed), "{row}");
                assert_eq!(condition.name(), state.name(), "{row}");
            }
            if condition == VersionCondition::Demoted {
                assert!(!explained(ReasonCode::BehaviorCompatible), "{row}");
            }
            if condition == VersionCondition::AwaitingApproval {
                assert!(flags.awaiting_approval && explained(ReasonCode::ApprovalPending), "{row}");
            }
            // What speaks against a version explains each of its states.
            assert!(explained(ReasonCode::MonitorSafetyTrip), "{row}");
        }
    }

    #[test]
    fn a_condition_is_the_one_that_has_to_end_first() {
        let none = VersionFlags::default();
        let paused = VersionFlags { paused: true, ..none };
        let provisional = VersionFlags { provisional: true, ..none };
        for (state, flags, held, expected) in [
            (State::Registered, none, false, VersionCondition::Queued),
            (
                State::Sandboxed,
                VersionFlags { running: Some(Stage::Shadow), ..none },
                false,
                VersionCondition::Running,
            ),
            (State::Sandboxed, paused, true, VersionCondition::Paused),
            (State::Shadowed, none, true, VersionCondition::Held),
            (
                State::Shadowed,
                VersionFlags { awaiting_approval: true, ..none },
                false,
                VersionCondition::AwaitingApproval,
            ),
            (State::Demoted, none, false, VersionCondition::Demoted),
            (
                State::Demoted,
                VersionFlags { running: Some(Stage::Sandbox), ..none },
                false,
                VersionCondition::Running,
            ),
            (State::Active, none, false, VersionCondition::Confirmed),
            (State::Active, provisional, false, VersionCondition::Provisional),
            (
                State::Active,
                VersionFlags { paused: true, ..provisional },
                false,
                VersionCondition::PromotionPaused,
            ),
            (
                State::Active,
                VersionFlags { restricted: true, ..provisional },
                false,
                VersionCondition::Restricted,
            ),
            (
                State::Active,
                VersionFlags { rollback_pending: true, ..paused },
                false,
                VersionCondition::Leaving,
            ),
        ] {
            assert_eq!(VersionCondition::of(state, &flags, held), expected, "{state} {flags:?}");
        }
    }
}
