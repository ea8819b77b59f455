//! The alarms' other pane: the course of each alarm of the last 30 days, newest first.
//!
//! ```text
//!   priority  raised              stood     state         what
//! ▸ 2◆ HIGH   Tue 17 Nov 08:12    4 min 5 s normal        degraded:grasp@1.1.0
//! ── degraded:grasp@1.1.0 ─────────────────────────────────────────────
//! raised 08:12:03, acknowledged 08:13:10 by ana, over 08:16:08, closed by ana: the mount was loose
//! ```

use ratatui::layout::Rect;

use super::status::priority_label;
use crate::formatters::{duration, seconds};
use crate::look::ThemeRole;
use crate::model::ConsoleModel;
use crate::theme::StateMark;
use crate::widgets::list::place;
use crate::widgets::pen::{Pen, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::calendar;
use holdpoint_protocol::health::AlarmStep;
use holdpoint_wording::console::alarms as wording;
use holdpoint_wording::console::shared;

/// Lines for the one under the cursor.
const DETAIL_ROWS: u16 = 9;

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let spells = model.alarm_spells();
    let inside = pen.pane(area, wording::LAST_30_DAYS, true, &place(spells.len(), model.row()));
    if spells.is_empty() {
        let text = match &model.engine_data.alarm_history {
            None => shared::RECORD_IS_BEING_READ,
            Some(_) => wording::NONE_IN_30_DAYS,
        };
        pen.text(inside, 0, ThemeRole::Muted, text);
        return;
    }
    let look = pen.look;
    let header = Row::new()
        .to_column(2)
        .cell(ThemeRole::Muted, "priority", 9)
        .cell(ThemeRole::Muted, "raised", 18)
        .cell(ThemeRole::Muted, "stood", 12)
        .cell(ThemeRole::Muted, "state", 17)
        .with(ThemeRole::Muted, "alarm");
    pen.row(inside, 0, &header);
    let detail_rows = DETAIL_ROWS.min(inside.height / 2);
    let (list, detail) = cut(below(inside, 1), inside.height.saturating_sub(1 + detail_rows));
    let now_ms = model.engine_ms();
    pen.list(list, spells.len(), Some(model.row()), |index, _| {
        spells.get(index).map_or_else(Row::new, |spell| {
            let priority = StateMark::priority(spell.priority);
            let state = StateMark::alarm_state(spell.state);
            let role = if spell.ended.is_some() { ThemeRole::Quiet } else { priority.role };
            let stood = duration(spell.active_ms(now_ms));
            Row::new()
                .with(role, &priority_label(look, spell.priority))
                .to_column(9)
                .cell(ThemeRole::Text, &when(&spell.raised), 18)
                .cell(ThemeRole::Text, &stood, 12)
                .cell(state.role, &look.mark_label(state), 16)
                .with(ThemeRole::Text, " ")
                .with(ThemeRole::Text, &spell.alarm)
        })
    });
    if let Some(spell) = spells.get(model.row()) {
        let inside = pen.pane(detail, &super::short(&spell.alarm, 80), false, "");
        let width = usize::from(inside.width);
        let mut rows = Vec::new();
        let course = holdpoint_wording::health::alarm_course(spell, now_ms);
        if let Some(text) = &spell.text {
            rows.extend(
                wrap(&holdpoint_wording::notice(text), width, 2)
                    .iter()
                    .map(|line| Row::of(ThemeRole::Text, line)),
            );
        }
        let course = wrap(&course.join("; "), width, usize::from(DETAIL_ROWS));
        rows.extend(course.iter().map(|line| Row::of(ThemeRole::Text, line)));
        pen.rows(inside, 0, &rows);
    }
}

/// The time of a step, by the machine's clock if known, else by the engine's.
fn when(step: &AlarmStep) -> String {
    step.wall_ms.map_or_else(
        || seconds(step.at_ms),
        // The sentences contain the seconds.
        |wall_ms| calendar::day_and_time(wall_ms - wall_ms.rem_euclid(60_000)),
    )
}
