//! The table of states: glyph, word and role together, so that no state depends on color alone.

use super::ThemeRole;
use crate::look::Glyph;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::{DimensionOutcome, StageOutcome};
use holdpoint_governance::profile::{ClassRisk, ProfileName};
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::rollback::PostStatus;
use holdpoint_protocol::explanation::{PeopleRuling, Ruling};

/// The display of a state: always all three.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateMark {
    pub glyph: Glyph,
    pub label: &'static str,
    pub role: ThemeRole,
}

const fn mark(glyph: Glyph, label: &'static str, role: ThemeRole) -> StateMark {
    StateMark { glyph, label, role }
}

impl StateMark {
    /// Of an alarm's priority.
    #[must_use]
    pub const fn priority(priority: Priority) -> Self {
        match priority {
            Priority::Critical => mark(Glyph::Critical, "CRIT", ThemeRole::Critical),
            Priority::High => mark(Glyph::High, "HIGH", ThemeRole::High),
            Priority::Low => mark(Glyph::Low, "LOW", ThemeRole::Low),
        }
    }

    /// Of an alarm's state.
    #[must_use]
    pub const fn alarm_state(state: AlarmState) -> Self {
        match state {
            AlarmState::Unacknowledged => mark(Glyph::Warning, "unacknowledged", ThemeRole::Text),
            AlarmState::ReturnedUnacknowledged => mark(Glyph::Returned, "ended", ThemeRole::Text),
            AlarmState::Acknowledged => mark(Glyph::Good, "acknowledged", ThemeRole::Quiet),
            AlarmState::Latched => mark(Glyph::Latched, "latched", ThemeRole::Warning),
            AlarmState::Shelved => mark(Glyph::Paused, "shelved", ThemeRole::Quiet),
            AlarmState::Normal => mark(Glyph::Neutral, "normal", ThemeRole::Quiet),
        }
    }

    #[must_use]
    pub const fn profile(profile: ProfileName) -> Self {
        let declared = profile.declaration();
        match declared.risk {
            ClassRisk::Nothing => mark(Glyph::Sim, declared.label, ThemeRole::BannerSim),
            ClassRisk::Machine => mark(Glyph::Real, declared.label, ThemeRole::BannerReal),
            ClassRisk::People => mark(Glyph::Human, declared.label, ThemeRole::BannerHuman),
        }
    }

    /// Of a profile unknown to this build: treated as the strictest.
    pub const NO_PROFILE: Self = mark(Glyph::Unknown, "UNKNOWN", ThemeRole::BannerHuman);

    /// The mark of a version: first what needs attention, then what runs, then its state. An active version always
    /// shows that it has the arm: see [`StateMark::secondary`].
    #[must_use]
    pub const fn version(state: State, flags: &VersionFlags) -> Self {
        match state {
            _ if flags.rollback_pending => mark(Glyph::Warning, "rolling back", ThemeRole::Bad),
            State::Active if flags.restricted => {
                mark(Glyph::Warning, "active, restricted", ThemeRole::Warning)
            }
            State::Active if flags.provisional => {
                mark(Glyph::Running, "active, provisional", ThemeRole::Running)
            }
            State::Active => mark(Glyph::Good, "active", ThemeRole::Good),
            State::Rejected => mark(Glyph::Bad, "rejected", ThemeRole::Bad),
            State::RolledBack => mark(Glyph::Bad, "rolled back", ThemeRole::Bad),
            State::Superseded => mark(Glyph::Neutral, "superseded", ThemeRole::Muted),
            _ if flags.paused => Self::PAUSED,
            _ if flags.awaiting_approval => mark(Glyph::Waiting, "awaiting approval", ThemeRole::Waiting),
            State::Demoted => mark(Glyph::Warning, "demoted", ThemeRole::Warning),
            _ if flags.running.is_some() => mark(Glyph::Running, "running", ThemeRole::Running),
            State::Registered => mark(Glyph::Neutral, "registered", ThemeRole::Text),
            State::Validated => mark(Glyph::Neutral, "validated", ThemeRole::Text),
            State::Sandboxed => mark(Glyph::Neutral, "sandboxed", ThemeRole::Text),
            State::Shadowed => mark(Glyph::Neutral, "shadowed", ThemeRole::Text),
        }
    }

    /// The mark beside that of an active version: its promotion is paused, or approvers are asked about it.
    #[must_use]
    pub const fn secondary(state: State, flags: &VersionFlags) -> Option<Self> {
        match state {
            State::Active if flags.paused => {
                Some(mark(Glyph::Paused, State::Active.paused_label(), ThemeRole::Held))
            }
            State::Active if flags.awaiting_approval => {
                Some(mark(Glyph::Waiting, "awaiting approval", ThemeRole::Waiting))
            }
            State::Active
            | State::Registered
            | State::Validated
            | State::Sandboxed
            | State::Shadowed
            | State::Demoted
            | State::Rejected
            | State::RolledBack
            | State::Superseded => None,
        }
    }

    /// Of a family without an active version.
    pub const SAFE_STOPPED: Self = mark(Glyph::Bad, "safe-stopped", ThemeRole::Bad);

    /// Of a completed operation.
    pub const DONE: Self = mark(Glyph::Good, "done", ThemeRole::Good);

    /// Of something refused or failed.
    pub const FAILED: Self = mark(Glyph::Bad, "failed", ThemeRole::Bad);

    /// Of something that runs.
    pub const RUNNING: Self = mark(Glyph::Running, "running", ThemeRole::Running);

    /// Of something whose turn has not come.
    pub const AHEAD: Self = mark(Glyph::Ahead, "ahead", ThemeRole::Muted);

    /// Of something that has begun and waits for its turn.
    pub const WAITS_ITS_TURN: Self = mark(Glyph::Ahead, "waits its turn", ThemeRole::Text);

    /// Of something that waits for a person.
    pub const WAITING: Self = mark(Glyph::Waiting, "waits", ThemeRole::Waiting);

    /// Of something a person paused.
    pub const PAUSED: Self = mark(Glyph::Paused, "paused", ThemeRole::Held);

    /// Of something not measured.
    pub const UNKNOWN: Self = mark(Glyph::Unknown, "no data", ThemeRole::Unknown);

    /// One mark of each kind, for the preview.
    #[must_use]
    pub fn samples() -> Vec<(&'static str, Self)> {
        let flags = VersionFlags::default();
        let mut samples = Vec::new();
        samples.extend(ProfileName::ALL.map(|profile| ("profile", Self::profile(profile))));
        samples.extend(Priority::ALL.map(|priority| ("alarm", Self::priority(priority))));
        let states = [
            AlarmState::Unacknowledged,
            AlarmState::ReturnedUnacknowledged,
            AlarmState::Acknowledged,
            AlarmState::Latched,
            AlarmState::Shelved,
        ];
        samples.extend(states.map(|state| ("alarm state", Self::alarm_state(state))));
        samples.extend(State::ALL.map(|state| ("version", Self::version(state, &flags))));
        let flagged = [
            (State::Active, VersionFlags { provisional: true, ..flags }),
            (State::Active, VersionFlags { restricted: true, ..flags }),
            (State::Active, VersionFlags { rollback_pending: true, ..flags }),
            (State::Shadowed, VersionFlags { awaiting_approval: true, ..flags }),
            (State::Validated, VersionFlags { paused: true, ..flags }),
        ];
        samples.extend(flagged.iter().map(|(state, flags)| ("version", Self::version(*state, flags))));
        let stages = [Self::DONE, Self::RUNNING, Self::WAITING, Self::AHEAD, Self::FAILED, Self::UNKNOWN];
        samples.extend(stages.map(|stage| ("stage", stage)));
        samples.push(("family", Self::SAFE_STOPPED));
        samples
    }
}

/// Glyph and role of an outcome; its own word stands beside them.
pub type OutcomeSign = (Glyph, ThemeRole);

const GOOD: OutcomeSign = (Glyph::Good, ThemeRole::Good);
const BAD: OutcomeSign = (Glyph::Bad, ThemeRole::Bad);
const DOUBT: OutcomeSign = (Glyph::Warning, ThemeRole::Warning);
const UNKNOWN: OutcomeSign = (Glyph::Unknown, ThemeRole::Unknown);
const PLAIN: OutcomeSign = (Glyph::Neutral, ThemeRole::Text);

/// The sign of a dimension's outcome.
#[must_use]
pub const fn of_dimension(outcome: DimensionOutcome) -> OutcomeSign {
    match outcome {
        DimensionOutcome::Compatible => GOOD,
        DimensionOutcome::Conditional
        | DimensionOutcome::Review
        | DimensionOutcome::Suspicious
        | DimensionOutcome::Inconclusive => DOUBT,
        DimensionOutcome::Fragile | DimensionOutcome::Incompatible => BAD,
        DimensionOutcome::NoData => UNKNOWN,
    }
}

/// The sign of a stage's result. A recommendation of the same stage is no step forward.
#[must_use]
pub const fn of_stage(stage: Stage, outcome: StageOutcome) -> OutcomeSign {
    match (outcome, stage) {
        (StageOutcome::Pass | StageOutcome::Activate, _) => GOOD,
        (StageOutcome::Sandbox, Stage::Validation) => GOOD,
        (StageOutcome::Sandbox, Stage::Sandbox | Stage::Shadow | Stage::Activation) => DOUBT,
        (StageOutcome::Shadow, Stage::Validation | Stage::Sandbox) => GOOD,
        (StageOutcome::Shadow, Stage::Shadow | Stage::Activation) => DOUBT,
        (StageOutcome::Reject | StageOutcome::Fail, _) => BAD,
        (
            StageOutcome::PassRestricted
            | StageOutcome::Review
            | StageOutcome::RollbackReview
            | StageOutcome::Inconclusive
            | StageOutcome::Hold
            | StageOutcome::Demote,
            _,
        ) => DOUBT,
        (StageOutcome::NoData, _) => UNKNOWN,
        (StageOutcome::Skipped | StageOutcome::AwaitApproval, _) => PLAIN,
    }
}

/// The sign of a monitor's action.
#[must_use]
pub const fn of_monitor(outcome: MonitorOutcome) -> OutcomeSign {
    match outcome {
        MonitorOutcome::Continue | MonitorOutcome::Settled | MonitorOutcome::DoubtRemains => PLAIN,
        MonitorOutcome::Escalate | MonitorOutcome::Restrict => DOUBT,
        MonitorOutcome::Rollback => BAD,
    }
}

/// The sign of an upgrade's outcome.
#[must_use]
pub const fn of_end(end: UpgradeEnd) -> OutcomeSign {
    match end {
        UpgradeEnd::Confirmed => GOOD,
        UpgradeEnd::Rejected | UpgradeEnd::RolledBack | UpgradeEnd::SafeStopped => BAD,
        UpgradeEnd::Demoted => DOUBT,
    }
}

const fn of_rollback(status: PostStatus) -> OutcomeSign {
    match status {
        PostStatus::RolledBack | PostStatus::SafeStopped => BAD,
        PostStatus::Demoted => DOUBT,
    }
}

const fn of_approvals(ruling: PeopleRuling) -> OutcomeSign {
    match ruling {
        PeopleRuling::Answered(ApprovalDecision::Approve) => GOOD,
        PeopleRuling::Answered(ApprovalDecision::Reject) => BAD,
        PeopleRuling::Moved(State::Rejected | State::RolledBack) => BAD,
        PeopleRuling::Moved(State::Demoted) => DOUBT,
        PeopleRuling::Moved(State::Validated | State::Sandboxed | State::Shadowed | State::Active) => GOOD,
        PeopleRuling::Moved(State::Registered | State::Superseded) => PLAIN,
    }
}

/// The sign of a decision on record; unknown decisions have none.
#[must_use]
pub fn of_ruling(ruling: &Ruling) -> OutcomeSign {
    fn of<T: Copy>(value: &Lenient<T>, sign: impl Fn(T) -> OutcomeSign) -> OutcomeSign {
        value.known().map_or(UNKNOWN, |value| sign(*value))
    }
    match ruling {
        Ruling::Registration(outcome) | Ruling::Validation(outcome) => {
            of(outcome, |outcome| of_stage(Stage::Validation, outcome))
        }
        Ruling::Sandbox(outcome) => of(outcome, |outcome| of_stage(Stage::Sandbox, outcome)),
        Ruling::Shadow(outcome) => of(outcome, |outcome| of_stage(Stage::Shadow, outcome)),
        Ruling::Activation(outcome) => of(outcome, |outcome| of_stage(Stage::Activation, outcome)),
        Ruling::Monitor(outcome) => of(outcome, of_monitor),
        Ruling::Rollback(outcome) => of(outcome, of_rollback),
        Ruling::People(people) => of_approvals(*people),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What lets a version go on is marked as passed, in the words that the rules use.
    #[test]
    fn a_step_onward_is_marked_as_passed() {
        for (stage, outcome) in [
            (Stage::Validation, StageOutcome::Sandbox),
            (Stage::Sandbox, StageOutcome::Shadow),
            (Stage::Shadow, StageOutcome::Pass),
            (Stage::Activation, StageOutcome::Pass),
        ] {
            assert_eq!(of_stage(stage, outcome), GOOD, "{stage} -> {outcome}");
            assert_eq!(of_stage(stage, StageOutcome::Reject), BAD);
        }
        assert_eq!(of_stage(Stage::Sandbox, StageOutcome::Sandbox), DOUBT);
        assert_eq!(of_approvals(PeopleRuling::Answered(ApprovalDecision::Approve)), GOOD);
        assert_eq!(of_end(UpgradeEnd::SafeStopped), BAD);
    }
}
