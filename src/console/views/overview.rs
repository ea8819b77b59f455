//! View 1: what is in control, what is watched and what runs, everything that waits for a person, the robot, alarms and events.
//!
//! ```text
//! ── In control ─────────────────────── │ ▸ Robot ──────────────────
//! grasp ✔ active grasp@1.0.0            │  side view     │ top view
//! ▸ Pipeline ────────────────── 1 of 62  │
//! ▸ grasp@1.1.0 ◌ running               │  grasp 0.21 m/s 4.1 N held
//!   ████░░░░ 137 of 480                 │ ── Alarms (2) ─────────────
//!   QUEUE 60: next align@1.10.8         │ 1▲ CRIT 18:26:02 grasp …
//! ── Waits for you (1) ──────────────── │
//! sign  place@1.1.0  0 of 2           6 │
//! ── Events ──────────────────────────────────────────────────────
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::{event_log, families, pipeline, robot, status, tabs, waits};
use crate::formatters::{approvals, duration};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, EVENT_LOG_PANE};
use crate::rows::{AlarmItem, CandidateItem};
use crate::theme::StateMark;
use crate::waiting_rows::{WaitingRow, standing};
use crate::widgets::pen::{Fit, Hit, Pen, below, cut};
use crate::widgets::row::Row;

const PIPELINE_PANE: usize = 0;
pub(super) const ROBOT_PANE: usize = 1;

/// The size from which the view has room for the checks of the candidate under the cursor, below the pipeline.
const WIDE_COLUMNS: u16 = 160;

const WIDE_ROWS: u16 = 30;

/// The width from which the pipeline names the seven stages.
const STRIP_WIDTH: u16 = 62;

/// The least columns for the name of a version that waits.
const NAME_MIN: usize = 12;

/// Lines that the pipeline keeps beside any number of families: its heading, two candidates, the queue.
const PIPELINE_ROWS_MIN: u16 = 6;

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    match pen.fit {
        Fit::Tiny | Fit::One => draw_one_pane(model, pen, area),
        Fit::Two => draw_two_panes(model, pen, area),
        Fit::Full => draw_all_panes(model, pen, area),
    }
}

fn draw_one_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    tabs::draw_panes(model, Row::new(), pen, area);
    let area = below(area, 1);
    match model.view_state.pane() {
        ROBOT_PANE => robot::draw(model, pen, area),
        EVENT_LOG_PANE => {
            let area = super::frozen(model, pen, area);
            event_log::draw(model, pen, area, true);
        }
        _ => versions_and_pipeline(model, pen, area),
    }
}

fn draw_two_panes(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = waits::items(model);
    // Over the whole width: half of it cuts who and until when.
    let (upper, lower) = cut(area, area.height - waits::height(&items, area.height));
    let (left, right) = pen.split(upper, upper.width * 3 / 5);
    versions_and_pipeline(model, pen, left);
    if model.view_state.pane() == EVENT_LOG_PANE {
        event_log_pane(model, pen, right);
    } else {
        robot_pane(model, pen, right);
    }
    waits::draw(model, &items, pen, lower);
}

fn draw_all_panes(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let event_log_height = (area.height / 4).max(6);
    let (upper, lower) = cut(area, area.height - event_log_height);
    let (left, right) = pen.split(upper, (upper.width * 3 / 5).max(STRIP_WIDTH));
    let items = waits::items(model);
    let (left, waiting_area) = cut(left, left.height - waits::height(&items, left.height));
    if area.width >= WIDE_COLUMNS && left.height >= WIDE_ROWS {
        let (top, bottom) = cut(left, left.height / 2);
        versions_and_pipeline(model, pen, top);
        checks_under_cursor(model, pen, bottom);
    } else {
        versions_and_pipeline(model, pen, left);
    }
    waits::draw(model, &items, pen, waiting_area);
    let (robot_area, alarms_area) = cut(right, right.height - alarms_height(model, right.height));
    robot_pane(model, pen, robot_area);
    alarms_pane(model, pen, alarms_area);
    event_log_pane(model, pen, lower);
}

/// Active versions above the pipeline.
fn versions_and_pipeline(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let active = families::rows(model, pen, usize::from(area.width));
    let height = u16::try_from(active.len() + 1).unwrap_or(u16::MAX);
    let height = height.min(area.height.saturating_sub(PIPELINE_ROWS_MIN).max(area.height / 2));
    let (top, bottom) = cut(area, height);
    let inside = pen.pane(top, "In control", false, "");
    pen.rows(inside, 0, &active);
    let focused = model.view_state.pane() == PIPELINE_PANE;
    let cursor = if focused { model.row() } else { 0 };
    pen.hit(area, Hit::Pane(PIPELINE_PANE));
    let title = "Pipeline";
    let extent = pipeline::extent(model, cursor, title, bottom.width);
    let inside = pen.pane(bottom, title, focused, &extent);
    pipeline::draw(model, pen, inside, focused);
}

/// The candidate under the cursor in detail, if a large screen has room: its four checks and every reason of the last
/// decision.
fn checks_under_cursor(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let rows = model.pipeline_rows();
    let row = if model.view_state.is_in_event_log() { 0 } else { model.row() };
    let Some(candidate) = rows.get(row) else {
        pen.pane(area, "Checks", false, "");
        return;
    };
    let key = model.keymap.key(crate::action::Action::Open);
    let title = format!("Checks of {}", candidate.version);
    let inside = pen.pane(area, &title, false, &format!("{key} opens all of it"));
    let (look, width) = (pen.look, usize::from(inside.width));
    let dimensions = candidate.dimensions.iter().map(CandidateItem::Dimension);
    let reasons = candidate.reasons.iter().map(CandidateItem::Reason);
    let conditions = candidate.conditions.iter().map(CandidateItem::Condition);
    let rows: Vec<Row> = dimensions
        .chain(reasons)
        .chain(conditions)
        .flat_map(|row| super::candidate_rows::item(model, &row, look, width))
        .collect();
    if rows.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, "Nothing of it has been checked yet");
        return;
    }
    pen.rows(inside, 0, &rows);
}

fn robot_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let sequence = model
        .engine_data
        .frame
        .as_ref()
        .map(|frame| format!("sequence {}, {:.1} s", frame.sequence, frame.at_secs))
        .unwrap_or_default();
    pen.hit(area, Hit::Pane(ROBOT_PANE));
    let inside = pen.pane(area, "Robot", model.view_state.pane() == ROBOT_PANE, &sequence);
    robot::draw(model, pen, inside);
}

fn event_log_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let focused = model.view_state.pane() == EVENT_LOG_PANE;
    // A filtered list must not look complete.
    let filter = model.event_log_filter();
    let right = if filter.is_empty() {
        "newest first".to_owned()
    } else {
        let (shown, all) = (model.event_log_rows().len(), model.event_log().len());
        format!("{shown} of {all} lines with {:?}, newest first", super::short(filter, 24))
    };
    pen.hit(area, Hit::Pane(EVENT_LOG_PANE));
    let inside = pen.pane(area, "Events", focused, &right);
    let inside = super::frozen(model, pen, inside);
    event_log::draw(model, pen, inside, focused);
}

/// The lines of the alarms with their heading: at most a quarter of the column; 0 without any.
fn alarms_height(model: &ConsoleModel, of: u16) -> u16 {
    let rows = model.alarm_rows().len();
    if rows == 0 { 0 } else { u16::try_from(rows + 1).unwrap_or(u16::MAX).min((of / 4).max(2)).min(of) }
}

/// The most urgent alarms; the status line has the first of them in full.
fn alarms_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = model.alarm_rows();
    if items.is_empty() {
        return;
    }
    let key = model.keymap.key(crate::action::Action::ShowAlarms);
    let inside = pen.pane(area, &format!("Alarms ({})", items.len()), false, &format!("{key} opens"));
    let rows: Vec<Row> = items.iter().map(|item| alarm_row(model, *item, pen)).collect();
    pen.rows(inside, 0, &rows);
}

fn alarm_row(model: &ConsoleModel, item: AlarmItem<'_>, pen: &Pen<'_>) -> Row {
    let alarm = item.alarm();
    let (priority, state) = (StateMark::priority(alarm.priority), StateMark::alarm_state(alarm.state));
    let role = if alarm.state.calls() { priority.role } else { ThemeRole::Quiet };
    let count = match item {
        AlarmItem::Alarm(_) => String::new(),
        AlarmItem::Group { count, .. } => format!(", {count} alarms"),
    };
    let notice = holdpoint_wording::notice(&alarm.text);
    Row::of(role, &status::priority_label(pen.look, alarm.priority))
        .with(state.role, &format!(" {} ", pen.look.glyph(state.glyph)))
        .with(ThemeRole::Muted, &model.moment(alarm.since_ms))
        .with(ThemeRole::Text, &format!(" {}{count}: {notice}", alarm.subject))
}

/// What waits for a person, in a line.
#[must_use]
pub fn waiting_row(model: &ConsoleModel, item: &WaitingRow<'_>, pen: &Pen<'_>, width: usize) -> Row {
    let now_ms = model.engine_ms();
    let glyph = pen.look.glyph(Glyph::Waiting);
    match item {
        WaitingRow::MonitorQuestion(question) => {
            let head = Row::of(ThemeRole::Waiting, &format!("{glyph} question "));
            let left = format!("  rolled back in {}", time_left(question.deadline_ms, now_ms));
            let room = name_room(width, &head, &left);
            let name = super::cut_middle(&question.version.to_string(), room);
            head.with(ThemeRole::Text, &name).with(ThemeRole::Muted, &left)
        }
        WaitingRow::Approval(prompt) => {
            let (count, next) = approvals(prompt, model.is_stopped(), model.time());
            let role = if prompt.granted { ThemeRole::Text } else { ThemeRole::Muted };
            let head = Row::of(ThemeRole::Waiting, &format!("{glyph} approval "));
            let (count, next) = (format!("  {count}"), format!("  {next}"));
            let room = name_room(width, &head, &count);
            let name = super::cut_middle(&prompt.version.to_string(), room);
            head.with(ThemeRole::Text, &format!("{name}{count}")).with(role, &next)
        }
        WaitingRow::Standing(candidate) => {
            let status = model.engine_data.snapshot.as_ref().map(|now| now.status(candidate));
            let stands = status.as_ref().and_then(|status| standing(status.condition));
            let label = stands.map_or("", |(label, _)| label);
            let why = status.as_ref().and_then(holdpoint_wording::status_cause).unwrap_or_default();
            let head = Row::of(ThemeRole::Waiting, &format!("{} {label} ", pen.look.glyph(Glyph::Paused)));
            let name = super::cut_middle(&candidate.version.to_string(), name_room(width, &head, ""));
            head.with(ThemeRole::Text, &name).with(ThemeRole::Muted, &format!("  {why}"))
        }
    }
}

/// Columns for the name of a version between the head of its row and the text that must not be cut.
fn name_room(width: usize, head: &Row, behind: &str) -> usize {
    width.saturating_sub(head.width() + behind.width()).max(NAME_MIN)
}

/// The time until a deadline.
#[must_use]
pub fn time_left(deadline_ms: u64, now_ms: u64) -> String {
    duration(deadline_ms.saturating_sub(now_ms))
}
