//! The last line: the keys that apply here, the answer to the last one, or the text being typed.
//!
//! ```text
//! space play  d decision  n event  right frame  . second  + faster  tab charts  : jump  ? help  q leave
//! ```

use ratatui::layout::Rect;

use crate::look::{Glyph, ThemeRole};
use crate::replay::action::ReplayAction;
use crate::replay::model::ReplayModel;
use crate::views::hints::field;
use crate::views::short;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_wording::console::replay as wording;

pub fn draw(model: &ReplayModel, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let row = if let Some(line) = &model.typing {
        let what = "Jump to ";
        let room = width.saturating_sub(what.len());
        let row = Row::of(ThemeRole::Key, what).and(field(pen, line, room.min(24), true));
        row.with(ThemeRole::Muted, wording::JUMP_TARGETS)
    } else if let Some(notice) = &model.notice {
        let is_bad = notice.message.is_bad();
        let (role, glyph) =
            if is_bad { (ThemeRole::Problem, Glyph::Warning) } else { (ThemeRole::Notice, Glyph::Good) };
        Row::of(role, &format!("{} {}", pen.look.glyph(glyph), short(&notice.message.to_string(), 400)))
    } else {
        keys(model, width)
    };
    pen.row(area, 0, &row);
}

/// The most important first; help and leaving stand in every line.
fn keys(model: &ReplayModel, width: usize) -> Row {
    use ReplayAction as A;
    let here = [
        A::Play,
        A::Failure,
        A::NextTurn,
        A::NextEvent,
        A::NextFrame,
        A::SecondOn,
        A::Faster,
        A::NextCharts,
        A::Jump,
        A::SkipGaps,
        A::First,
        A::Last,
    ];
    let tail = if model.help.is_some() {
        Row::of(ThemeRole::Key, "esc").with(ThemeRole::Text, " close")
    } else {
        hint(model, A::Help).and(hint(model, A::Leave))
    };
    let mut row = Row::new();
    let applies = |action: &A| *action != A::Failure || !model.timeline.failures().times_ms().is_empty();
    for action in here.into_iter().filter(|_| model.help.is_none()).filter(applies) {
        let next = hint(model, action);
        if row.width() + next.width() + tail.width() <= width {
            row = row.and(next);
        }
    }
    row.and(tail)
}

fn hint(model: &ReplayModel, action: ReplayAction) -> Row {
    let key = action.keys().split(' ').next().unwrap_or_default();
    let label = match action {
        ReplayAction::Play if model.playing => "pause",
        ReplayAction::SkipGaps if model.skips_gaps => "play gaps",
        other => other.name(),
    };
    Row::of(ThemeRole::Key, key).with(ThemeRole::Text, &format!(" {label}  "))
}
