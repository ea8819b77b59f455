//! An open approval prompt: the whole decision, live values apart from it, the obstacles to an answer, and the keys.
//!
//! ```text
//! ── Decide on place@1.1.0 ────────────────────────── all 19 lines ─
//! place@1.1.0 FAILS 1 of 4 checks; the signatures waive it
//! Promote place@1.1.0 (9f3c) to active on arm-1, profile human?
//! …
//! ── LIVE, NOT SIGNED, as of Tue 17 Nov 08:12:41 UTC ───────────────
//! Deadline: 08:41:43 UTC, 29 min left · Open alarms: 1 …
//! ▸[Later]   short id ____ (type 9f3c)   reason ____
//! to sign: type the short id (tab), then: give a reason (tab)
//! Y Sign   N Reject   Enter or Esc Later
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::form::button;
use super::hints::field;
use crate::action::Action;
use crate::approval_screen::{
    ApprovalFocus, ApprovalScreen, ClosingAnswer, DecisionObstacle, TextRow, VisibleRows,
};
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::ConsoleModel;
use crate::secret::Signing;
use crate::widgets::pen::{Pen, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_wording::approval::LineMark;
use holdpoint_wording::console::approval_screen as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::program::identity::passphrase_prompt;

/// The most lines of one sentence below the decision.
const WRAPPED_MAX: usize = 5;

/// Body rows that the text and the foot have before the live values get rows of their own.
const TEXT_ROWS_MIN: u16 = 12;

/// Draws it over all of `area`.
pub fn draw(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &mut Pen<'_>, area: Rect) {
    pen.clear(area);
    let PromptParts { text, live, live_rows, foot, foot_rows } = parts(model, prompt, pen, area);
    let visible = visible_rows(prompt, text, live.is_empty(), between(pen.look));
    let title = format!("Decide on {}", prompt.seen.version);
    let inside = pen.pane(text, &title, true, &extent(model, visible.first, visible.room, visible.count));
    for (at, row) in (0..inside.height).zip(&visible.rows) {
        let role =
            if prompt.stale.is_some() { ThemeRole::Muted } else { line_role(prompt.mark(row.lines.0)) };
        pen.row(inside, at, &Row::of(role, &row.text));
    }
    if !live.is_empty() {
        let heading = prompt.live.first().map_or("", String::as_str);
        let inside = pen.pane(live, heading, false, "");
        pen.rows(inside, 0, &live_rows);
    }
    pen.rows(foot, 0, &foot_rows);
}

const fn line_role(mark: LineMark) -> ThemeRole {
    match mark {
        LineMark::Plain => ThemeRole::Text,
        LineMark::Question => ThemeRole::Title,
        LineMark::Good => ThemeRole::Good,
        LineMark::Failure => ThemeRole::Bad,
        LineMark::Caution => ThemeRole::Warning,
    }
}

/// The rows of the decision that [`draw`] puts on the screen.
#[must_use]
pub fn on_screen(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, area: Rect) -> VisibleRows {
    let parts = parts(model, prompt, pen, area);
    visible_rows(prompt, parts.text, parts.live.is_empty(), between(pen.look))
}

/// The areas of a prompt, and the rows below its text.
struct PromptParts {
    text: Rect,
    /// Empty in a short window, where the live values follow the text.
    live: Rect,
    live_rows: Vec<Row>,
    foot: Rect,
    foot_rows: Vec<Row>,
}

fn parts(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, area: Rect) -> PromptParts {
    let width = usize::from(area.width);
    let foot_rows = footer(model, prompt, pen, width);
    let foot_height = u16::try_from(foot_rows.len()).unwrap_or(u16::MAX).min(area.height.saturating_sub(2));
    let (upper, foot) = cut(area, area.height - foot_height);
    let room = (area.height.saturating_sub(TEXT_ROWS_MIN) / 2).min(upper.height.saturating_sub(2));
    // One row is the heading's; without a value it would say nothing.
    let live_rows = live_values(prompt, width, usize::from(room.saturating_sub(1)), between(pen.look));
    let values = u16::try_from(live_rows.len()).unwrap_or(u16::MAX);
    let live_height = if values == 0 { 0 } else { values.saturating_add(1) };
    let (text, live) = cut(upper, upper.height - live_height);
    PromptParts { text, live, live_rows, foot, foot_rows }
}

const fn between(look: &Look) -> &'static str {
    if look.ascii() { " | " } else { " · " }
}

/// The live values without their heading, wrapped; an ellipsis ends values that have no room.
fn live_values(prompt: &ApprovalScreen, width: usize, rows_max: usize, between: &str) -> Vec<Row> {
    let values = prompt.live.get(1..).unwrap_or_default().join(between);
    let mut rows = hanging(&values, LIVE, width);
    if rows.len() > rows_max {
        rows.truncate(rows_max);
        if let Some(last) = rows.last_mut() {
            last.text = super::short(&format!("{}…", last.text), width);
        }
    }
    rows.iter().map(|row| Row::of(ThemeRole::Text, &row.text)).collect()
}

/// In place of the numbers of lines: live values are no part of the decision and need not be read.
const LIVE: (usize, usize) = (usize::MAX, usize::MAX);

fn visible_rows(prompt: &ApprovalScreen, area: Rect, with_live: bool, between: &str) -> VisibleRows {
    let (width, room) = (usize::from(area.width), usize::from(area.height.saturating_sub(1)));
    let mut rows = lines(prompt, width);
    if with_live {
        rows.extend(hanging(&prompt.live.join(between), LIVE, width));
    }
    let count = rows.len();
    let first = usize::from(prompt.scroll).min(count.saturating_sub(room));
    rows.drain(..first);
    rows.truncate(room);
    VisibleRows { width, first, room, count, rows }
}

/// All lines of the decision, wrapped, each in rows of its own; continuation rows are indented.
fn lines(prompt: &ApprovalScreen, width: usize) -> Vec<TextRow> {
    let text = prompt.text();
    text.iter().enumerate().flat_map(|(at, line)| hanging(line, (at, at + 1), width)).collect()
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
        return wording::ALL_OF_IT.to_owned();
    }
    let (down, up) = (model.keymap.key(Action::PageDown), model.keymap.key(Action::PageUp));
    let last = (first + room).min(count);
    let hidden = count - last;
    let more = if hidden > 0 { shared::more_below(hidden, &down) } else { wording::end_and_back(&up) };
    wording::lines_shown(first + 1, last, count, &more)
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
        [one] => wording::one_reads(one),
        [one, two] => wording::two_read(one, two),
        [one, two, more @ ..] => wording::several_read(one, two, more.len()),
    }
}

fn footer(model: &ConsoleModel, prompt: &ApprovalScreen, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    if prompt.closed && prompt.signing.is_none() {
        let since = prompt
            .stale
            .as_ref()
            .map_or_else(String::new, |stale| format!(" since {}", model.moment(stale.at_ms)));
        let why = prompt
            .answered
            .as_ref()
            .map_or_else(|| wording::NOTHING_LEFT_TO_DECIDE.to_owned(), ClosingAnswer::description);
        let text = format!("{} CLOSED{since}: {why}", pen.look.glyph(Glyph::Warning));
        rows.extend(wrapped(ThemeRole::Stale, &text, width));
        rows.extend(refused(prompt, width));
        let leaves = Row::of(ThemeRole::Key, "Enter").with(ThemeRole::Text, " or ");
        let back = model.keymap.key(Action::Back);
        rows.push(leaves.with(ThemeRole::Key, &back).with(ThemeRole::Text, wording::LEAVES_IT));
        return rows;
    }
    if let Some(stale) = prompt.stale.as_ref().filter(|_| !prompt.closed) {
        let key = model.keymap.key(Action::Reread);
        let text = wording::press_to_read_again(
            pen.look.glyph(Glyph::Warning),
            stale.what,
            &model.moment(stale.at_ms),
            &key,
        );
        rows.extend(wrapped(ThemeRole::Stale, &text, width));
    }
    let readers = readers(model, prompt);
    if !readers.is_empty() {
        rows.extend(wrapped(ThemeRole::Muted, &readers, width));
    }
    if prompt.unread() > 0 && prompt.stale.is_none() {
        // In rows, as the heading counts what is below.
        let all = lines(prompt, width);
        let (unread, all) = (prompt.unread_rows(width, &all), all.len());
        let key = model.keymap.key(Action::PageDown);
        let text = wording::lines_unread(pen.look.glyph(Glyph::Warning), unread, all, &key);
        rows.push(Row::of(ThemeRole::Warning, &text));
    }
    if let Some(signing) = &prompt.signing {
        let signs = match signing.what {
            ApprovalDecision::Approve => " Sign  ",
            ApprovalDecision::Reject => wording::SIGN_AND_REJECT,
        };
        rows.extend(signing_rows(model, signing, (signs, wording::BACK_TO_THE_QUESTION), pen, width));
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
        named(approve, key(Action::Approve), "Sign")
            .and(named(reject, key(Action::Reject), "Reject"))
            .with(ThemeRole::Key, "Enter")
            .with(ThemeRole::Text, " or ")
            .with(ThemeRole::Key, &key(Action::Back))
            .with(ThemeRole::Text, if prompt.seen.granted { wording::LEAVES_IT_SO } else { " Later" }),
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
    let who = model.session.operator.as_ref().map_or(wording::NO_OPERATOR, |who| who.name.as_str());
    let head = passphrase_prompt(who);
    let room = width.saturating_sub(head.width() + 1);
    let mut row =
        Row::of(ThemeRole::Focus, &head).with(ThemeRole::Text, &"*".repeat(signing.secret.len().min(room)));
    let pending = signing.request_id.as_ref().map(|id| model.requests.pending.get(id));
    let is_sent = pending.map(|pending| pending.is_some_and(|pending| pending.is_sent));
    if let Some(is_sent) = is_sent {
        let text = if is_sent { wording::SIGNED_AND_SENT } else { wording::PASSPHRASE_CHECKED };
        row = Row::of(ThemeRole::Muted, text);
    }
    let mut rows = vec![row];
    if let Some(problem) = &signing.problem {
        let text = format!("{} {problem}", pen.look.glyph(Glyph::Warning));
        rows.extend(wrapped(ThemeRole::Problem, &text, width));
    }
    rows.push(match is_sent {
        None => Row::of(ThemeRole::Key, "Enter")
            .with(ThemeRole::Text, signs)
            .with(ThemeRole::Key, "Esc")
            .with(ThemeRole::Text, back),
        Some(false) => Row::of(ThemeRole::Key, "Esc").with(ThemeRole::Text, wording::TAKES_IT_BACK),
        Some(true) => Row::new(),
    });
    rows
}

/// Later and the fields, with the one that has the keys marked.
fn fields(prompt: &ApprovalScreen, pen: &Pen<'_>, width: usize) -> Row {
    let mut row = button(pen, "Later", prompt.focus == ApprovalFocus::Later);
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

/// What to do about an obstacle, in the field that has the keys, or on the way to it.
const fn hint(block: DecisionObstacle, focus: ApprovalFocus) -> &'static str {
    match (block, focus) {
        (DecisionObstacle::ShortId, ApprovalFocus::ShortId) => wording::SHORT_ID_HERE,
        (DecisionObstacle::Reason, ApprovalFocus::Reason) => wording::REASON_HERE,
        _ => block.hint(),
    }
}

/// The obstacles to each answer, in words and in the order of the steps; a shared obstacle appears once.
fn missing(model: &ConsoleModel, prompt: &ApprovalScreen, width: usize) -> Vec<Row> {
    let mut approve = blocks(model, prompt, ApprovalDecision::Approve);
    // The number of unread lines has its own line.
    approve.retain(|block| *block != DecisionObstacle::Unread);
    let reject = blocks(model, prompt, ApprovalDecision::Reject);
    let hints = |blocks: &[DecisionObstacle]| {
        blocks.iter().map(|block| hint(*block, prompt.focus)).collect::<Vec<_>>().join("; ")
    };
    let (both, of_approval): (Vec<_>, Vec<_>) =
        approve.iter().copied().partition(|block| reject.contains(block));
    let of_rejection: Vec<_> = reject.iter().copied().filter(|block| !both.contains(block)).collect();
    // The fields come last: the reason behind the short id, and leaving them behind both.
    let (last, first): (Vec<_>, Vec<_>) = both
        .iter()
        .copied()
        .partition(|block| matches!(block, DecisionObstacle::Reason | DecisionObstacle::Typing));
    let begins = [&first, &of_approval, &of_rejection].iter().all(|blocks| blocks.is_empty());
    let groups = [
        (wording::FIRST, first),
        (wording::TO_SIGN, of_approval),
        (wording::TO_REJECT, of_rejection),
        (if begins { wording::FIRST } else { wording::THEN }, last),
    ];
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

/// Why the last key did nothing, or led to the reason.
fn refused(prompt: &ApprovalScreen, width: usize) -> Vec<Row> {
    let text = prompt.refused.map(|block| match (block, prompt.focus) {
        (DecisionObstacle::Reason, ApprovalFocus::Reason) => wording::REASON_BEFORE_KEY.to_owned(),
        _ => wording::key_did_nothing(block.hint()),
    });
    text.map_or_else(Vec::new, |text| wrapped(ThemeRole::Problem, &text, width))
}

fn wrapped(role: ThemeRole, text: &str, width: usize) -> Vec<Row> {
    wrap(text, width, WRAPPED_MAX).iter().map(|line| Row::of(role, line)).collect()
}
