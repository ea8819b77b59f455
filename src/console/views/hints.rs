//! The last line: the keys that apply here now, the answer to the last one, or the text being typed.
//!
//! ```text
//! X stop  enter open  x abort  p hold  a approvals  ? help  q quit
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::approval_screen::{ApprovalFocus, ApprovalScreen, DecisionObstacle};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, ConsoleNotice, Overlay, Typing};
use crate::update::availability::ActionAvailability;
use crate::widgets::pen::{Fit, Pen, below};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_wording::console::hints as wording;

/// The most lines of an answer.
const NOTICE_ROWS: u16 = 8;

/// The most lines of an unconfirmed stop.
const OVERDUE_ROWS: usize = 4;

/// The height of the foot of the screen: an answer is shown in full, up to a third of the screen, or half of a small
/// one.
#[must_use]
pub fn height(model: &ConsoleModel, screen: Rect) -> u16 {
    let message = model.notice.as_ref().filter(|_| model.input.typing.is_none());
    let share = if screen.height < 16 { 2 } else { 3 };
    let rows_max = (screen.height / share).clamp(1, NOTICE_ROWS);
    let rows = message.map_or(1, |notice| {
        let lines = notice_lines(model, notice, usize::from(screen.width), usize::from(rows_max));
        u16::try_from(lines.len()).unwrap_or(rows_max).max(1)
    });
    // Warnings come before all other messages here.
    let fit = Fit::of(screen.width, screen.height);
    let overdue = u16::try_from(warnings(model, screen.width, fit).len()).unwrap_or(rows_max);
    if overdue == 0 { rows } else { (rows + overdue).min((screen.height / 2).max(1)) }
}

/// The unconfirmed stop, the keys that do not arrive and the lost engine, in lines; and whether each begins a message.
fn warnings(model: &ConsoleModel, width: u16, fit: Fit) -> Vec<(bool, String)> {
    let room = usize::from(width).saturating_sub(2);
    // A tiny window has no room beside the keys, and no key is promised that does not arrive.
    let next_engine = model.next_engine().filter(|_| fit > Fit::Tiny && !model.line_mode);
    let texts = [model.stop_overdue(), model.dead_keys(), next_engine];
    let lines =
        texts.iter().flatten().flat_map(|text| wrap(text, room, OVERDUE_ROWS).into_iter().enumerate());
    lines.map(|(at, line)| (at == 0, line)).collect()
}

/// An answer in lines that leave room for the key that stops.
fn notice_lines(model: &ConsoleModel, notice: &ConsoleNotice, width: usize, rows_max: usize) -> Vec<String> {
    let room = width.saturating_sub(stop(model).width() + 3);
    wrap(&notice.text, room, rows_max)
}

pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let lead = |is_first: bool| if is_first { pen.look.glyph(Glyph::Warning) } else { " " };
    let rows: Vec<Row> = warnings(model, area.width, pen.fit)
        .iter()
        .map(|(is_first, line)| Row::of(ThemeRole::Problem, &format!("{} {line}", lead(*is_first))))
        .collect();
    let taken = pen.rows(area, 0, &rows);
    let area = below(area, taken);
    // No line promises a key that does not arrive.
    if area.height == 0 || model.line_mode {
        return;
    }
    let width = usize::from(area.width);
    // The key that stops the arm always stands beside the other hints.
    let stop = stop(model);
    let room = width.saturating_sub(stop.width() + 1);
    let beside = |row: Row| row.to_column(width.saturating_sub(stop.width())).and(stop.clone());
    let row = if let Some(typing) = &model.input.typing {
        beside(typed(typing, pen, room))
    } else if let Some(notice) = &model.notice {
        let (role, glyph) =
            if notice.bad { (ThemeRole::Problem, Glyph::Warning) } else { (ThemeRole::Notice, Glyph::Good) };
        let lines = notice_lines(model, notice, width, usize::from(area.height).max(1));
        let (last, before) =
            lines.split_last().map_or(("", &[][..]), |(last, before)| (last.as_str(), before));
        let lead = |at: usize| if at == 0 { pen.look.glyph(glyph) } else { " " };
        let rows: Vec<Row> = before
            .iter()
            .enumerate()
            .map(|(at, line)| Row::of(role, &format!("{} {line}", lead(at))))
            .collect();
        let row = beside(Row::of(role, &format!("{} {last}", lead(before.len()))));
        pen.rows(area, 0, &rows);
        pen.row(area, u16::try_from(rows.len()).unwrap_or(u16::MAX), &row);
        return;
    } else if let Some(own) = own_keys(model) {
        let gap = stop.clone().with(ThemeRole::Text, "  ");
        own.iter().fold(gap, |row, (key, label)| {
            let next = Row::of(ThemeRole::Key, key).with(ThemeRole::Text, &format!(" {label}  "));
            if row.width() + next.width() <= width { row.and(next) } else { row }
        })
    } else {
        stop.clone().with(ThemeRole::Text, "  ").and(keys(
            model,
            &actions(model),
            width.saturating_sub(stop.width() + 2),
        ))
    };
    pen.row(area, 0, &row);
}

/// The key that stops the arm here and now: while text is typed, one that is not text.
#[must_use]
pub fn stop(model: &ConsoleModel) -> Row {
    let types = model.input.typing.is_some() || model.input.overlay.as_ref().is_some_and(Overlay::takes_text);
    let keys = model.keymap.keys(Action::Stop);
    let is_text = |key: &&String| key.chars().count() == 1;
    let key = if types { keys.iter().find(|key| !is_text(key)) } else { keys.first() };
    key.map_or_else(Row::new, |key| Row::of(ThemeRole::Key, key).with(ThemeRole::Text, " stop"))
}

/// The line being typed with its cursor; of a long one, the part around the cursor.
fn typed(typing: &Typing, pen: &Pen<'_>, width: usize) -> Row {
    let (sign, line) = match typing {
        Typing::Command(line) => (":", line),
        Typing::Filter(line) | Typing::Find(line) => ("/", line),
    };
    Row::of(ThemeRole::Key, sign).and(field(pen, line, width.saturating_sub(1), true))
}

/// A field's text; with its cursor if it has the keys.
#[must_use]
pub fn field(pen: &Pen<'_>, line: &crate::line::EditLine, width: usize, has_keys: bool) -> Row {
    let (text, cursor) = (line.text(), line.cursor());
    if !has_keys {
        return Row::of(ThemeRole::Text, &super::short(text, width));
    }
    // One column is for the cursor; a long text is cut at the front.
    let before: String = text.chars().take(cursor).collect();
    let after: String = text.chars().skip(cursor).collect();
    let room = width.saturating_sub(1);
    let skipped = before.chars().count().saturating_sub(room);
    let before: String = before.chars().skip(skipped).collect();
    Row::of(ThemeRole::Field, &before)
        .with(ThemeRole::Key, pen.look.glyph(Glyph::Cursor))
        .with(ThemeRole::Field, &after)
}

/// Keys that apply only in the dialog over the view; absent if there are none.
fn own_keys(model: &ConsoleModel) -> Option<Vec<(&'static str, &'static str)>> {
    match &model.input.overlay {
        Some(Overlay::Why(screen)) => {
            let why = model.subject_detail().and_then(|detail| detail.why.get(screen.at));
            let shows = why.is_some_and(|why| why.film.is_some());
            let first = shows.then_some(("w", "worst episode"));
            let rest = [("l", "next check"), ("h", "previous"), ("j", "down"), ("esc", "back")];
            Some(first.into_iter().chain(rest).collect())
        }
        Some(Overlay::Film(watched)) => {
            let run = if watched.player.runs() { "pause" } else { "play" };
            Some(vec![
                ("space", run),
                ("m", wording::MOMENT_IT_FAILS),
                ("esc", "back"),
                (". ,", "step"),
                ("[ ]", "events"),
                ("h l", "1 s"),
                ("+ -", "speed"),
                ("n b", "next, before"),
            ])
        }
        // The replay names its keys in its own last line.
        Some(Overlay::Replay(_)) => Some(Vec::new()),
        Some(
            Overlay::Palette(_)
            | Overlay::Approval(_)
            | Overlay::Form(_)
            | Overlay::KeyLog(_)
            | Overlay::Event(_),
        )
        | None => None,
    }
}

/// The actions that apply here, the most important first.
#[must_use]
pub fn actions(model: &ConsoleModel) -> Vec<Action> {
    use crate::action::Action as A;
    let here: &[Action] = match (&model.input.overlay, model.view_state.view) {
        (Some(Overlay::Palette(_)), _) => &[A::Open, A::Up, A::Down, A::Back],
        (Some(Overlay::Approval(prompt)), _) => return in_prompt(model, prompt),
        // The typed text is a passphrase, and its own keys stand beside it.
        (Some(Overlay::Form(form)), _) if form.signing.is_some() => &[],
        (Some(Overlay::Form(form)), _) if form.is_one_key() || form.void.is_some() => &[A::Back],
        (Some(Overlay::Form(form)), _) if form.types() => &[A::NextPane, A::Back],
        (Some(Overlay::Form(_)), _) => &[A::NextPane, A::Open, A::Back],
        (Some(Overlay::Why(_) | Overlay::Film(_) | Overlay::Replay(_)), _) => &[A::Back],
        (Some(Overlay::KeyLog(_)), _) => &[A::Up, A::Down, A::Back],
        (Some(Overlay::Event(_)), _) => &[A::Up, A::Down, A::Copy, A::Back],
        (None, view) => view.behavior().hints(model),
    };
    if model.bare_absence().is_some() && model.input.overlay.is_none() {
        return vec![A::CommandLine, A::Help, A::Quit];
    }
    if model.input.overlay.is_some() {
        return here.to_vec();
    }
    // A key that would be refused now is not a hint.
    let possible = ActionAvailability::of(model);
    // Urgent items come before items that can be marked.
    let mark = model.view_state.lists_versions().then_some(A::Mark);
    let rest = [A::JumpToAlarm].into_iter().chain(mark).chain([A::CommandLine, A::Help, A::Quit]);
    let all = here.iter().copied().chain(rest);
    all.filter(|action| possible.is_offered(*action)).collect()
}

/// The hints inside a prompt: a key with an obstacle is not a hint.
fn in_prompt(model: &ConsoleModel, prompt: &ApprovalScreen) -> Vec<Action> {
    use crate::action::Action as A;
    let more = prompt.has_more().then_some(A::PageDown);
    let all = if prompt.signing.is_some() {
        // The typed text is a passphrase, and its own keys stand beside it.
        return Vec::new();
    } else if prompt.closed {
        vec![more, Some(A::Back)]
    } else if prompt.focus != ApprovalFocus::Later {
        vec![Some(A::NextPane), more, Some(A::Back)]
    } else if prompt.stale.is_some() {
        vec![Some(A::Reread), more, Some(A::Back)]
    } else {
        // Read-only is shown beside the key; the key that rejects leads to the reason.
        let counts = |answer, but: &[DecisionObstacle]| {
            let who = model.session.operator.as_ref();
            let blocks = prompt.blocks(answer, who, model.settings.read_only, model.now_ms);
            blocks.iter().all(|block| *block == DecisionObstacle::ReadOnly || but.contains(block))
        };
        let approve = counts(ApprovalDecision::Approve, &[]).then_some(A::Approve);
        let reject = counts(ApprovalDecision::Reject, &[DecisionObstacle::Reason]).then_some(A::Reject);
        vec![approve, reject, Some(A::NextPane), more, Some(A::Back)]
    };
    all.into_iter().flatten().collect()
}

fn keys(model: &ConsoleModel, actions: &[Action], width: usize) -> Row {
    // Help and the key that leaves stand in every hint line.
    let last: Vec<Action> =
        actions.iter().copied().filter(|action| matches!(action, Action::Help | Action::Quit)).collect();
    let tail = last.iter().fold(Row::new(), |row, action| row.and(hint(model, *action)));
    let mut row = Row::new();
    for action in actions.iter().filter(|action| !last.contains(action)) {
        let next = hint(model, *action);
        if row.width() + next.width() + tail.width() <= width {
            row = row.and(next);
        }
    }
    let off = actions.iter().any(|action| action.changes_something());
    let why = Row::of(ThemeRole::KeyOff, wording::OFF_READ_ONLY);
    let row = row.and(tail);
    if model.settings.read_only && off && row.width() + why.width() <= width { row.and(why) } else { row }
}

/// One key and its action, with the gap behind it; a disabled key is in brackets.
fn hint(model: &ConsoleModel, action: Action) -> Row {
    let key = model.keymap.key(action);
    if key.is_empty() {
        return Row::new();
    }
    let text = label(model, action);
    if model.settings.read_only && action.changes_something() {
        return Row::of(ThemeRole::KeyOff, &format!("[{key} {text}]  "));
    }
    Row::of(ThemeRole::Key, &key).with(ThemeRole::Text, &format!(" {text}  "))
}

/// The word for an action in a hint.
fn label(model: &ConsoleModel, action: Action) -> String {
    let own = model.view_state.view.behavior().hint_label(model, action);
    match (action, &model.input.overlay, own) {
        (Action::NextPane, Some(_), _) => "next field",
        (Action::Open, Some(Overlay::Palette(_)), _) => wording::RUNS_IT,
        (Action::Open, Some(_), _) => wording::PRESSES_THE_BUTTON,
        (Action::Back, Some(Overlay::Approval(prompt)), _) if prompt.focus != ApprovalFocus::Later => {
            wording::LEAVE_THE_FIELD
        }
        (Action::Back, Some(Overlay::Approval(prompt)), _) if prompt.closed || prompt.seen.granted => "close",
        (Action::Back, Some(Overlay::Approval(_)), _) => wording::DECIDE_LATER,
        (Action::Back, Some(_), _) => "close",
        (Action::PageDown, _, _) => "more",
        (Action::JumpToAlarm, _, _) => "alarm",
        (Action::CommandLine, _, _) => "command",
        (Action::OpenRecording, _, _) => "recording",
        (Action::ResetAlarm, _, _) => "reset",
        (Action::Go, _, _) => wording::START_THE_CELL,
        (Action::Freeze, _, _) if model.view_state.frozen.is_some() => wording::LET_RUN,
        (Action::Resume, _, _) => "resume",
        (Action::Quit, None, _) if model.absence().is_some() => "quit",
        (_, None, Some(own)) => own,
        (Action::Quit, _, _) => "back",
        (other, _, _) => return other.name().replace('-', " "),
    }
    .to_owned()
}
