//! Windows below 60 x 16: alarms and waiting requests, then the view in short if lines are left, and the leaving keys.
//!
//! ```text
//! ◇ SIM  arm-1  STALE 12 s
//! 1▲ CRIT arm-1: the monitor …
//! ─ Overview: Pipeline ── 1 of 2 ─
//! ▸ grasp@1.1.0 ◌ running
//! X stop  q quits  ? keys
//! ```

use ratatui::layout::Rect;

use super::{approval_screen, banner, hints, overview, palette, status};
use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, Overlay, View};
use crate::rows::AlarmItem;
use crate::theme::StateMark;
use crate::waiting_rows::WaitingRow;
use crate::widgets::pen::{Pen, above, below};
use crate::widgets::row::Row;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_wording::console::small_window as wording;

/// Lines from which the view itself is shown, in short.
const VIEW_ROWS_MIN: usize = 6;

/// Lines from which an overlay is readable.
pub const OVERLAY_HEIGHT_MIN: u16 = 6;

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let foot_height = hints::height(model, area);
    let last = Rect { y: area.bottom() - foot_height, height: foot_height, ..area };
    match area.height {
        0 => {}
        1 => pen.row(area, 0, &summary(model, pen, usize::from(area.width))),
        2 => {
            pen.row(area, 0, &summary(model, pen, usize::from(area.width)));
            footer(model, pen, last);
        }
        _ => {
            banner::draw(model, pen, above(area, 1));
            footer(model, pen, last);
            let status = Rect { y: last.y - 1, height: 1, ..area };
            pen.row(status, 0, &summary(model, pen, usize::from(area.width)));
            let view = Rect { y: area.y + 1, height: area.height - 2 - foot_height, ..area };
            body(model, pen, view);
            if model.input.overlay.is_none() {
                super::dim_if_old(model, pen, view);
            }
            super::dim_if_old(model, pen, status);
        }
    }
}

/// The most serious alarm and the waiting requests, in one line.
fn summary(model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Row {
    let waits = status::waiting(model, pen.look);
    let highest = model.engine_data.snapshot.as_deref().and_then(Snapshot::foremost_alarm);
    let row = match highest {
        Some(alarm) => {
            let head = status::priority_label(pen.look, alarm.priority);
            let left = width.saturating_sub(head.len() + waits.width());
            Row::of(StateMark::priority(alarm.priority).role, &head).with(
                ThemeRole::Text,
                &format!(" {} ", super::short(&holdpoint_wording::notice(&alarm.text), left)),
            )
        }
        None if model.engine_data.snapshot.is_some() => {
            Row::of(ThemeRole::Muted, &format!("{} ", status::no_alarm(model)))
        }
        None => Row::of(ThemeRole::Muted, "no engine "),
    };
    status::stop_row(model).unwrap_or_default().and(row).and(waits)
}

fn footer(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let speaks = model.notice.is_some() || model.stop_overdue().is_some() || model.line_mode;
    if model.input.typing.is_some() || speaks || model.input.overlay.is_some() {
        hints::draw(model, pen, area);
        return;
    }
    let key = |action| model.keymap.key(action);
    let leads_back = model.absence().is_none() && model.view_state.view != View::Overview;
    let row = hints::stop(model)
        .with(ThemeRole::Key, &format!("  {}", key(Action::Quit)))
        .with(ThemeRole::Text, if leads_back { " back  " } else { " quits  " })
        .with(ThemeRole::Key, &key(Action::Help))
        .with(ThemeRole::Text, " keys  ");
    let row = if model.absence().is_some() {
        row
    } else {
        row.with(ThemeRole::Key, &key(Action::Abort)).with(ThemeRole::Text, " abort")
    };
    pen.row(area, 0, &row);
}

/// The overlay, or the other alarms and waiting requests.
fn body(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    if let (Some(absence), None) = (model.bare_absence(), &model.input.overlay) {
        return super::no_engine::draw(model, absence, pen, area);
    }
    match &model.input.overlay {
        Some(_) if area.height < OVERLAY_HEIGHT_MIN => {
            pen.text(area, 0, ThemeRole::Warning, wording::MAKE_IT_LARGER);
            return;
        }
        Some(Overlay::Approval(open)) => return approval_screen::draw(model, open, pen, area),
        Some(Overlay::Palette(open)) => return palette::draw(model, open, pen, area),
        Some(Overlay::Form(open)) => return super::form::draw(model, open, pen, area),
        Some(Overlay::Why(open)) => return super::why::draw(model, open, pen, area),
        Some(Overlay::Film(open)) => return super::film::draw(open, pen, area),
        Some(Overlay::Replay(open)) => return crate::replay::frame::draw(open, pen.look, area, pen.buf),
        Some(Overlay::KeyLog(row)) => return super::key_log::draw(model, *row, pen, area),
        Some(Overlay::Event(open)) => return super::event_log::draw_in_full(model, open, pen, area),
        None => {}
    }
    let rest = attention(model, pen, area);
    if rest.height > 1 {
        view(model, pen, rest);
    }
}

/// Alarms and waiting requests: in every view, and first. Returns the rest of the area.
fn attention(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) -> Rect {
    // A version that stands has no deadline.
    let mut waiting = model.waiting_rows();
    waiting.retain(|row| !matches!(row, WaitingRow::Standing(_)));
    let alarms = model.alarm_rows();
    let height = usize::from(area.height);
    // If the view has room below, only the most serious of both are shown here; their own views list the rest.
    let most = if height >= VIEW_ROWS_MIN { 2 } else { (height / 2).max(1) };
    let waiting = if model.view_state.view == View::Approvals { &[][..] } else { &waiting[..] };
    let width = usize::from(area.width);
    let rows: Vec<Row> =
        waiting.iter().take(most).map(|item| overview::waiting_row(model, item, pen, width)).collect();
    let room = if height >= VIEW_ROWS_MIN { most } else { height.saturating_sub(rows.len()) };
    let room = if height >= VIEW_ROWS_MIN && model.view_state.view == View::Alarms { 0 } else { room };
    let alarms = alarms.iter().take(room).map(|item| alarm(*item, pen));
    let rows: Vec<Row> = alarms.chain(rows).collect();
    let taken = pen.rows(area, 0, &rows);
    if taken == 0 && height < VIEW_ROWS_MIN {
        pen.text(area, 0, ThemeRole::Muted, wording::NOTHING_WAITS);
        return below(area, 1);
    }
    below(area, taken)
}

/// An alarm in one line.
pub(super) fn alarm(item: AlarmItem<'_>, pen: &Pen<'_>) -> Row {
    let alarm = item.alarm();
    let mark = StateMark::priority(alarm.priority);
    Row::of(mark.role, &status::priority_label(pen.look, alarm.priority)).with(
        ThemeRole::Text,
        &format!(
            " {} {}",
            StateMark::alarm_state(alarm.state).label,
            super::short(&holdpoint_wording::notice(&alarm.text), 200)
        ),
    )
}

/// The view in short, with its name and its cursor, in the remaining lines.
fn view(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let view = model.view_state.view.behavior();
    let title = view.small_title(model);
    let inside = pen.pane(area, &title, true, &view.small_place(model, &title, area.width));
    view.draw_small(model, pen, inside);
}

/// Draws a list, one line for each row.
pub(super) fn draw_rows(model: &ConsoleModel, rows: &[Row], pen: &mut Pen<'_>, area: Rect) {
    if rows.is_empty() {
        pen.text(area, 0, ThemeRole::Muted, wording::NOTHING_HERE_YET);
        return;
    }
    pen.list(area, rows.len(), Some(model.row()), |index, _| rows.get(index).cloned().unwrap_or_default());
}
