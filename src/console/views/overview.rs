//! View 1: the robot, active versions, the progress of candidates, waiting requests, and the event log.
//!
//! ```text
//! ── Active ─────────────────────────── │ ▸ Robot ──────────────────
//! grasp ✔ active grasp@1.0.0            │  side view     │ top view
//! ▸ Pipeline ────────────────── 1 of 2 ─ │
//! ▸ grasp@1.1.0 ◌ running               │  grasp 0.21 m/s 4.1 N held
//!   ✔ register ✔ validate ◌ sandbox …   │ ── Waits for people ───────
//!   ████░░░░ 137 of 480                 │ ◷ place@1.1.0 approval 0 of 2
//! ── Events ──────────────────────────────────────────────────────
//! ```

use ratatui::layout::Rect;

use super::{event_log, families, pipeline, robot, tabs};
use crate::formatters::{approvals, duration};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, EVENT_LOG_PANE};
use crate::rows::{CandidateItem, PendingApprovalItem};
use crate::widgets::pen::{Fit, Hit, Pen, below, cut};
use crate::widgets::row::Row;

const PIPELINE_PANE: usize = 0;
pub(super) const ROBOT_PANE: usize = 1;

/// The size from which the view has room for the checks of the candidate under the cursor, below the pipeline.
const WIDE_COLUMNS: u16 = 160;

const WIDE_ROWS: u16 = 30;

/// The width from which the pipeline names the seven stages.
const STRIP_WIDTH: u16 = 62;

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
    let (left, right) = pen.split(area, area.width * 3 / 5);
    versions_and_pipeline(model, pen, left);
    if model.view_state.pane() == EVENT_LOG_PANE {
        event_log_pane(model, pen, right);
    } else {
        robot_pane(model, pen, right);
    }
}

fn draw_all_panes(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let event_log_height = (area.height / 4).max(6);
    let (upper, lower) = cut(area, area.height - event_log_height);
    let (left, right) = pen.split(upper, (upper.width * 3 / 5).max(STRIP_WIDTH));
    if area.width >= WIDE_COLUMNS && left.height >= WIDE_ROWS {
        let (top, bottom) = cut(left, left.height / 2);
        versions_and_pipeline(model, pen, top);
        checks_under_cursor(model, pen, bottom);
    } else {
        versions_and_pipeline(model, pen, left);
    }
    let waiting_height = waiting_height(model).min(right.height / 3);
    let (robot_area, waiting_area) = cut(right, right.height - waiting_height);
    robot_pane(model, pen, robot_area);
    waiting_pane(model, pen, waiting_area);
    event_log_pane(model, pen, lower);
}

/// Active versions above the pipeline.
fn versions_and_pipeline(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let active = families::rows(model, pen, usize::from(area.width));
    // The pipeline gets at least half.
    let height = u16::try_from(active.len() + 1).unwrap_or(u16::MAX).min(area.height / 2);
    let (top, bottom) = cut(area, height);
    let inside = pen.pane(top, "Active", false, "");
    pen.rows(inside, 0, &active);
    let focused = model.view_state.pane() == PIPELINE_PANE;
    let cursor = if focused { model.row() } else { 0 };
    pen.hit(area, Hit::Pane(PIPELINE_PANE));
    let inside = pen.pane(bottom, "Pipeline", focused, &pipeline::extent(model, cursor, bottom.width));
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
        .flat_map(|row| super::candidate_rows::item(&row, look, width))
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

fn waiting_height(model: &ConsoleModel) -> u16 {
    let rows = model.waiting_rows().len();
    if rows == 0 { 0 } else { u16::try_from(rows + 2).unwrap_or(u16::MAX) }
}

fn waiting_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let rows = model.waiting_rows();
    if rows.is_empty() {
        return;
    }
    let key = model.keymap.key(crate::action::Action::ShowApprovals);
    let inside = pen.pane(area, "Waits for people", false, &format!("{key} opens"));
    for (at, item) in (0..inside.height).zip(&rows) {
        pen.row(inside, at, &waiting_row(model, item, pen));
    }
}

/// One waiting request, in a line.
#[must_use]
pub fn waiting_row(model: &ConsoleModel, item: &PendingApprovalItem<'_>, pen: &Pen<'_>) -> Row {
    let now_ms = model.engine_ms();
    let glyph = pen.look.glyph(Glyph::Waiting);
    match item {
        PendingApprovalItem::MonitorQuestion(question) => {
            Row::of(ThemeRole::Waiting, &format!("{glyph} question "))
                .with(ThemeRole::Text, &question.version.to_string())
                .with(
                    ThemeRole::Muted,
                    &format!("  rolled back in {}", time_left(question.deadline_ms, now_ms)),
                )
        }
        PendingApprovalItem::Approval(prompt) => {
            let (count, next) = approvals(prompt, model.is_stopped(), model.time());
            let role = if prompt.granted { ThemeRole::Text } else { ThemeRole::Muted };
            Row::of(ThemeRole::Waiting, &format!("{glyph} approval "))
                .with(ThemeRole::Text, &format!("{}  {count}", prompt.version))
                .with(role, &format!("  {next}"))
        }
    }
}

/// The time until a deadline.
#[must_use]
pub fn time_left(deadline_ms: u64, now_ms: u64) -> String {
    duration(deadline_ms.saturating_sub(now_ms))
}
