//! The status of a version: what it is now, since when, by whom or by which rule, what it waits for, and what ends that.
//!
//! One total function of the lifecycle row and the record. The evidence of a version keeps the reasons of its newest decision
//! also after its state has changed for another cause; those reasons explain the new state no longer. Owns no sentence.

mod recorded_changes;

pub use recorded_changes::{RecordedChange, RecordedChanges};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::decision::{Reason, ReasonCode, lead_reason};
use super::explanation::RecordMoment;
use super::ids::CapabilityId;
use super::lifecycle::{Stage, State, VersionFlags};
use super::notice::{Notice, NoticeOrText};

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
    /// The condition of a version; `held` if the gate, an unanswered request or an act that cannot be written holds it.
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
                } else if flags.awaiting_approval {
                    // The gate's stage runs until they answer.
                    Self::AwaitingApproval
                } else if held {
                    Self::Held
                } else if flags.running.is_some() {
                    Self::Running
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

crate::closed_set! {
    /// What ends a condition.
    ConditionEnd, "end of a condition", {
        /// An engine starts the next stage.
        StageStart = "stage-start",
        /// The stage that runs ends.
        StageEnd = "stage-end",
        /// A person resumes the version.
        Resumption = "resumption",
        /// Approvers answer, or their deadline passes.
        Answers = "answers",
        /// A person has the sandbox or shadow run again.
        Retry = "retry",
        /// The provisional window passes, and fresh evidence settles each concern.
        Window = "window",
        /// A person lifts the restriction.
        Release = "release",
        /// The rollback ladder ends.
        Ladder = "ladder",
        /// Another version replaces it, or it is rolled back.
        Replacement = "replacement",
        /// The version in control is rolled back to it.
        Return = "return",
        /// Nothing.
        Nothing = "nothing",
    }
}

crate::closed_set! {
    /// What another version does that a queued one waits for.
    RunningWork, "work that runs", {
        /// Its validation.
        Validation = "validation",
        /// Its sandbox.
        Sandbox = "sandbox",
        /// Its shadow.
        Shadow = "shadow",
        /// Its gate.
        Activation = "activation",
        /// Its confirmation, in control.
        Confirmation = "confirmation",
        /// Its re-evaluation, in control.
        ReEvaluation = "re-evaluation",
    }
}

/// Why a candidate stands still that no person holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "obstacle")]
pub enum Obstacle {
    /// No engine runs.
    EngineAbsent,
    /// The engine is halted after a fault of its own.
    EngineHalted,
    /// A person stopped the cell.
    CellStopped,
    /// Its family has no active version to compare it with.
    NoActiveVersion,
    /// A break-glass activation in its family has no review yet.
    ReviewOf {
        /// The activated version.
        version: CapabilityId,
    },
    /// Another version is at work: one runs at a time.
    Behind {
        /// The other version.
        version: CapabilityId,
        /// What runs.
        work: RunningWork,
    },
}

/// The status of a version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VersionStatus {
    /// What it is.
    pub condition: VersionCondition,
    /// The stage that runs, or that is next; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<Stage>,
    /// Since when; absent if no record of it was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<RecordMoment>,
    /// Who made it so and why, or by which rule; absent if nothing on record says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<NoticeOrText>,
    /// Why it stands still although no person holds it; absent if it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub obstacle: Option<Obstacle>,
    /// What ends it.
    pub ends: ConditionEnd,
}

/// What the status of a version follows from.
#[derive(Clone, Copy, Debug)]
pub struct StatusFacts<'a> {
    /// Its lifecycle state.
    pub state: State,
    /// Its flags.
    pub flags: &'a VersionFlags,
    /// Whether the gate or an unanswered request holds it.
    pub held: bool,
    /// The reasons of its newest decision; none where they are not known.
    pub reasons: &'a [Reason],
    /// Why it stands still although no person holds it.
    pub obstacle: Option<&'a Obstacle>,
    /// What is on record.
    pub recorded: &'a RecordedChanges,
}

impl VersionCondition {
    /// What ends the condition.
    #[must_use]
    pub const fn end(self) -> ConditionEnd {
        match self {
            Self::Queued => ConditionEnd::StageStart,
            Self::Running => ConditionEnd::StageEnd,
            Self::Paused | Self::Held | Self::PromotionPaused => ConditionEnd::Resumption,
            Self::AwaitingApproval => ConditionEnd::Answers,
            Self::Demoted => ConditionEnd::Retry,
            Self::Provisional => ConditionEnd::Window,
            Self::Restricted => ConditionEnd::Release,
            Self::Confirmed => ConditionEnd::Replacement,
            Self::Leaving => ConditionEnd::Ladder,
            Self::Superseded => ConditionEnd::Return,
            Self::Rejected | Self::RolledBack => ConditionEnd::Nothing,
        }
    }
}

impl VersionStatus {
    /// Whether the version stands where it is until a person acts, another version moves, or the ladder ends.
    #[must_use]
    pub const fn is_waiting(&self) -> bool {
        match self.condition {
            VersionCondition::Paused
            | VersionCondition::AwaitingApproval
            | VersionCondition::Held
            | VersionCondition::Demoted
            | VersionCondition::PromotionPaused
            | VersionCondition::Restricted
            | VersionCondition::Leaving => true,
            VersionCondition::Queued | VersionCondition::Running => self.obstacle.is_some(),
            VersionCondition::Provisional
            | VersionCondition::Confirmed
            | VersionCondition::Superseded
            | VersionCondition::Rejected
            | VersionCondition::RolledBack => false,
        }
    }

    /// Whether its stage or its place in control goes on under a limit that a person set or has to lift.
    #[must_use]
    pub const fn is_limited(&self) -> bool {
        matches!(
            self.condition,
            VersionCondition::Paused
                | VersionCondition::PromotionPaused
                | VersionCondition::Restricted
                | VersionCondition::Held
                | VersionCondition::Leaving
        )
    }
}

/// The newest of some changes.
fn newest<'a>(changes: &[Option<&'a RecordedChange>]) -> Option<&'a RecordedChange> {
    changes.iter().copied().flatten().max_by_key(|change| change.since.record)
}

impl VersionStatus {
    /// The status that these facts make.
    #[must_use]
    pub fn of(facts: &StatusFacts<'_>) -> Self {
        use VersionCondition as C;
        let StatusFacts { state, flags, held, reasons, obstacle, recorded } = *facts;
        let condition = C::of(state, flags, held);
        let RecordedChanges { state: moved, flags: flagged, .. } = recorded;
        let (moved, flagged) = (moved.as_ref(), flagged.as_ref());
        let (resumed, released) = (recorded.resumed.as_ref(), recorded.released.as_ref());
        let change = match condition {
            C::Queued => newest(&[moved, resumed]),
            C::Running => newest(&[moved, flagged, resumed]),
            C::Paused | C::PromotionPaused => recorded.paused.as_ref().or(flagged),
            C::AwaitingApproval => recorded.asked.as_ref().or(flagged),
            C::Held if recorded.has_lapsed() => recorded.lapsed.as_ref(),
            C::Held | C::Leaving => flagged,
            C::Provisional => newest(&[moved, resumed, released]),
            C::Restricted => recorded.restricted.as_ref().or(flagged),
            C::Confirmed => newest(&[moved, recorded.confirmed.as_ref(), released]),
            C::Demoted | C::Superseded | C::Rejected | C::RolledBack => moved,
        };
        let cause = change.and_then(|change| change.cause.clone());
        // The rule that a record of flags does not name.
        let decided = || {
            let is_decided = match condition {
                C::Held | C::Leaving | C::Restricted | C::Demoted | C::Rejected | C::RolledBack => true,
                C::Queued
                | C::Running
                | C::Paused
                | C::AwaitingApproval
                | C::Provisional
                | C::PromotionPaused
                | C::Confirmed
                | C::Superseded => false,
            };
            let explaining: Vec<Reason> =
                reasons.iter().filter(|reason| condition.is_explained_by(reason.code)).cloned().collect();
            let reason = lead_reason(&explaining).filter(|_| is_decided);
            reason.map(|reason| NoticeOrText::from(Notice::decided(Some(reason))))
        };
        Self {
            condition,
            stage: match condition {
                C::Queued => Some(next_stage(state)),
                C::Running => flags.running,
                _ => None,
            },
            since: change.map(|change| change.since),
            cause: cause.or_else(decided),
            obstacle: obstacle.filter(|_| matches!(condition, C::Queued | C::Running | C::Demoted)).cloned(),
            ends: condition.end(),
        }
    }
}

/// The stage after the last one that the version passed.
#[must_use]
pub const fn next_stage(state: State) -> Stage {
    match state {
        State::Registered => Stage::Validation,
        State::Validated => Stage::Sandbox,
        State::Sandboxed => Stage::Shadow,
        State::Shadowed
        | State::Active
        | State::Demoted
        | State::Rejected
        | State::RolledBack
        | State::Superseded => Stage::Activation,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::decision::Dimension;
    use super::super::finding::Finding;
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

    /// A change of each kind, the later ones with higher numbers; the cause names the kind.
    fn every_change() -> RecordedChanges {
        let change = |record: u64, kind: &str| {
            let since = RecordMoment { record, at_ms: record, wall: None };
            Some(RecordedChange { since, cause: Some(NoticeOrText::Text(kind.to_owned())) })
        };
        RecordedChanges {
            state: change(1, "state"),
            flags: change(2, "flags"),
            paused: change(3, "paused"),
            resumed: change(4, "resumed"),
            asked: change(5, "asked"),
            lapsed: change(6, "lapsed"),
            restricted: change(7, "restricted"),
            released: change(8, "released"),
            confirmed: change(9, "confirmed"),
        }
    }

    /// Asserts that the status of a version shows nothing of another state, on hold or not. The walk over the lifecycle uses it,
    /// too.
    pub(crate) fn assert_row_shows_its_own_state((state, flags): (State, VersionFlags)) {
        assert_status_is_of_its_state(state, flags, false);
        // A candidate on hold is not asked about.
        if !flags.awaiting_approval {
            assert_status_is_of_its_state(state, flags, true);
        }
    }

    fn assert_status_is_of_its_state(state: State, flags: VersionFlags, held: bool) {
        let (recorded, flags) = (every_change(), &flags);
        let facts = StatusFacts { state, flags, held, reasons: &[], obstacle: None, recorded: &recorded };
        let status = VersionStatus::of(&facts);
        let row = format!("{state} {flags:?} {held}: {status:?}");
        let Some(NoticeOrText::Text(kind)) = &status.cause else { panic!("{row}") };
        let holds = match kind.as_str() {
            "paused" => flags.paused,
            "asked" => flags.awaiting_approval,
            "lapsed" => held,
            "restricted" => flags.restricted,
            _ => true,
        };
        assert!(holds, "{row}");
        if flags.paused && status.condition != VersionCondition::Leaving && !is_past(state) {
            assert_eq!(kind, "paused", "{row}");
        }
        if matches!(kind.as_str(), "confirmed" | "released") {
            assert_eq!(state, State::Active, "{row}");
            assert!(!flags.restricted && !flags.rollback_pending, "{row}");
        }
        if is_past(state) || status.condition == VersionCondition::Demoted {
            assert_eq!(kind, "state", "{row}");
        }
        assert_eq!(status.ends == ConditionEnd::Nothing, state.is_terminal(), "{row}");
        let may_resume = state.may_resume(flags, held) && status.condition != VersionCondition::Leaving;
        assert_eq!(status.ends == ConditionEnd::Resumption, may_resume, "{row}");
        let runs = status.condition == VersionCondition::Running;
        assert_eq!(status.stage.is_some(), runs || status.condition == VersionCondition::Queued, "{row}");
        // Without a record a status still states what the version is and what ends that.
        let recorded = RecordedChanges::default();
        let bare = VersionStatus::of(&StatusFacts { recorded: &recorded, ..facts });
        assert_eq!((bare.condition, bare.ends), (status.condition, status.ends), "{row}");
        assert_eq!((bare.since, bare.cause), (None, None), "{row}");
    }

    fn is_past(state: State) -> bool {
        matches!(state, State::Superseded | State::Rejected | State::RolledBack)
    }

    #[test]
    fn a_status_shows_a_change_of_its_own_state_alone() {
        for (state, flags, _) in rows() {
            assert_row_shows_its_own_state((state, flags));
        }
    }

    #[test]
    fn a_rule_explains_what_only_flags_record() {
        let flags = VersionFlags::default();
        let reasons = [
            Reason::new(Dimension::Gate, Finding::NotAskedYet),
            Reason::new(Dimension::Monitor, Finding::TripHolds),
        ];
        let recorded = RecordedChanges::default();
        let facts = |state, held| StatusFacts {
            state,
            flags: &flags,
            held,
            reasons: &reasons,
            obstacle: None,
            recorded: &recorded,
        };
        let decided = |reason: &Reason| Some(NoticeOrText::from(Notice::decided(Some(reason))));
        let [asked, trip] = &reasons;
        let lead = lead_reason(&reasons);
        assert_eq!(VersionStatus::of(&facts(State::Shadowed, true)).cause, lead.and_then(decided));
        assert_eq!(VersionStatus::of(&facts(State::RolledBack, false)).cause, decided(trip), "not {asked:?}");
        assert_eq!(VersionStatus::of(&facts(State::Active, false)).cause, None);
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
                State::Validated,
                VersionFlags { running: Some(Stage::Sandbox), ..none },
                true,
                VersionCondition::Held,
            ),
            (
                State::Shadowed,
                VersionFlags { awaiting_approval: true, ..none },
                false,
                VersionCondition::AwaitingApproval,
            ),
            (
                State::Shadowed,
                VersionFlags { running: Some(Stage::Activation), awaiting_approval: true, ..none },
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
