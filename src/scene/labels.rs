//! Text of a recording: levels of log lines, the document.
//!
//! Foreign text is sanitized and loses all Markdown syntax.

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::decision::Reason;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::{DimensionResult, Event, EventKind};
use holdpoint_text::Untrusted;
use holdpoint_wording::event::family_after_rollback;

use super::limits::TEXT_WIDTH_MAX;
use holdpoint_recordings::recording::RecordingSubject;

/// The level of a log line.
#[must_use]
pub fn level(kind: &EventKind) -> &'static str {
    match kind {
        EventKind::RolledBack { .. }
        | EventKind::CellStopped { .. }
        | EventKind::BreakGlass { .. }
        | EventKind::Fault { .. } => "ERROR",
        EventKind::Rung { ok: false, .. } => "ERROR",
        EventKind::Rung { .. }
        | EventKind::Monitor { .. }
        | EventKind::HarmPastLimit { .. }
        | EventKind::CommandRefused { .. }
        | EventKind::Voided { .. }
        | EventKind::Drift { kind: Some(_), .. }
        | EventKind::LiveFault { fault: Some(_) }
        | EventKind::Sequence { success: false, .. } => "WARN",
        EventKind::Sequence { .. } | EventKind::Pace { .. } => "DEBUG",
        _ => "INFO",
    }
}

/// The level of an alarm.
#[must_use]
pub const fn alarm_level(priority: Priority, state: AlarmState) -> &'static str {
    match (state, priority) {
        (AlarmState::Normal, _) => "INFO",
        (
            AlarmState::Unacknowledged
            | AlarmState::Acknowledged
            | AlarmState::ReturnedUnacknowledged
            | AlarmState::Latched
            | AlarmState::Shelved,
            priority,
        ) => match priority {
            Priority::Critical | Priority::High => "ERROR",
            Priority::Low => "WARN",
        },
    }
}

/// The upgrade in a page of Markdown.
#[must_use]
pub fn document(
    about: &RecordingSubject,
    phase: Option<&str>,
    decided: Option<&Event>,
    outcome: Option<UpgradeEnd>,
) -> String {
    let predecessor = about.predecessor.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string);
    let mut page = format!(
        "# {}\n\n| | |\n|---|---|\n| replaces | {} |\n| digest | `{}` |\n| profile | {} |\n| robot | {} |\n| seeds | {} \
         |\n| engine | {} |\n| phase | **{}** |\n",
        plain(&about.version.to_string()),
        plain(&predecessor),
        about.digest.short(),
        plain(&about.profile.to_string()),
        plain(&about.robot),
        holdpoint_wording::seeds::named(about.seed),
        plain(&about.engine_build),
        plain(phase.unwrap_or("registered")),
    );
    if let Some(outcome) = outcome {
        page.push_str(&format!("| outcome | **{outcome}** |\n"));
    }
    if let Some(event) = decided {
        page.push_str(&decision(event));
    }
    page
}

fn decision(event: &Event) -> String {
    let secs = event.at_ms / 1000;
    match &event.kind {
        EventKind::Decided { stage, outcome, dimensions, reasons, .. } => {
            let mut text = format!("\n## {stage}: {outcome}\n\nat {secs} s\n\n");
            text.push_str("| dimension | value | limit | outcome |\n|---|---|---|---|\n");
            for dimension in dimensions {
                text.push_str(&row(dimension));
            }
            text + &list(reasons)
        }
        EventKind::Monitor { decision, reasons, .. } => {
            format!("\n## monitor: {decision}\n\nat {secs} s\n{}", list(reasons))
        }
        EventKind::RolledBack { restored, trigger, recovered, .. } => {
            let restored = restored.as_ref().map_or_else(|| "no version".to_owned(), ToString::to_string);
            format!(
                "\n## rolled back\n\nat {secs} s to {}: {}; {}\n",
                plain(&restored),
                plain(&holdpoint_wording::notice(trigger)),
                family_after_rollback(*recovered)
            )
        }
        _ => String::new(),
    }
}

fn row(dimension: &DimensionResult) -> String {
    let name = dimension.dimension.name();
    let value = dimension.kappa.map_or_else(|| "no data".to_owned(), |kappa| format!("{kappa:.3}"));
    format!("| {name} | {value} | {:.3} | {} |\n", dimension.threshold, dimension.outcome)
}

fn list(reasons: &[Reason]) -> String {
    let lines =
        reasons.iter().take(8).map(|reason| format!("* {}\n", plain(&holdpoint_wording::line(reason))));
    "\n".to_owned() + &lines.collect::<String>()
}

/// Foreign text on one line, without Markdown syntax.
fn plain(text: &str) -> String {
    let shown = Untrusted::new(text).display(TEXT_WIDTH_MAX);
    let mut plain = String::with_capacity(shown.as_str().len());
    for letter in shown.as_str().chars() {
        if matches!(letter, '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '#' | '|' | '!') {
            plain.push('\\');
        }
        plain.push(letter);
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_text_is_escaped_in_markdown() {
        assert_eq!(plain("a|b [x](y) \u{1b}[31m"), r"a\|b \[x\](y) \\u{1b}\[31m");
    }

    #[test]
    fn returned_alarm_is_not_shown_as_an_error() {
        assert_eq!(alarm_level(Priority::High, AlarmState::Normal), "INFO");
        assert_eq!(alarm_level(Priority::High, AlarmState::Unacknowledged), "ERROR");
        assert_eq!(alarm_level(Priority::Low, AlarmState::Unacknowledged), "WARN");
    }
}
