//! One formatter for each kind of word and number, shared by views, exports and prompts.

use holdpoint_governance::calendar;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::submission::Provenance;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::clock_time;
use holdpoint_protocol::console_presence::{AttachedConsoleView, ConsoleAccount};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind, Snapshot};
use holdpoint_text::Untrusted;
use holdpoint_wording::console::formatters as wording;

pub use holdpoint_protocol::clock::time_of_day;

/// Virtual time as hours, minutes and seconds since the store began.
#[must_use]
pub fn seconds(at_ms: u64) -> String {
    clock_time(at_ms)
}

/// The time of day of a record; virtual time where the record has no other.
#[must_use]
pub fn record_time(record: &AuditRecord) -> String {
    if record.wall_ms > 0 { time_of_day(record.wall_ms) } else { seconds(record.at_ms) }
}

/// The day and time of a record with the engine's own time; the latter alone where the record has no other.
#[must_use]
pub fn record_moment(record: &AuditRecord) -> String {
    let engine = format!("engine time {}", seconds(record.at_ms));
    if record.wall_ms > 0 {
        format!("{} UTC, {engine}", calendar::day_and_time(record.wall_ms))
    } else {
        engine
    }
}

/// The operator of an attached console: the chosen name, or the console's number. Names the account if it is not that of
/// this console.
#[must_use]
pub fn console_label(seat: &AttachedConsoleView, own: Option<&ConsoleAccount>) -> String {
    let who = match &seat.sitting.who {
        Some(name) => Untrusted::new(name.clone()).line().into_string(),
        None => format!("seat {}", seat.seat),
    };
    let who = match seat.account.as_ref().filter(|account| Some(*account) != own) {
        Some(ConsoleAccount { uid, user, role }) => {
            let account = user.clone().unwrap_or_else(|| uid.to_string());
            format!("{who} of account {}, {role}", Untrusted::new(account).line().into_string())
        }
        None => who,
    };
    // A read-only console decides nothing.
    let who = if seat.sitting.read_only { format!("{who}, read-only") } else { who };
    if seat.not_reading { format!("{who}, NOT READING") } else { who }
}

/// A duration: `950 ms`, `12 s`, `4 min 5 s`, `3 h 2 min`.
#[must_use]
pub fn duration(ms: u64) -> String {
    let secs = ms / 1000;
    match secs {
        0 => format!("{ms} ms"),
        1..60 => format!("{secs} s"),
        60..3600 => format!("{} min {} s", secs / 60, secs % 60),
        _ => format!("{} h {} min", secs / 3600, secs / 60 % 60),
    }
}

/// How a version came about, in words.
#[must_use]
pub const fn origin(of: Provenance) -> &'static str {
    match of {
        Provenance::Rl => "reinforcement learning",
        Provenance::Llm => "language model",
        Provenance::Imitation => "imitation",
        Provenance::Manual => "manual",
        Provenance::Optimiser => "optimizer",
    }
}

/// One dimension with value, interval, limit and source.
#[must_use]
pub fn kappa_line(result: &DimensionResult) -> String {
    let value = result.kappa.map_or_else(|| "no data".to_owned(), |kappa| format!("{kappa:.3}"));
    let interval = result.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    let basis = if result.measured { "" } else { ", estimated" };
    format!(
        "{} {value}{interval} (at least {:.2}) {}{basis}",
        result.dimension.name(),
        result.threshold,
        result.outcome
    )
}

/// A reason with its code.
#[must_use]
pub fn reason_line(reason: &Reason) -> String {
    format!("{}: {}", reason.code, holdpoint_wording::reason(reason))
}

/// The state of a version, flags included.
#[must_use]
pub fn state_label(state: State, flags: &VersionFlags) -> String {
    let mut labels = vec![state.name().to_owned()];
    let flagged = [
        (flags.provisional, "provisional"),
        (flags.restricted, "restricted"),
        (flags.rollback_pending, "rolling back"),
        (flags.awaiting_approval, "awaiting approval"),
        (flags.paused, state.paused_label()),
    ];
    labels.extend(flagged.into_iter().filter(|(is, _)| *is).map(|(_, label)| label.to_owned()));
    if let Some(stage) = flags.running {
        labels.push(format!("in {}", stage.name()));
    }
    labels.join(", ")
}

/// Why nothing runs; absent if something may.
#[must_use]
pub fn pipeline_idle_reason(now: &Snapshot) -> Option<&'static str> {
    if now.holding.is_some() {
        Some(wording::ENGINE_HALTED)
    } else {
        now.stopped.is_some().then_some(wording::CELL_STOPPED)
    }
}

/// When an approved version takes over.
#[must_use]
pub const fn takeover_time(cell_is_stopped: bool) -> &'static str {
    if cell_is_stopped { wording::TAKES_OVER_AT_START } else { wording::TAKES_OVER_AFTER_SEQUENCE }
}

/// The number of approvals, and until when the request stands, with what follows then.
#[must_use]
pub fn approvals(prompt: &ApprovalRequestView, cell_is_stopped: bool, now: WallTime) -> (String, String) {
    let have = prompt.approved_by.len();
    let officer = prompt.officer_missing && u32::try_from(have).is_ok_and(|have| have >= prompt.needed);
    let officer = if officer { wording::OFFICER_MISSING } else { "" };
    let count = format!("{have} of {}{officer}", prompt.needed);
    let next = if prompt.granted {
        takeover_time(cell_is_stopped).to_owned()
    } else {
        let then = match prompt.purpose {
            RequestKind::Activation => "on hold",
            RequestKind::Release => wording::STAYS_RESTRICTED,
            RequestKind::Review => wording::DEMOTED,
            RequestKind::Emergency => wording::VOID,
        };
        let then = if prompt.until > now { format!(", then {then}") } else { String::new() };
        format!("until {}{then}", prompt.until.as_deadline(now))
    };
    (count, next)
}

/// The seven stages of the pipeline strip, in order.
pub const STAGES: [&str; 7] = ["register", "validate", "sandbox", "shadow", "gate", "monitor", "confirm"];

/// The place of the monitor's stage in [`STAGES`].
pub const MONITOR_PLACE: usize = 5;

/// How many of [`STAGES`] a version has passed. A stopped version counts up to the stage that ran then, else up to
/// the state it left.
#[must_use]
pub fn stages_done(state: State, left: Option<State>, ran: Option<Stage>, flags: &VersionFlags) -> usize {
    match state {
        State::Registered => 1,
        State::Validated => 2,
        State::Sandboxed => 3,
        State::Shadowed => 4,
        State::Active if flags.provisional => MONITOR_PLACE,
        State::Active | State::Superseded => STAGES.len(),
        State::RolledBack => MONITOR_PLACE,
        State::Rejected | State::Demoted => ran.map_or_else(|| stopped_after(left), stage_place),
    }
}

/// If no stage was running, a person stopped it.
const fn stopped_after(left: Option<State>) -> usize {
    match left {
        None | Some(State::Registered | State::Rejected) => 1,
        // A demoted version has its sandbox still ahead.
        Some(State::Validated | State::Demoted) => 2,
        Some(State::Sandboxed) => 3,
        Some(State::Shadowed) => 4,
        Some(State::Active | State::Superseded | State::RolledBack) => MONITOR_PLACE,
    }
}

/// The stage's place in [`STAGES`].
#[must_use]
pub const fn stage_place(stage: Stage) -> usize {
    match stage {
        Stage::Validation => 1,
        Stage::Sandbox => 2,
        Stage::Shadow => 3,
        Stage::Activation => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_and_times_are_formatted() {
        let table = [
            (0, "0 ms"),
            (950, "950 ms"),
            (59_999, "59 s"),
            (245_000, "4 min 5 s"),
            (10_920_000, "3 h 2 min"),
        ];
        for (ms, text) in table {
            assert_eq!(duration(ms), text);
        }
        assert_eq!(seconds(3_723_000), "01:02:03");
    }
}
