//! The screens. Each reads the model and draws; none changes anything, and none decides what a key does.

pub mod alarm_history;
pub mod alarms;
pub mod alone;
pub mod approvals;
pub mod audit;
pub mod banner;
pub mod candidate;
mod candidate_rows;
pub mod families;
pub mod film;
pub mod form;
pub mod health;
pub mod hints;
pub mod menu;
pub mod overview;
pub mod palette;
pub mod pipeline;
pub mod prompt;
pub mod registry;
pub mod robot;
pub mod shadow;
pub mod status;
pub mod story;
pub mod tabs;
pub mod tiny;
pub mod tour;
pub mod why;

use ratatui::layout::Rect;

use super::action::Action;
use super::look::{Glyph, Look, ThemeRole};
use super::model::Model;
use super::theme::Mark;
use super::widgets::list::GUTTER;
use super::widgets::pen::{Pen, below};
use super::widgets::row::{Row, safe, wrap};
use super::words::seconds;
use holdpoint_governance::lifecycle::{Flags, State};

/// Foreign text on one line of at most `width` columns.
#[must_use]
pub fn short(text: &str, width: usize) -> String {
    safe(text, width)
}

/// Says that a pane stands still, since when, and the key that lets it run; tells what is left of the area. Nothing is
/// said while it runs.
pub fn frozen(model: &Model, pen: &mut Pen<'_>, area: Rect) -> Rect {
    let Some(frozen) = &model.place.frozen else { return area };
    let (glyph, since) = (pen.look.glyph(Glyph::Paused), seconds(frozen.at_ms));
    let text = format!("{glyph} FROZEN since {since}, {} lets it run", model.keymap.key(Action::Freeze));
    let lines = wrap(&text, usize::from(area.width), 2);
    let rows: Vec<Row> = lines.iter().map(|line| Row::of(ThemeRole::Stale, line)).collect();
    let taken = pen.rows(area, 0, &rows);
    below(area, taken)
}

/// Where a version stands, and what is told beside it; where there is little room, the last word of each.
#[must_use]
pub fn stands(state: State, flags: &Flags, room: usize, look: &Look) -> Row {
    let (mark, beside) = (Mark::version(state, flags), Mark::beside(state, flags));
    let row = Row::of(mark.role, &look.words(mark));
    let Some(beside) = beside else { return row };
    let row = row.with(beside.role, &format!("  {}", look.words(beside)));
    if row.width() <= room {
        return row;
    }
    let last = |mark: Mark| {
        let word = mark.word.rsplit(' ').next().unwrap_or(mark.word);
        format!("{} {word}", look.glyph(mark.glyph))
    };
    Row::of(mark.role, &last(mark)).with(beside.role, &format!(" {}", last(beside)))
}

/// An area without the columns that the mark of the cursor takes.
const fn indented(area: Rect) -> Rect {
    let taken = if area.width < GUTTER { area.width } else { GUTTER };
    Rect { x: area.x + taken, width: area.width - taken, ..area }
}

/// A window over a view: frame and title; tells where its inside is. No larger than `area`.
pub fn window(pen: &mut Pen<'_>, area: Rect, width_max: u16, height: u16, title: &str, right: &str) -> Rect {
    let (width, height) = (area.width.min(width_max), area.height.min(height));
    let left = area.x + (area.width - width) / 2;
    let top = area.y + (area.height - height) / 3;
    let frame = Rect { x: left, y: top, width, height };
    pen.clear(frame);
    let look = pen.look;
    if width < 4 || height < 3 {
        return frame;
    }
    let line = look.glyph(Glyph::Horizontal);
    let (first, last) = (frame.y, frame.bottom() - 1);
    for x in frame.left()..frame.right() {
        pen.cell(x, first, line, ThemeRole::Rule);
        pen.cell(x, last, line, ThemeRole::Rule);
    }
    for y in first..=last {
        pen.cell(frame.left(), y, look.glyph(Glyph::Vertical), ThemeRole::Rule);
        pen.cell(frame.right() - 1, y, look.glyph(Glyph::Vertical), ThemeRole::Rule);
    }
    let corners = [
        (frame.left(), first, Glyph::Corner),
        (frame.right() - 1, first, Glyph::CornerRight),
        (frame.left(), last, Glyph::CornerLow),
        (frame.right() - 1, last, Glyph::CornerLowRight),
    ];
    for (x, y, glyph) in corners {
        pen.cell(x, y, look.glyph(glyph), ThemeRole::Rule);
    }
    let inner = Rect { x: frame.x + 2, width: width - 4, ..frame };
    let title = format!(" {} ", short(title, usize::from(inner.width).saturating_sub(2)));
    pen.row(inner, 0, &Row::of(ThemeRole::Focus, &title));
    let place = Row::of(ThemeRole::Muted, &format!(" {right} "));
    let taken = u16::try_from(place.width()).unwrap_or(u16::MAX);
    if !right.is_empty() && usize::from(taken) + title.len() + 2 < usize::from(inner.width) {
        pen.row(Rect { x: inner.right() - taken, width: taken, ..inner }, 0, &place);
    }
    Rect { y: frame.y + 1, height: height - 2, ..inner }
}
