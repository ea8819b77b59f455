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
use crate::look::Glyph;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, EVENT_LOG_PANE, MONITORS_PANE, Overlay, View};
use crate::rows::{AlarmItem, RegistryItem};
use crate::state_filter::{StateFilter, counts_and_place};
use crate::theme::StateMark;
use crate::waiting_rows::WaitingRow;
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Pen, above, below, cut, heading_room};
use crate::widgets::row::Row;
use holdpoint_protocol::snapshot::{Disagreement, Snapshot};

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
            pen.text(
                area,
                0,
                ThemeRole::Warning,
                "Make the window larger to read what is open, or leave it with Esc",
            );
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
        pen.text(area, 0, ThemeRole::Muted, "Nothing waits");
        return below(area, 1);
    }
    below(area, taken)
}

fn alarm(item: AlarmItem<'_>, pen: &Pen<'_>) -> Row {
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
    let view = model.view_state.view;
    let pane = view.panes().get(model.view_state.pane()).copied().unwrap_or("");
    let title = match view {
        // The mark of a filter needs the space of the view's title.
        View::Overview if !model.filter().is_empty() || model.view_state.state_filter != StateFilter::All => {
            pane.to_owned()
        }
        _ if view.panes().len() > 1 => format!("{}: {pane}", view.title()),
        _ => view.title().to_owned(),
    };
    let place = match (view, model.view_state.pane()) {
        (View::Overview, pane) if !matches!(pane, overview::ROBOT_PANE | EVENT_LOG_PANE) => {
            super::pipeline::extent(model, model.row(), &title, area.width)
        }
        (View::Registry, _) => {
            let place = place(model.row_count(), model.row());
            counts_and_place(model, &place, heading_room(&title, area.width))
        }
        _ => place(model.row_count(), model.row()),
    };
    let inside = pen.pane(area, &title, true, &place);
    match (view, model.view_state.pane()) {
        (View::Overview, overview::ROBOT_PANE) => return super::robot::draw(model, pen, inside),
        (View::Overview, EVENT_LOG_PANE) => return super::event_log::draw(model, pen, inside, true),
        (View::Overview, _) => return versions_and_pipeline(model, pen, inside),
        (View::Shadow, MONITORS_PANE) => return super::shadow::monitor_rows(model, pen, inside),
        (View::Shadow, 0) => return shadow(model, pen, inside),
        (View::Health, _) => return super::health::draw_small(model, pen, inside),
        _ => {}
    }
    let rows = rows(model, pen, usize::from(inside.width.saturating_sub(GUTTER)));
    if rows.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, "Nothing here yet");
        return;
    }
    pen.list(inside, rows.len(), Some(model.row()), |index, _| rows.get(index).cloned().unwrap_or_default());
}

/// The active versions, then the candidates.
fn versions_and_pipeline(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let active = super::families::rows(model, pen, usize::from(area.width));
    let (top, bottom) = cut(area, u16::try_from(active.len()).unwrap_or(u16::MAX).min(area.height / 2));
    pen.rows(top, 0, &active);
    super::pipeline::draw(model, pen, bottom, true);
}

/// The three distances in words.
fn shadow(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let Some(version) = model.subject() else {
        pen.text(area, 0, ThemeRole::Muted, "No candidate yet, and so no twin");
        return;
    };
    let mut rows = vec![Row::of(ThemeRole::Title, &version.to_string())];
    let candidate = model.candidate(&version);
    match candidate.and_then(|candidate| candidate.shadow.as_ref()) {
        None => rows.push(Row::of(ThemeRole::Muted, &super::shadow::absent_series(model))),
        Some(shadow) => {
            let means = [shadow.output, shadow.governance, shadow.envelope];
            for ((name, mean), limit) in super::shadow::NAMES.iter().zip(means).zip(shadow.limits) {
                let label = name.split(' ').next().unwrap_or(name);
                let limit = limit.map_or_else(String::new, |limit| format!(" of {limit:.2}"));
                rows.push(Row::of(ThemeRole::Text, &format!("{label:<11} {mean:.3}{limit}")));
            }
            rows.push(Row::of(ThemeRole::Muted, &format!("{} sequences", shadow.n)));
        }
    }
    pen.rows(area, 0, &rows);
}

/// A line for each row of a list's view.
fn rows(model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let look = pen.look;
    match model.view_state.view {
        View::Registry => {
            model.registry_rows().iter().map(|item| registry(model, item, pen, width)).collect()
        }
        View::Candidate => {
            let rows = model.candidate_rows(model.view_state.pane());
            let first = |row| super::candidate_rows::item(model, row, look, width).into_iter().next();
            rows.iter().map(|row| first(row).unwrap_or_default()).collect()
        }
        View::Alarms => model.alarm_rows().iter().map(|item| alarm(*item, pen)).collect(),
        View::Approvals => {
            model.waiting_rows().iter().map(|item| overview::waiting_row(model, item, pen, width)).collect()
        }
        View::Audit => model.audit_rows().iter().map(super::audit::brief).collect(),
        View::Shadow => {
            let line = |row: &&Disagreement| Row::of(ThemeRole::Text, &format!("{} {}", row.index, row.text));
            model.disagreement_rows().iter().map(line).collect()
        }
        View::Health | View::Overview => Vec::new(),
    }
}

fn registry(model: &ConsoleModel, item: &RegistryItem<'_>, pen: &Pen<'_>, width: usize) -> Row {
    match item {
        RegistryItem::Family { family, versions, open } => {
            let glyph = pen.look.glyph(if *open { Glyph::Open } else { Glyph::Closed });
            Row::of(ThemeRole::Title, &format!("{glyph} {family}"))
                .with(ThemeRole::Muted, &format!("  {versions}"))
        }
        RegistryItem::Version(row) => {
            let marked = model.view_state.marked_versions.contains(&row.version);
            super::registry::lead(marked, false, pen.look)
                .cell(ThemeRole::Text, &super::cut_middle(&row.version.version.to_string(), 7), 8)
                .and(super::state_row(row.state, &row.flags, width.saturating_sub(12), pen.look))
        }
    }
}
