//! The mark of an event on the time bar: sign, role, severity, and whether it is a decision in the upgrade.

use crate::look::{Glyph, ThemeRole};
use crate::theme::state_mark::of_stage;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_protocol::event::EventKind;
use holdpoint_wording::console::replay as wording;

/// A mark on the time bar. The most serious of a column is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeMark {
    pub glyph: Glyph,
    pub role: ThemeRole,
    /// The larger, the more serious.
    pub weight: u8,
    /// Whether it is a decision, an act of the monitor or a rollback.
    pub is_turn: bool,
}

/// The meanings of the signs, for the help.
pub const LEGEND: [(Glyph, &str); 7] = [
    (Glyph::Good, wording::DECIDED_FOR),
    (Glyph::Bad, wording::WENT_WRONG),
    (Glyph::Warning, wording::DECIDED_HELD),
    (Glyph::Waiting, wording::PEOPLE_WERE_ASKED),
    (Glyph::Up, "took over"),
    (Glyph::Returned, "rolled back"),
    (Glyph::Neutral, wording::NOT_DONE_OR_LIMIT_PASSED),
];

/// The mark of an event; absent for events that only inform.
#[must_use]
pub fn of(kind: &EventKind) -> Option<TimeMark> {
    let turn =
        |(glyph, role): (Glyph, ThemeRole), weight| Some(TimeMark { glyph, role, weight, is_turn: true });
    let aside = |glyph, role, weight| Some(TimeMark { glyph, role, weight, is_turn: false });
    match kind {
        EventKind::RolledBack { .. } => turn((Glyph::Returned, ThemeRole::Bad), 9),
        EventKind::Monitor { decision, .. } => match decision {
            MonitorOutcome::Rollback => turn((Glyph::Bad, ThemeRole::Bad), 8),
            MonitorOutcome::Continue
            | MonitorOutcome::Escalate
            | MonitorOutcome::Restrict
            | MonitorOutcome::Settled
            | MonitorOutcome::DoubtRemains => turn((Glyph::Warning, ThemeRole::Warning), 7),
        },
        EventKind::Decided { stage, outcome, .. } => {
            let sign = of_stage(*stage, *outcome);
            turn(sign, if sign.0 == Glyph::Bad { 8 } else { 6 })
        }
        // A rule that asks for the same stage again also rejects, and a person rejects without a rule.
        EventKind::StateChanged { to: State::Rejected, .. } => turn((Glyph::Bad, ThemeRole::Bad), 8),
        EventKind::Activated { .. } => turn((Glyph::Up, ThemeRole::Good), 7),
        EventKind::BreakGlass { .. } => turn((Glyph::Warning, ThemeRole::Bad), 9),
        EventKind::Reviewed { upheld, .. } => {
            turn(if *upheld { (Glyph::Good, ThemeRole::Good) } else { (Glyph::Bad, ThemeRole::Bad) }, 8)
        }
        EventKind::Confirmed { .. } | EventKind::Continued { .. } | EventKind::Released { .. } => {
            turn((Glyph::Good, ThemeRole::Good), 6)
        }
        EventKind::ApprovalReceived { decision, .. } => match decision {
            ApprovalDecision::Approve => turn((Glyph::Good, ThemeRole::Good), 6),
            ApprovalDecision::Reject => turn((Glyph::Bad, ThemeRole::Bad), 8),
        },
        EventKind::ApprovalRequested { .. } => aside(Glyph::Waiting, ThemeRole::Waiting, 5),
        EventKind::Rung { ok: false, .. } | EventKind::Fault { .. } => aside(Glyph::Bad, ThemeRole::Bad, 7),
        EventKind::LiveFault { fault: Some(_) }
        | EventKind::Drift { kind: Some(_), .. }
        | EventKind::HarmPastLimit { .. } => aside(Glyph::Warning, ThemeRole::Warning, 4),
        EventKind::Sequence { success, tasks, .. } => {
            let failed = !success || tasks.iter().any(|task| task.violation);
            failed.then_some(TimeMark {
                glyph: Glyph::Neutral,
                role: ThemeRole::Bad,
                weight: 1,
                is_turn: false,
            })
        }
        // The others only inform.
        _ => None,
    }
}
