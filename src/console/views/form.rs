//! A form: the operation, its consequences, the fields, and the button that has the keys.
//!
//! ```text
//! ┌ Roll grasp@1.1.0 back ──────────────── as ana ┐
//! │ grasp@1.0.0 takes over at once               │
//! │ Reason  it drops what it holds▏              │
//! │ ▸[Cancel]   Roll back                        │
//! └──────────────────────────────────────────────┘
//! ```

use ratatui::layout::Rect;

use super::hints::field;
use crate::action::Action;
use crate::approval_screen::VisibleRows;
use crate::form::{Form, FormFocus, Intent, SHELVE_MINUTES_MAX};
use crate::look::{Glyph, ThemeRole};
use crate::model::ConsoleModel;
use crate::widgets::pen::Pen;
use crate::widgets::row::{Row, wrap};
use holdpoint_wording::console::form as wording;
use holdpoint_wording::console::shared;

/// The most rows of one consequence: more than the longest reason has.
const WRAPPED_MAX: usize = 200;

/// The widest form, columns.
const WIDTH_MAX: u16 = 76;

/// Draws it over the view.
pub fn draw(model: &ConsoleModel, form: &Form, pen: &mut Pen<'_>, area: Rect) {
    let width = usize::from(width_of(area));
    let body = body(form, width);
    let foot = footer_of(model, form, pen, width);
    let by = model.session.operator.as_ref().filter(|_| form.intent.needs_person());
    let by = by.map_or_else(String::new, |who| format!("as {}", super::short(&who.name, 24)));
    let height = u16::try_from(body.len() + foot.len() + 2).unwrap_or(u16::MAX);
    let inside = super::window(pen, area, WIDTH_MAX, height, &form.intent.title(), &by);
    // If space is short, fields and buttons stay in sight, and the rest scrolls.
    let (upper, lower) = crate::widgets::pen::cut(inside, room(inside.height, foot.len()));
    let visible = visible_rows(form, usize::from(width_of(area)), usize::from(upper.height), body.len());
    let mut rows = body;
    rows.drain(..visible.first.min(rows.len()));
    rows.truncate(visible.room);
    pen.rows(upper, 0, &rows);
    if visible.first + visible.room < visible.count && upper.height > 0 {
        let hidden = visible.count - visible.first - visible.room;
        let key = model.keymap.key(Action::PageDown);
        pen.row(upper, upper.height - 1, &Row::of(ThemeRole::Warning, &shared::more_below(hidden, &key)));
    }
    pen.rows(lower, 0, &foot);
}

/// The rows of a form's consequences that [`draw`] puts on the screen.
#[must_use]
pub fn on_screen(model: &ConsoleModel, form: &Form, pen: &Pen<'_>, area: Rect) -> VisibleRows {
    let width = usize::from(width_of(area));
    let (count, foot) = (body(form, width).len(), footer_of(model, form, pen, width).len());
    let height = area.height.min(u16::try_from(count + foot + 2).unwrap_or(u16::MAX));
    // As in the window: without its frame, if there is room for one.
    let inside = if area.width.min(WIDTH_MAX) < 4 || height < 3 { height } else { height - 2 };
    visible_rows(form, width, usize::from(room(inside, foot)), count)
}

fn width_of(area: Rect) -> u16 {
    area.width.min(WIDTH_MAX).saturating_sub(4)
}

/// Rows above the foot.
fn room(inside: u16, foot: usize) -> u16 {
    inside.saturating_sub(u16::try_from(foot).unwrap_or(u16::MAX))
}

/// If space is short, the last row says how much follows.
fn visible_rows(form: &Form, width: usize, height: usize, count: usize) -> VisibleRows {
    let room = if count > height { height.saturating_sub(1) } else { height };
    let first = usize::from(form.scroll).min(count.saturating_sub(room));
    let room = if first + height >= count { height } else { room };
    VisibleRows { width, first, room, count, rows: Vec::new() }
}

fn body(form: &Form, width: usize) -> Vec<Row> {
    let lines = form.consequences.iter().flat_map(|line| wrap(line, width, WRAPPED_MAX));
    let mut rows: Vec<Row> = lines.map(|line| Row::of(ThemeRole::Text, &line)).collect();
    if !rows.is_empty() {
        rows.push(Row::new());
    }
    rows
}

/// The rest of a void form: the reason, the typed text, and the key that closes it.
fn dismissed_footer(form: &Form, why: &str, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let text = wording::not_asked_any_more(pen.look.glyph(Glyph::Warning), why);
    let mut rows: Vec<Row> =
        wrap(&text, width, 3).iter().map(|line| Row::of(ThemeRole::Problem, line)).collect();
    if !form.reason.text().is_empty() {
        let typed = Row::new().cell(ThemeRole::Muted, "Typed", 9);
        rows.push(typed.and(field(pen, &form.reason, width.saturating_sub(9), false)));
    }
    rows.push(Row::of(ThemeRole::Key, "Esc").with(ThemeRole::Text, wording::ONLY_THIS_KEY_CLOSES));
    rows
}

fn footer_of(model: &ConsoleModel, form: &Form, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    match &form.signing {
        Some(signing) => super::approval_screen::signing_rows(
            model,
            signing,
            (" Sign  ", wording::BACK_TO_THE_FORM),
            pen,
            width,
        ),
        None => footer(model, form, pen, width),
    }
}

fn footer(model: &ConsoleModel, form: &Form, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    if let Some(void) = &form.void {
        return dismissed_footer(form, &void.why, pen, width);
    }
    let mut rows = Vec::new();
    let label = |text: &str| Row::new().cell(ThemeRole::Muted, text, 9);
    let focuses = form.focuses();
    if focuses.contains(&FormFocus::Minutes) {
        let has = form.focus == FormFocus::Minutes;
        let hint = format!("  1 to {SHELVE_MINUTES_MAX}");
        rows.push(label("Minutes").and(field(pen, &form.minutes, 8, has)).with(ThemeRole::Muted, &hint));
    }
    if focuses.contains(&FormFocus::Reason) {
        let has = form.focus == FormFocus::Reason;
        let name = if form.intent == Intent::Note { "Note" } else { "Reason" };
        rows.push(label(name).and(field(pen, &form.reason, width.saturating_sub(9), has)));
    }
    if let Some(problem) = &form.problem {
        let text = format!("{} {problem}", pen.look.glyph(Glyph::Warning));
        rows.extend(wrap(&text, width, 3).iter().map(|line| Row::of(ThemeRole::Problem, line)));
    }
    let guarded = form.is_guarded(model.now_ms);
    let buttons = Row::new()
        .and(button(pen, "Cancel", form.focus == FormFocus::Cancel))
        .with(ThemeRole::Text, "  ")
        .and(confirming_button(pen, form, guarded));
    rows.push(buttons);
    if form.is_one_key() {
        let key = if guarded { Row::of(ThemeRole::KeyOff, "[y]") } else { Row::of(ThemeRole::Key, "y") };
        let does = if guarded { wording::DOES_IT_IN_A_MOMENT } else { " does it" };
        let row = key
            .with(ThemeRole::Text, does)
            .with(ThemeRole::Text, if pen.look.ascii() { " | " } else { " · " })
            .with(ThemeRole::Key, "n")
            .with(ThemeRole::Text, " or ")
            .with(ThemeRole::Key, "Esc")
            .with(ThemeRole::Text, wording::LEAVES_AS_IT_IS);
        rows.push(row);
    }
    rows
}

/// The button that confirms a form. As long as the form is guarded, round brackets say that it does nothing yet.
fn confirming_button(pen: &Pen<'_>, form: &Form, guarded: bool) -> Row {
    let has_keys = form.focus == FormFocus::Confirm;
    if has_keys && guarded {
        let text = wording::in_a_moment(pen.look.glyph(Glyph::Here), form.intent.verb());
        return Row::of(ThemeRole::KeyOff, &text);
    }
    button(pen, form.intent.verb(), has_keys)
}

/// A button; the one that has the keys is marked by a sign as well as by its style.
#[must_use]
pub fn button(pen: &Pen<'_>, label: &str, has_keys: bool) -> Row {
    if has_keys {
        Row::of(ThemeRole::Selected, &format!("{}[{label}]", pen.look.glyph(Glyph::Here)))
    } else {
        Row::of(ThemeRole::Text, &format!("  {label} "))
    }
}
