//! The last line: keys that matter here, or the answer to the last one, or what is being typed.
//!
//! ```text
//! space play  right picture  . second  + faster  n event  d decision  : jump  tab charts  ? help  q leave
//! ```

use ratatui::layout::Rect;

use crate::look::{Glyph, Role};
use crate::replay::action::Action;
use crate::replay::model::Model;
use crate::views::hints::field;
use crate::views::short;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;

/// Draws it.
pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(area.width);
    let row = if let Some(line) = &model.typing {
        let what = "Jump to ";
        let room = width.saturating_sub(what.len());
        let row = Row::of(Role::Key, what).and(field(pen, line, room.min(24), true));
        row.with(Role::Muted, "   12.5s  1:02  t 3000  +5s   enter jumps, esc cancels")
    } else if let Some(notice) = &model.notice {
        let (role, glyph) =
            if notice.bad { (Role::Problem, Glyph::Warning) } else { (Role::Notice, Glyph::Good) };
        Row::of(role, &format!("{} {}", pen.look.glyph(glyph), short(&notice.text, 400)))
    } else {
        keys(model, width)
    };
    pen.row(area, 0, &row);
}

/// The weightiest first; help and the way out stand in every line.
fn keys(model: &Model, width: usize) -> Row {
    use Action as A;
    let here = [
        A::Play,
        A::NextTurn,
        A::NextEvent,
        A::NextPicture,
        A::SecondOn,
        A::Faster,
        A::NextCharts,
        A::Jump,
        A::SkipGaps,
        A::First,
        A::Last,
    ];
    let tail = if model.help.is_some() {
        Row::of(Role::Key, "esc").with(Role::Text, " close")
    } else {
        hint(model, A::Help).and(hint(model, A::Leave))
    };
    let mut row = Row::new();
    for action in here.into_iter().filter(|_| model.help.is_none()) {
        let next = hint(model, action);
        if row.width() + next.width() + tail.width() <= width {
            row = row.and(next);
        }
    }
    row.and(tail)
}

fn hint(model: &Model, action: Action) -> Row {
    let key = action.keys().split(' ').next().unwrap_or_default();
    let word = match action {
        Action::Play if model.playing => "pause",
        Action::SkipGaps if model.skips_gaps => "play gaps",
        other => other.word(),
    };
    Row::of(Role::Key, key).with(Role::Text, &format!(" {word}  "))
}
