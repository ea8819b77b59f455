//! The whole screen: its parts at each size, and their places.
//!
//! ```text
//! banner     profile, robot, who, doubts
//! tabs       views and their keys
//! (state)    the state that overrides all others; in the overview, what drives the arm
//! (tour)     one sentence, until it is dismissed
//! body       the view, or what lies over it
//! status     the most serious alarm, counts, waiting requests
//! hints      keys, answer, or typed text
//! ```

use ratatui::buffer::Buffer;
use ratatui::layout::{Position, Rect};

use super::approval_screen::VisibleRows;
use super::look::{Look, ThemeRole};
use super::model::{ConsoleModel, Overlay};
use super::views;
use super::widgets::pen::{Fit, Hit, Pen, above, below};
use super::widgets::row::Row;
use holdpoint_wording::console::overlays as wording;

/// Draws everything into `area`, which may have any size.
pub fn draw(model: &ConsoleModel, look: &Look, area: Rect, buf: &mut Buffer) {
    let area = area.intersection(buf.area);
    if area.is_empty() {
        return;
    }
    let mut pen = Pen::new(look, buf, Fit::of(area.width, area.height));
    paint(model, &mut pen, area);
}

/// The meaning of a click at a place of the current screen; absent if it has none.
#[must_use]
pub fn hit(model: &ConsoleModel, look: &Look, area: Rect, (column, row): (u16, u16)) -> Option<Hit> {
    let mut buf = Buffer::empty(area);
    let mut pen = Pen::new(look, &mut buf, Fit::of(area.width, area.height));
    if !area.is_empty() {
        paint(model, &mut pen, area);
    }
    let at = Position { x: column, y: row };
    pen.hits.iter().rev().find(|(place, _)| place.contains(at)).map(|(_, hit)| *hit)
}

fn paint(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    pen.clear(area);
    let menu = model.input.menu.as_ref();
    if pen.fit == Fit::Tiny {
        views::small_window::draw(model, pen, area);
        if let Some(menu) = menu {
            views::menu::draw(menu, pen, above(area, area.height - 1));
        }
        return;
    }
    views::banner::draw(model, pen, above(area, 1));
    let hints = views::hints::height(model, area);
    let foot = area.height - 1 - hints;
    let status = Rect { y: area.y + foot, height: 1, ..area };
    views::status::draw(model, pen, status);
    views::dim_if_old(model, pen, status);
    views::hints::draw(model, pen, Rect { y: area.y + foot + 1, height: hints, ..area });
    let body = below(Rect { height: foot, ..area }, 1);
    match &model.input.overlay {
        // The whole decision must be readable: it takes the whole area.
        Some(Overlay::Approval(prompt)) => views::approval_screen::draw(model, prompt, pen, body),
        Some(Overlay::Palette(palette)) => {
            let body = under(model, pen, body);
            views::palette::draw(model, palette, pen, body);
        }
        Some(Overlay::Form(form)) => {
            let body = under(model, pen, body);
            views::form::draw(model, form, pen, body);
        }
        Some(Overlay::Why(screen)) => {
            let body = below_state_line(model, pen, body);
            views::why::draw(model, screen, pen, body);
        }
        Some(Overlay::Film(watched)) => {
            let body = below_state_line(model, pen, body);
            views::film::draw(watched, pen, body);
        }
        Some(Overlay::Replay(replay)) => {
            let body = below_state_line(model, pen, body);
            super::replay::frame::draw(replay, pen.look, body, pen.buf);
        }
        Some(Overlay::KeyLog(row)) => {
            let body = under(model, pen, body);
            views::key_log::draw(model, *row, pen, body);
        }
        Some(Overlay::Event(screen)) => {
            let body = under(model, pen, body);
            views::event_log::draw_in_full(model, screen, pen, body);
        }
        None => {
            under(model, pen, body);
        }
    }
    if let Some(menu) = menu {
        views::menu::draw(menu, pen, body);
    }
}

/// The rows of an open decision or form that [`draw`] puts on the screen; absent if none is open. Without room for
/// it, there are no rows.
#[must_use]
pub fn decision_on_screen(model: &ConsoleModel, look: &Look, area: Rect) -> Option<VisibleRows> {
    let open = model.input.overlay.as_ref()?;
    if !matches!(open, Overlay::Approval(_) | Overlay::Form(_)) {
        return None;
    }
    let fit = Fit::of(area.width, area.height);
    let hints = views::hints::height(model, area);
    let height = area.height.saturating_sub(2 + hints);
    let body = Rect { y: area.y + 1, height, ..area };
    if height == 0 || (fit == Fit::Tiny && height < views::small_window::OVERLAY_HEIGHT_MIN) {
        return matches!(open, Overlay::Form(_))
            .then_some(VisibleRows { count: 1, ..VisibleRows::default() });
    }
    let mut nowhere = Buffer::empty(Rect::default());
    let pen = Pen::new(look, &mut nowhere, fit);
    match open {
        Overlay::Approval(prompt) => Some(views::approval_screen::on_screen(model, prompt, &pen, body)),
        Overlay::Form(form) => {
            let area = if fit == Fit::Tiny { body } else { view_area(model, body) };
            Some(views::form::on_screen(model, form, &pen, area))
        }
        Overlay::Palette(_)
        | Overlay::Why(_)
        | Overlay::Film(_)
        | Overlay::Replay(_)
        | Overlay::KeyLog(_)
        | Overlay::Event(_) => None,
    }
}

/// The area of the view below a form, as [`under`] returns it.
fn view_area(model: &ConsoleModel, area: Rect) -> Rect {
    if model.bare_absence().is_some() {
        return area;
    }
    let lines = [views::state_line::is_shown(model), views::tour::sentence(model).is_some()];
    below(area, lines.into_iter().fold(1, |rows, is_shown| rows + u16::from(is_shown)))
}

/// Draws the line of state in the first row, if there is one; returns the area below it.
fn below_state_line(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) -> Rect {
    if !views::state_line::is_shown(model) {
        return area;
    }
    views::state_line::draw(model, pen, above(area, 1));
    below(area, 1)
}

/// Draws the view with the lines above it; returns the view's area.
fn under(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) -> Rect {
    if let Some(absence) = model.bare_absence() {
        views::no_engine::draw(model, absence, pen, area);
        return area;
    }
    views::tabs::views(model, pen, above(area, 1));
    let body = view_area(model, area);
    let line = below_state_line(model, pen, below(area, 1));
    if let Some(sentence) = views::tour::sentence(model) {
        let key = model.keymap.key(super::action::Action::Tour);
        // The key that dismisses the sentence stays even if the sentence is cut.
        let tail = wording::ends_the_tour(&key);
        let room = usize::from(area.width).saturating_sub(tail.len());
        let row = Row::of(ThemeRole::Notice, &views::short(sentence, room)).with(ThemeRole::Muted, &tail);
        pen.row(line, 0, &row);
    }
    model.view_state.view.behavior().draw(model, pen, body);
    views::dim_if_old(model, pen, body);
    body
}

/// The screen as plain text, lines without blanks at their end: for exports and the README.
#[must_use]
pub fn text_of(model: &ConsoleModel, look: &Look, width: u16, height: u16) -> String {
    let area = Rect::new(0, 0, width, height);
    let mut buf = Buffer::empty(area);
    draw(model, look, area, &mut buf);
    plain(&buf)
}

/// The drawn text, without styles.
pub(crate) fn plain(buf: &Buffer) -> String {
    let area = buf.area;
    let mut text = String::new();
    for y in area.top()..area.bottom() {
        let mut line = String::new();
        let mut covered = 0;
        for x in area.left()..area.right() {
            let Some(cell) = buf.cell((x, y)) else { continue };
            // The second column of a wide sign is part of it.
            if covered == 0 {
                line.push_str(cell.symbol());
                covered = unicode_width::UnicodeWidthStr::width(cell.symbol()).max(1);
            }
            covered -= 1;
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}
