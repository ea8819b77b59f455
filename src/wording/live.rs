//! Values beside an open request that change every second: shown with their time and signed by no person.

use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind, Snapshot};
use holdpoint_text::Untrusted;

use crate::{counted, version_status};

/// What stands over these lines; the time follows.
pub const LIVE_HEADING: &str = "LIVE, NOT SIGNED, as of";

/// The longest line, columns.
const WIDTH_MAX: usize = 200;

/// The heading with the time of the snapshot, then the time left, the open alarms, the success of the live cell, whether
/// it is stopped, the answers, and the status of the version. A snapshot is only as reliable as its sender: none of it is
/// a reason to approve.
#[must_use]
pub fn live_lines(question: &ApprovalRequestView, now: &Snapshot) -> Vec<String> {
    let mut lines = vec![format!("{LIVE_HEADING} {}", now.time.label())];
    let is_emergency = question.purpose == RequestKind::Emergency;
    if !(question.granted || is_emergency) {
        lines.push(format!("Deadline: {}", question.until.as_deadline(now.time)));
    }
    lines.push(now.foremost_alarm().map_or_else(
        || "Open alarms: none".to_owned(),
        |alarm| format!("Open alarms: {}, the foremost {}", now.alarms.len(), alarm.alarm),
    ));
    if let (Some(success), recent) = (now.live.recent_success, now.live.recent) {
        lines.push(format!("Live cell: {:.0} % of the last {recent} sequences done", 100.0 * success));
    }
    if now.live.uncovered > 0 {
        lines.push(format!("Live cell: {} that no evidence covers", counted(now.live.uncovered, "task")));
    }
    if now.stopped.is_some() {
        lines.push("The cell is stopped".to_owned());
    }
    let ApprovalRequestView { approved_by, needed, officer_missing, .. } = question;
    let officer = if *officer_missing { ", a safety officer's is missing" } else { "" };
    let by = if approved_by.is_empty() { "none yet".to_owned() } else { approved_by.join(", ") };
    if question.granted {
        let when = if now.stopped.is_some() {
            "as soon as the cell starts"
        } else {
            "when the sequence that runs is over"
        };
        lines.push(format!("Approved by {by}: it takes over {when}"));
    } else if !is_emergency {
        lines.push(format!("Approvals: {} of {needed} ({by}){officer}", approved_by.len()));
    }
    let candidate = now.candidates.iter().find(|candidate| candidate.version == question.version);
    let status = candidate.map(|candidate| version_status(&question.version, &now.status(candidate)));
    lines.extend(status.map(|status| format!("Status: {status}")));
    lines.into_iter().map(|line| Untrusted::new(line).display(WIDTH_MAX).into_string()).collect()
}
