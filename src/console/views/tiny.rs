//! Windows below 60 x 16: alarms and what waits, in whatever lines there are, and the way out.
//!
//! ```text
//! ◇ SIM  arm-1  STALE 12 s
//! 1▲ CRIT arm-1: the monitor …
//! ◷ 2 wait
//! X stop  q quits  ? keys
//! ```

use ratatui::layout::Rect;

use super::{banner, hints, overview, palette, prompt, status};
use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{Model, Overlay};
use crate::theme::Mark;
use crate::widgets::pen::{Pen, above, below};
use crate::widgets::row::Row;
use holdpoint_protocol::snapshot::Snapshot;

/// Lines from which an overlay can be read at all.
pub const OVERLAY_HEIGHT_MIN: u16 = 6;

pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let foot_height = hints::height(model, area);
    let last = Rect { y: area.bottom() - foot_height, height: foot_height, ..area };
    match area.height {
        0 => {}
        1 => pen.row(area, 0, &summary(model, pen, usize::from(area.width))),
        2 => {
            pen.row(area, 0, &summary(model, pen, usize::from(area.width)));
            foot(model, pen, last);
        }
        _ => {
            banner::draw(model, pen, above(area, 1));
            foot(model, pen, last);
            let status = Rect { y: last.y - 1, height: 1, ..area };
            pen.row(status, 0, &summary(model, pen, usize::from(area.width)));
            body(model, pen, Rect { y: area.y + 1, height: area.height - 2 - foot_height, ..area });
        }
    }
}

/// The gravest alarm and what waits, in one line.
fn summary(model: &Model, pen: &Pen<'_>, width: usize) -> Row {
    let waits = status::waiting(model, pen.look);
    let highest = model.told.snapshot.as_deref().and_then(Snapshot::foremost_alarm);
    let stopped = model.told.snapshot.as_deref().and_then(status::stopped);
    let row = match highest {
        Some(alarm) => {
            let head = status::priority_words(pen.look, alarm.priority);
            let left = width.saturating_sub(head.len() + waits.width());
            Row::of(Mark::priority(alarm.priority).role, &head)
                .with(ThemeRole::Text, &format!(" {} ", super::short(&alarm.text, left)))
        }
        None => {
            Row::of(ThemeRole::Muted, if model.told.snapshot.is_some() { "no alarm " } else { "no engine " })
        }
    };
    stopped.unwrap_or_default().and(row).and(waits)
}

fn foot(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let speaks = model.notice.is_some() || model.stop_overdue().is_some();
    if model.entry.typing.is_some() || speaks || model.entry.overlay.is_some() {
        hints::draw(model, pen, area);
        return;
    }
    let key = |action| model.keymap.key(action);
    let row = hints::stop(model)
        .with(ThemeRole::Key, &format!("  {}", key(Action::Quit)))
        .with(ThemeRole::Text, " quits  ")
        .with(ThemeRole::Key, &key(Action::Help))
        .with(ThemeRole::Text, " keys  ");
    let row = if model.bare_absence().is_some() {
        row
    } else {
        row.with(ThemeRole::Key, &key(Action::Abort)).with(ThemeRole::Text, " abort")
    };
    pen.row(area, 0, &row);
}

/// What lies over the view, or the other alarms and what waits.
fn body(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    if let (Some(absence), None) = (model.bare_absence(), &model.entry.overlay) {
        return super::alone::draw(model, absence, pen, area);
    }
    match &model.entry.overlay {
        Some(_) if area.height < OVERLAY_HEIGHT_MIN => {
            pen.text(
                area,
                0,
                ThemeRole::Warning,
                "Make the window larger to read what is open, or leave it with Esc",
            );
            return;
        }
        Some(Overlay::Prompt(open)) => return prompt::draw(model, open, pen, area),
        Some(Overlay::Palette(open)) => return palette::draw(model, open, pen, area),
        Some(Overlay::Form(open)) => return super::form::draw(model, open, pen, area),
        Some(Overlay::Why(open)) => return super::why::draw(model, open, pen, area),
        Some(Overlay::Film(open)) => return super::film::draw(open, pen, area),
        None => {}
    }
    let now_ms = model.engine_ms();
    let mut rows: Vec<Row> =
        model.waiting_rows().iter().map(|item| overview::waiting_row(item, now_ms, pen)).collect();
    let room = usize::from(area.height).saturating_sub(rows.len().min(usize::from(area.height / 2)));
    let alarms = model.alarm_rows();
    rows.truncate(usize::from(area.height / 2).max(1));
    let alarms = alarms.iter().take(room).map(|item| {
        let alarm = item.alarm();
        let mark = Mark::priority(alarm.priority);
        Row::of(mark.role, &status::priority_words(pen.look, alarm.priority)).with(
            ThemeRole::Text,
            &format!(" {} {}", Mark::alarm_state(alarm.state).word, super::short(&alarm.text, 200)),
        )
    });
    let rows: Vec<Row> = alarms.chain(rows.iter().cloned()).collect();
    let left = pen.rows(area, 0, &rows);
    if left == 0 {
        pen.text(below(area, 0), 0, ThemeRole::Muted, "Nothing waits");
    }
}
