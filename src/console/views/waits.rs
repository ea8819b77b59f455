//! Everything that stands until a person acts, in the overview: who and why, until when, and the key. The most urgent first.
//!
//! ```text
//! ─ Waits for you (4) ─────────────────────────────────────────────
//! answer   grasp@1.0.0  or it is rolled back in 43 s: the monitor …  6
//! sign     align@2.0.0  1 of 2 (grace), until 08:41:43 UTC, 29 mi…  6
//! paused   place@1.3.8  paused by mia: odd noise                     u
//! reset    rollback     since 08:05:00: the rollback took 1.9 s      5
//! ```

use ratatui::layout::Rect;

use super::overview::time_left;
use crate::action::Action;
use crate::formatters::{approvals, time_of_day};
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, View};
use crate::waiting_rows::{self, WaitingRow};
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::alarms::AlarmState;
use holdpoint_governance::decision::lead_reason;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::snapshot::{ApprovalRequestView, RequestKind, Snapshot};
use holdpoint_wording::console::waits as wording;
use unicode_width::UnicodeWidthStr as _;

/// The widest name of a version in its column.
const SUBJECT_MAX: usize = 16;

/// In place of the word for what the operator does: others do it.
const OTHERS: &str = "others";

/// Something that stands until a person acts.
#[derive(Clone, Debug, PartialEq)]
pub struct WaitingItem {
    /// What the person does, or what holds it: one word.
    pub what: &'static str,
    pub subject: String,
    /// Who, why and until when.
    pub text: String,
    /// What leads there.
    pub action: Action,
}

/// All of them. Requests have a deadline and come first, in the order of the approvals view.
#[must_use]
pub fn items(model: &ConsoleModel) -> Vec<WaitingItem> {
    let Some(now) = model.engine_data.snapshot.as_deref() else { return Vec::new() };
    let (standing, requests): (Vec<WaitingRow<'_>>, Vec<WaitingRow<'_>>) =
        model.waiting_rows().into_iter().partition(|row| matches!(row, WaitingRow::Standing(_)));
    let mut items: Vec<WaitingItem> = requests.iter().map(|row| waiting_item(model, now, row)).collect();
    if let Some(doubt) = &now.clock_doubt {
        items.push(WaitingItem {
            what: "time",
            subject: "clock".to_owned(),
            text: doubt.text.clone(),
            action: Action::CommandLine,
        });
    }
    for family in &now.families {
        let review = family.review.as_ref().filter(|review| !is_asked(now, &review.version));
        if let Some(review) = review {
            items.push(WaitingItem {
                what: "review",
                subject: review.version.to_string(),
                text: wording::review_until(&review.until.as_deadline(model.time()), review.overdue),
                action: Action::Show(View::Approvals),
            });
        }
        if family.safe_stopped {
            items.push(WaitingItem {
                what: "stopped",
                subject: family.family.to_string(),
                text: wording::no_version_works(&model.keymap.key(Action::Rearm)),
                action: Action::Show(View::Registry),
            });
        }
    }
    items.extend(standing.iter().map(|row| waiting_item(model, now, row)));
    let latched = now.alarms.iter().filter(|alarm| alarm.state == AlarmState::Latched);
    items.extend(latched.map(|alarm| WaitingItem {
        what: "reset",
        subject: alarm.subject.clone(),
        text: format!("since {}: {}", model.moment(alarm.since_ms), holdpoint_wording::notice(&alarm.text)),
        action: Action::Show(View::Alarms),
    }));
    items
}

/// Whether an open request is about the version.
fn is_asked(now: &Snapshot, version: &CapabilityId) -> bool {
    now.prompts.iter().any(|prompt| prompt.version == *version)
}

fn waiting_item(model: &ConsoleModel, now: &Snapshot, row: &WaitingRow<'_>) -> WaitingItem {
    let subject = row.version().to_string();
    let (what, text, action) = match row {
        WaitingRow::MonitorQuestion(question) => {
            let left = time_left(question.deadline_ms, model.engine_ms());
            let why = lead_reason(&question.reasons).map(holdpoint_wording::line).unwrap_or_default();
            ("answer", wording::or_rolled_back(&left, &why), Action::Show(View::Approvals))
        }
        WaitingRow::Approval(prompt) => {
            let operator = model.session.operator.as_ref();
            let is_closed = operator.is_some_and(|who| waiting_rows::is_closed_to(prompt, &who.name));
            let what = if is_closed { OTHERS } else { verb(prompt) };
            (what, signatures(model, prompt), Action::Show(View::Approvals))
        }
        WaitingRow::Standing(candidate) => {
            let status = now.status(candidate);
            let why = holdpoint_wording::status_cause(&status)
                .unwrap_or_else(|| holdpoint_wording::status_end(&candidate.version, &status));
            let (what, action) =
                waiting_rows::standing(status.condition).unwrap_or(("", Action::Show(View::Approvals)));
            (what, why, action)
        }
    };
    WaitingItem { what, subject, text, action }
}

const fn verb(prompt: &ApprovalRequestView) -> &'static str {
    match prompt.purpose {
        RequestKind::Activation => "sign",
        RequestKind::Release => "release",
        RequestKind::Review => "review",
        RequestKind::Emergency => "emergency",
    }
}

/// The signatures so far with their signers, the deadline, and since when the request stands.
fn signatures(model: &ConsoleModel, prompt: &ApprovalRequestView) -> String {
    let (count, next) = approvals(prompt, model.is_stopped(), model.time());
    let by = if prompt.approved_by.is_empty() {
        String::new()
    } else {
        format!(" ({})", prompt.approved_by.join(", "))
    };
    let about = if prompt.about.is_empty() { String::new() } else { format!("; {}", prompt.about) };
    format!("{count}{by}, {next}; asked {}{about}", time_of_day(prompt.asked.ms()))
}

/// The lines that all of them take with the heading, at most a third of a column and never less than two; 0 without any.
#[must_use]
pub fn height(items: &[WaitingItem], of: u16) -> u16 {
    if items.is_empty() {
        return 0;
    }
    u16::try_from(items.len() + 1).unwrap_or(u16::MAX).min((of / 3).max(2)).min(of)
}

/// Draws them. If they do not all fit, the last line counts the others by kind.
pub fn draw(model: &ConsoleModel, items: &[WaitingItem], pen: &mut Pen<'_>, area: Rect) {
    if items.is_empty() {
        return;
    }
    let key = model.keymap.key(Action::Show(View::Approvals));
    let of_others = items.iter().filter(|item| item.what == OTHERS).count();
    let mut title = wording::waits_for_you(items.len() - of_others);
    if of_others > 0 {
        title.push_str(&wording::for_others(of_others));
    }
    let inside = pen.pane(area, &title, false, &format!("{key} opens"));
    let (width, height) = (usize::from(inside.width), usize::from(inside.height));
    let shown = if items.len() > height { height.saturating_sub(1) } else { items.len() };
    let subject_width = items.iter().map(|item| item.subject.width()).max().unwrap_or(0).min(SUBJECT_MAX);
    let mut rows: Vec<Row> = items
        .iter()
        .take(shown)
        .map(|item| {
            let key = model.keymap.key(item.action);
            let head = Row::new()
                .cell(ThemeRole::Waiting, item.what, 9)
                .cell(ThemeRole::Title, &item.subject, subject_width)
                .with(ThemeRole::Text, "  ");
            let room = width.saturating_sub(head.width() + key.width() + 1);
            head.cell(ThemeRole::Text, &item.text, room).with(ThemeRole::Text, " ").with(ThemeRole::Key, &key)
        })
        .collect();
    let others = items.get(shown..).unwrap_or(&[]);
    if !others.is_empty() {
        let mut counts: Vec<(&str, usize)> = Vec::new();
        for item in others {
            match counts.iter_mut().find(|(what, _)| *what == item.what) {
                Some((_, count)) => *count += 1,
                None => counts.push((item.what, 1)),
            }
        }
        let counts: Vec<String> = counts.iter().map(|(what, count)| format!("{count} {what}")).collect();
        let more = wording::others(others.len(), &counts.join(", "));
        rows.push(Row::of(ThemeRole::Waiting, &more));
    }
    pen.rows(inside, 0, &rows);
}
