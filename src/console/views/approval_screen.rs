//! An open approval prompt: the whole decision, the obstacles to an answer, and the keys.
//!
//! ```text
//! ── Approve place@1.1.0? ─────────────────────────── all 19 lines ─
//! Promote place@1.1.0 (9f3c) to active on arm-1, profile human?
//! Replaces place@1.0.0, which stays the rollback target
//! …
//! ▸[Hold]   short id ____ (type 9f3c)   reason ____
//! First: give a reason (tab), to promote: type the short id (tab)
//! Y Promote   N Reject   Enter or Esc Hold: decide later
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::form::button;
use super::hints::field;
use crate::action::Action;
use crate::approval_screen::{
    ApprovalFocus, ApprovalScreen, ClosingAnswer, DecisionObstacle, TextRow, VisibleRows,
};
use crate::formatters::seconds;
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::ConsoleModel;
use crate::secret::Signing;
use crate::widgets::pen::{Pen, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::approval::ApprovalDecision;

/// The most lines of one sentence below the decision.
const WRAPPED_MAX: usize = 5;

/// Draws it over all of `area`.
pub fn draw(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &mut Pen<'_>, area: Rect) {
    pen.clear(area);
    let (upper, lower, foot) = parts(model, prompt, pen, area);
    let visible = visible_rows(prompt, pen.look, upper);
    let title = format!("Decide on {}", prompt.seen.version);
    let inside = pen.pane(upper, &title, true, &extent(model, visible.first, visible.room, visible.count));
    let role = if prompt.stale.is_some() { ThemeRole::Muted } else { ThemeRole::Text };
    for (at, row) in (0..inside.height).zip(&visible.rows) {
        let is_title = visible.first == 0 && at == 0 && prompt.stale.is_none();
        pen.row(inside, at, &Row::of(if is_title { ThemeRole::Title } else { role }, &row.text));
    }
    pen.rows(lower, 0, &foot);
}

/// The rows of the decision that [`draw`] puts on the screen.
#[must_use]
pub fn on_screen(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, area: Rect) -> VisibleRows {
    let (upper, _, _) = parts(model, prompt, pen, area);
    visible_rows(prompt, pen.look, upper)
}

/// The areas of the text and the foot, and the rows of the foot.
fn parts(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, area: Rect) -> (Rect, Rect, Vec<Row>) {
    let foot = footer(model, prompt, pen, usize::from(area.width));
    let foot_height = u16::try_from(foot.len()).unwrap_or(u16::MAX).min(area.height.saturating_sub(2));
    let (upper, lower) = cut(area, area.height - foot_height);
    (upper, lower, foot)
}

fn visible_rows(prompt: &ApprovalScreen, look: &Look, area: Rect) -> VisibleRows {
    let (width, room) = (usize::from(area.width), usize::from(area.height.saturating_sub(1)));
    let mut rows = lines(prompt, width, room, if look.ascii() { " | " } else { " · " });
    let count = rows.len();
    let first = usize::from(prompt.scroll).min(count.saturating_sub(room));
    rows.drain(..first);
    rows.truncate(room);
    VisibleRows { width, first, room, count, rows }
}

/// All lines of the decision, wrapped; continuation lines are indented. If that exceeds `room` rows, short lines
/// share a row. Live, unsigned values come last, apart from them.
#[must_use]
pub fn lines(prompt: &ApprovalScreen, width: usize, room: usize, between: &str) -> Vec<TextRow> {
    // They are not part of the decision and need not be read.
    let none = (usize::MAX, usize::MAX);
    let live = hanging(&prompt.live.join(between), none, width);
    let mut rows = signed_lines(prompt, width, room.saturating_sub(live.len()), between);
    rows.extend(live);
    rows
}

fn signed_lines(prompt: &ApprovalScreen, width: usize, room: usize, between: &str) -> Vec<TextRow> {
    let text = prompt.text();
    let alone = text.iter().enumerate().map(|(at, line)| (line.clone(), (at, at + 1)));
    let wrapped: Vec<TextRow> =
        alone.clone().flat_map(|(line, lines)| hanging(&line, lines, width)).collect();
    if wrapped.len() <= room {
        return wrapped;
    }
    let mut packed: Vec<(String, (usize, usize))> = Vec::new();
    for (line, lines) in alone {
        match packed.last_mut() {
            Some((last, (_, to))) if last.width() + between.width() + line.width() <= width => {
                last.push_str(between);
                last.push_str(&line);
                *to = lines.1;
            }
            _ => packed.push((line, lines)),
        }
    }
    packed.into_iter().flat_map(|(line, lines)| hanging(&line, lines, width)).collect()
}

fn hanging(line: &str, lines: (usize, usize), width: usize) -> Vec<TextRow> {
    let options = textwrap::Options::new(width.max(4)).subsequent_indent("  ");
    let rows = textwrap::wrap(line, options);
    let of = rows.len();
    let row =
        |(at, text): (usize, std::borrow::Cow<'_, str>)| TextRow { text: text.into_owned(), lines, at, of };
    rows.into_iter().enumerate().map(row).collect()
}

/// The visible part of the text, in words.
fn extent(model: &ConsoleModel, first: usize, room: usize, count: usize) -> String {
    if count <= room {
        return "all of it".to_owned();
    }
    let (down, up) = (model.keymap.key(Action::PageDown), model.keymap.key(Action::PageUp));
    let last = (first + room).min(count);
    let hidden = count - last;
    let more = if hidden > 0 { format!("{hidden} more below: {down}") } else { format!("end, back: {up}") };
    format!("lines {} to {last} of {count}, {more}", first + 1)
}

/// The other operators who have this request open; empty if there are none.
fn readers(model: &ConsoleModel, prompt: &ApprovalScreen) -> String {
    let here = model
        .engine_data
        .other_consoles()
        .filter(|one| one.sitting.reading.as_ref() == Some(&prompt.seen.version));
    let own = model.engine_data.own_account();
    let names: Vec<String> = here.map(|one| crate::formatters::console_label(one, own)).collect();
    match names.as_slice() {
        [] => String::new(),
        [one] => format!("{one} is reading this"),
        [one, two] => format!("{one} and {two} are reading this"),
        [one, two, more @ ..] => format!("{one}, {two} and {} more are reading this", more.len()),
    }
}

fn footer(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    if prompt.closed && prompt.signing.is_none() {
        let since = prompt
            .stale
            .as_ref()
            .map_or_else(String::new, |stale| format!(" since {}", seconds(stale.at_ms)));
        let why = prompt
            .answered
            .as_ref()
            .map_or_else(|| "nothing is left to decide here".to_owned(), ClosingAnswer::description);
        let text = format!("{} CLOSED{since}: {why}", pen.look.glyph(Glyph::Warning));
        rows.extend(wrapped(ThemeRole::Stale, &text, width));
        rows.extend(refused(prompt, width));
        let leaves = Row::of(ThemeRole::Key, "Enter").with(ThemeRole::Text, " or ");
        let back = model.keymap.key(Action::Back);
        rows.push(leaves.with(ThemeRole::Key, &back).with(ThemeRole::Text, " leaves it"));
        return rows;
    }
    if let Some(stale) = prompt.stale.as_ref().filter(|_| !prompt.closed) {
        let key = model.keymap.key(Action::Reread);
        let text = format!(
            "{} STALE: {} at {}; press {key} to read it again",
            pen.look.glyph(Glyph::Warning),
            stale.what,
            seconds(stale.at_ms)
        );
        rows.extend(wrapped(ThemeRole::Stale, &text, width));
    }
    let readers = readers(model, prompt);
    if !readers.is_empty() {
        rows.extend(wrapped(ThemeRole::Muted, &readers, width));
    }
    let (unread, all) = (prompt.unread(), prompt.text().len());
    if unread > 0 && prompt.stale.is_none() {
        let key = model.keymap.key(Action::PageDown);
        let text = format!(
            "{} {unread} of {all} lines unread: {key} shows the next",
            pen.look.glyph(Glyph::Warning)
        );
        rows.push(Row::of(ThemeRole::Warning, &text));
    }
    if let Some(signing) = &prompt.signing {
        let signs = match signing.what {
            ApprovalDecision::Approve => " Sign and promote  ",
            ApprovalDecision::Reject => " Sign and reject  ",
        };
        rows.extend(signing_rows(model, signing, (signs, " back to the question"), pen, width));
        return rows;
    }
    rows.push(fields(prompt, pen, width));
    rows.extend(missing(model, prompt, width));
    let key = |action| model.keymap.key(action);
    let approve = !blocks(model, prompt, ApprovalDecision::Approve).is_empty();
    // Without a reason the key that rejects leads to its field.
    let reject = blocks(model, prompt, ApprovalDecision::Reject)
        .iter()
        .any(|block| *block != DecisionObstacle::Reason);
    let role = |off: bool| if off { ThemeRole::KeyOff } else { ThemeRole::Key };
    let named = |off: bool, key: String, label: &str| {
        if off {
            Row::of(role(off), &format!("[{key} {label}]  "))
        } else {
            Row::of(role(off), &key).with(ThemeRole::Text, &format!(" {label}  "))
        }
    };
    rows.push(
        named(approve, key(Action::Approve), "Promote")
            .and(named(reject, key(Action::Reject), "Reject"))
            .with(ThemeRole::Key, "Enter")
            .with(ThemeRole::Text, " or ")
            .with(ThemeRole::Key, &key(Action::Back))
            .with(ThemeRole::Text, if prompt.seen.granted { " leaves it so" } else { " Hold: decide later" }),
    );
    rows
}

/// The field for the passphrase, which shows only its length, and its keys.
pub(super) fn signing_rows<W>(
    model: &ConsoleModel,
    signing: &Signing<W>,
    (signs, back): (&str, &str),
    pen: &Pen<'_>,
    width: usize,
) -> Vec<Row> {
    let who = model.session.operator.as_ref().map_or("no operator", |who| who.name.as_str());
    let head = format!("Passphrase of {who}: ");
    let room = width.saturating_sub(head.width() + 1);
    let mut row =
        Row::of(ThemeRole::Focus, &head).with(ThemeRole::Text, &"*".repeat(signing.secret.len().min(room)));
    if signing.request_id.is_some() {
        row = Row::of(ThemeRole::Muted, "the passphrase is being checked");
    }
    let mut rows = vec![row];
    if let Some(problem) = &signing.problem {
        let text = format!("{} {problem}", pen.look.glyph(Glyph::Warning));
        rows.extend(wrapped(ThemeRole::Problem, &text, width));
    }
    rows.push(
        Row::of(ThemeRole::Key, "Enter")
            .with(ThemeRole::Text, signs)
            .with(ThemeRole::Key, "Esc")
            .with(ThemeRole::Text, back),
    );
    rows
}

/// Hold and the fields, with the one that has the keys marked.
fn fields(prompt: &ApprovalScreen, pen: &Pen<'_>, width: usize) -> Row {
    let mut row = button(pen, "Hold", prompt.focus == ApprovalFocus::Hold);
    if prompt.focuses().contains(&ApprovalFocus::ShortId) {
        let has = prompt.focus == ApprovalFocus::ShortId;
        row.push(if has { ThemeRole::Focus } else { ThemeRole::Muted }, "  short id ");
        let wanted = format!(" ({})", prompt.wanted_id());
        row = row.and(field(pen, &prompt.short_id, 6, has)).with(ThemeRole::Muted, &wanted);
    }
    let has = prompt.focus == ApprovalFocus::Reason;
    row.push(if has { ThemeRole::Focus } else { ThemeRole::Muted }, "  reason ");
    let left = width.saturating_sub(row.width());
    row.and(field(pen, &prompt.reason, left, has))
}

fn blocks(model: &ConsoleModel, prompt: &ApprovalScreen, answer: ApprovalDecision) -> Vec<DecisionObstacle> {
    prompt.blocks(answer, model.session.operator.as_ref(), model.settings.read_only, model.now_ms)
}

/// The obstacles to each answer, in words; a shared obstacle appears once.
fn missing(model: &ConsoleModel, prompt: &ApprovalScreen, width: usize) -> Vec<Row> {
    let mut approve = blocks(model, prompt, ApprovalDecision::Approve);
    approve.retain(|block| *block != DecisionObstacle::Unread);
    let reject = blocks(model, prompt, ApprovalDecision::Reject);
    // The number of unread lines has its own line.
    let hints =
        |blocks: &[DecisionObstacle]| blocks.iter().map(|block| block.hint()).collect::<Vec<_>>().join("; ");
    let both: Vec<DecisionObstacle> =
        approve.iter().copied().filter(|block| reject.contains(block)).collect();
    let rest = |all: &[DecisionObstacle]| {
        all.iter().copied().filter(|block| !both.contains(block)).collect::<Vec<_>>()
    };
    let groups = [("First", both.clone()), ("to promote", rest(&approve)), ("to reject", rest(&reject))];
    let parts: Vec<String> = groups
        .iter()
        .filter(|(_, blocks)| !blocks.is_empty())
        .map(|(head, blocks)| format!("{head}: {}", hints(blocks)))
        .collect();
    let text = wrap(&parts.join(", "), width, 4);
    let mut rows: Vec<Row> = text.iter().map(|line| Row::of(ThemeRole::Warning, line)).collect();
    rows.extend(refused(prompt, width));
    rows
}

/// Why the last key did nothing.
fn refused(prompt: &ApprovalScreen, width: usize) -> Vec<Row> {
    let text = prompt.refused.map(|block| format!("That key did nothing: {}", block.hint()));
    text.map_or_else(Vec::new, |text| wrapped(ThemeRole::Problem, &text, width))
}

fn wrapped(role: ThemeRole, text: &str, width: usize) -> Vec<Row> {
    wrap(text, width, WRAPPED_MAX).iter().map(|line| Row::of(role, line)).collect()
}
