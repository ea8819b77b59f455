//! The last line: the keys that do something here now, or the answer to the last one, or what is being typed.
//!
//! ```text
//! X stop  enter open  x abort  p hold  a approvals  ? help  q quit
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::look::{Glyph, ThemeRole};
use crate::model::{EngineLink, HISTORY_PANE, Model, Notice, Overlay, Typing, View};
use crate::prompt::{Focus, Obstacle, Prompt};
use crate::update::possible::Possible;
use crate::widgets::pen::{Pen, below};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::approval::Answer;

/// The most lines of an answer.
const NOTICE_ROWS: u16 = 8;

/// The most lines of a stop that is not confirmed.
const OVERDUE_ROWS: usize = 4;

/// How many lines stand at the foot of a screen: an answer is shown whole, whatever it takes of a third of the screen,
/// or of half of a small one.
#[must_use]
pub fn height(model: &Model, screen: Rect) -> u16 {
    let told = model.notice.as_ref().filter(|_| model.entry.typing.is_none());
    let share = if screen.height < 16 { 2 } else { 3 };
    let rows_max = (screen.height / share).clamp(1, NOTICE_ROWS);
    let rows = told.map_or(1, |notice| {
        let lines = notice_lines(model, notice, usize::from(screen.width), usize::from(rows_max));
        u16::try_from(lines.len()).unwrap_or(rows_max).max(1)
    });
    // A stop that is not confirmed comes before everything else that is said here.
    let overdue = u16::try_from(overdue(model, screen.width).len()).unwrap_or(rows_max);
    if overdue == 0 { rows } else { (rows + overdue).min((screen.height / 2).max(1)) }
}

/// The stop that nobody has confirmed, in lines; none while there is no such.
fn overdue(model: &Model, width: u16) -> Vec<String> {
    let room = usize::from(width).saturating_sub(2);
    model.stop_overdue().map_or_else(Vec::new, |text| wrap(&text, room, OVERDUE_ROWS))
}

/// An answer in lines that leave room for the key that stops; where even so many do not hold it, the last one says so.
fn notice_lines(model: &Model, notice: &Notice, width: usize, rows_max: usize) -> Vec<String> {
    let room = width.saturating_sub(stop(model).width() + 3);
    let mut lines = wrap(&notice.text, room, rows_max + 1);
    if lines.len() > rows_max {
        lines.truncate(rows_max);
        if let Some(last) = lines.last_mut() {
            *last = super::short(&format!("{last}{}", "…".repeat(room.max(1))), room);
        }
    }
    lines
}

pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let overdue = overdue(model, area.width);
    let lead = |at: usize| if at == 0 { pen.look.glyph(Glyph::Warning) } else { " " };
    let rows: Vec<Row> = overdue
        .iter()
        .enumerate()
        .map(|(at, line)| Row::of(ThemeRole::Problem, &format!("{} {line}", lead(at))))
        .collect();
    let taken = pen.rows(area, 0, &rows);
    let area = below(area, taken);
    if area.height == 0 {
        return;
    }
    let width = usize::from(area.width);
    // Whatever else is said here, how the arm is stopped stands beside it.
    let stop = stop(model);
    let room = width.saturating_sub(stop.width() + 1);
    let beside = |row: Row| row.to_column(width.saturating_sub(stop.width())).and(stop.clone());
    let row = if let Some(typing) = &model.entry.typing {
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
        own.iter().fold(gap, |row, (key, word)| {
            let next = Row::of(ThemeRole::Key, key).with(ThemeRole::Text, &format!(" {word}  "));
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

/// The key that stops the arm here and now: where text is typed, one that is no text.
#[must_use]
pub fn stop(model: &Model) -> Row {
    let types = model.entry.typing.is_some()
        || match &model.entry.overlay {
            Some(Overlay::Palette(_)) => true,
            Some(Overlay::Prompt(prompt)) => {
                prompt.focus != Focus::Hold || prompt.signing.is_some() || prompt.cut_off.is_some()
            }
            Some(Overlay::Form(form)) => {
                (form.void.is_some() && !form.is_one_key()) || form.types() || form.signing.is_some()
            }
            Some(Overlay::Why(_) | Overlay::Film(_)) | None => false,
        };
    let keys = model.keymap.keys(Action::Stop);
    let is_text = |key: &&String| key.chars().count() == 1;
    let key = if types { keys.iter().find(|key| !is_text(key)) } else { keys.first() };
    key.map_or_else(Row::new, |key| Row::of(ThemeRole::Key, key).with(ThemeRole::Text, " stop"))
}

/// The line being typed with its cursor; of a long one the part round the cursor.
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
    // One column is for the cursor; what does not fit before it is left off at the front.
    let before: String = text.chars().take(cursor).collect();
    let after: String = text.chars().skip(cursor).collect();
    let room = width.saturating_sub(1);
    let skipped = before.chars().count().saturating_sub(room);
    let before: String = before.chars().skip(skipped).collect();
    Row::of(ThemeRole::Field, &before)
        .with(ThemeRole::Key, pen.look.glyph(Glyph::Cursor))
        .with(ThemeRole::Field, &after)
}

/// Keys that mean something in what lies over the view and nowhere else; absent where there are none.
fn own_keys(model: &Model) -> Option<Vec<(&'static str, &'static str)>> {
    match &model.entry.overlay {
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
                ("m", "moment it fails"),
                ("esc", "back"),
                (". ,", "step"),
                ("[ ]", "events"),
                ("h l", "1 s"),
                ("+ -", "speed"),
                ("n b", "next, before"),
            ])
        }
        Some(Overlay::Palette(_) | Overlay::Prompt(_) | Overlay::Form(_)) | None => None,
    }
}

/// The actions that mean something here, the weightiest first.
#[must_use]
pub fn actions(model: &Model) -> Vec<Action> {
    use crate::action::Action as A;
    let here: &[Action] = match (&model.entry.overlay, model.place.view) {
        (Some(Overlay::Palette(_)), _) => &[A::Open, A::Up, A::Down, A::Back],
        (Some(Overlay::Prompt(prompt)), _) => return in_prompt(model, prompt),
        // What is typed there is a passphrase, and its own keys stand beside it.
        (Some(Overlay::Form(form)), _) if form.signing.is_some() => &[],
        (Some(Overlay::Form(form)), _) if form.is_one_key() || form.void.is_some() => &[A::Back],
        (Some(Overlay::Form(form)), _) if form.types() => &[A::NextPane, A::Back],
        (Some(Overlay::Form(_)), _) => &[A::NextPane, A::Open, A::Back],
        (Some(Overlay::Why(_) | Overlay::Film(_)), _) => &[A::Back],
        (None, View::Overview) => &[
            A::Go,
            A::Open,
            A::Abort,
            A::Pause,
            A::Resume,
            A::ShowApprovals,
            A::NextPane,
            A::Freeze,
            A::Filter,
        ],
        (None, View::Registry) => &[
            A::Open,
            A::NextPane,
            A::Filter,
            A::Sort,
            A::Rollback,
            A::Resume,
            A::Demote,
            A::Repeat,
            A::Release,
            A::Rearm,
        ],
        (None, View::Candidate) => &[
            A::Open,
            A::NextPane,
            A::OpenRecording,
            A::Pause,
            A::Resume,
            A::Continue,
            A::Refuse,
            A::Rollback,
            A::Release,
            A::Repeat,
            A::Rearm,
            A::Abort,
            A::Copy,
        ],
        (None, View::Shadow) => {
            &[A::Freeze, A::ZoomIn, A::ZoomOut, A::NextPane, A::OpenRecording, A::Resume, A::Abort]
        }
        (None, View::Alarms) if model.place.pane() == HISTORY_PANE => &[A::NextPane, A::Open, A::Copy],
        (None, View::Alarms) => {
            &[A::Acknowledge, A::Mark, A::Shelve, A::Unshelve, A::ResetAlarm, A::Open, A::Abort]
        }
        (None, View::Approvals) => &[A::Open, A::Continue, A::Rollback, A::Abort],
        (None, View::Health) => {
            &[A::NextPane, A::ZoomIn, A::ZoomOut, A::Left, A::Right, A::Export, A::Freeze]
        }
        (None, View::Audit) => &[A::Open, A::NextPane, A::Verify, A::Filter, A::Copy, A::Export],
    };
    if model.bare_absence().is_some() && model.entry.overlay.is_none() {
        return vec![A::CommandLine, A::Help, A::Quit];
    }
    if model.entry.overlay.is_some() {
        return here.to_vec();
    }
    // A key that would be refused as things stand is no hint.
    let possible = Possible::of(model);
    // What calls for attention comes before what can be marked.
    let mark = model.place.lists_versions().then_some(A::Mark);
    let rest = [A::JumpToAlarm].into_iter().chain(mark).chain([A::CommandLine, A::Help, A::Quit]);
    let all = here.iter().copied().chain(rest);
    all.filter(|action| possible.is_offered(*action)).collect()
}

/// The same inside a prompt: a key that something stands against is no hint.
fn in_prompt(model: &Model, prompt: &Prompt) -> Vec<Action> {
    use crate::action::Action as A;
    let more = prompt.has_more().then_some(A::PageDown);
    let all = if prompt.signing.is_some() {
        // What is typed there is a passphrase, and its own keys stand beside it.
        return Vec::new();
    } else if prompt.closed {
        vec![more, Some(A::Back)]
    } else if prompt.focus != Focus::Hold {
        vec![Some(A::NextPane), more, Some(A::Back)]
    } else if prompt.stale.is_some() {
        vec![Some(A::Reread), more, Some(A::Back)]
    } else {
        // That a console is read-only is said beside the key; the key that rejects leads to the reason.
        let counts = |answer, but: &[Obstacle]| {
            let who = model.seat.operator.as_ref();
            let blocks = prompt.blocks(answer, who, model.settings.read_only, model.now_ms);
            blocks.iter().all(|block| *block == Obstacle::ReadOnly || but.contains(block))
        };
        let approve = counts(Answer::Approve, &[]).then_some(A::Approve);
        let reject = counts(Answer::Reject, &[Obstacle::Reason]).then_some(A::Reject);
        vec![approve, reject, Some(A::NextPane), more, Some(A::Back)]
    };
    all.into_iter().flatten().collect()
}

fn keys(model: &Model, actions: &[Action], width: usize) -> Row {
    // Help and the way out stand in every hint line.
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
    let why = Row::of(ThemeRole::KeyOff, "(off: read-only)");
    let row = row.and(tail);
    if model.settings.read_only && off && row.width() + why.width() <= width { row.and(why) } else { row }
}

/// One key and what it does, with the gap behind it; of a key that is off, in brackets.
fn hint(model: &Model, action: Action) -> Row {
    let key = model.keymap.key(action);
    if key.is_empty() {
        return Row::new();
    }
    let word = label(model, action);
    if model.settings.read_only && action.changes_something() {
        return Row::of(ThemeRole::KeyOff, &format!("[{key} {word}]  "));
    }
    Row::of(ThemeRole::Key, &key).with(ThemeRole::Text, &format!(" {word}  "))
}

/// What an action is called in a hint.
fn label(model: &Model, action: Action) -> String {
    match (action, &model.entry.overlay, model.place.view) {
        (Action::NextPane, Some(_), _) => "next field",
        (Action::Open, Some(Overlay::Palette(_)), _) => "runs it",
        (Action::Open, Some(_), _) => "presses the button",
        (Action::Open, None, View::Candidate) => "why",
        (Action::Back, Some(Overlay::Prompt(prompt)), _) if prompt.focus != Focus::Hold => "leave the field",
        (Action::Back, Some(Overlay::Prompt(prompt)), _) if prompt.closed || prompt.seen.granted => "close",
        (Action::Back, Some(Overlay::Prompt(_)), _) => "decide later",
        (Action::Back, Some(_), _) => "close",
        (Action::NextPane, None, View::Health) => "next quantity",
        (Action::NextPane, None, View::Alarms) if model.place.pane() == HISTORY_PANE => "open alarms",
        (Action::NextPane, None, View::Alarms) => "history",
        (Action::PageDown, _, _) => "more",
        (Action::JumpToAlarm, _, _) => "alarm",
        (Action::CommandLine, _, _) => "command",
        (Action::OpenRecording, _, _) => "recording",
        (Action::ResetAlarm, _, _) => "reset",
        (Action::Go, _, _) => "let it work again",
        (Action::Freeze, _, _) if model.place.frozen.is_some() => "let run",
        (Action::Open, None, View::Audit) => "raw record",
        (Action::Pause, _, _) => "hold",
        (Action::Resume, _, _) => "let go on",
        (Action::Quit, None, _) if model.absence().is_some() => "quit",
        (Action::Quit, None, View::Overview) if !model.told.ends_with_this() => "leave it on",
        (Action::Quit, None, View::Overview) if model.told.link == EngineLink::Attached => "end engine",
        (Action::Quit, None, View::Overview) => "quit",
        (Action::Quit, _, _) => "back",
        (other, _, _) => return other.word().replace('-', " "),
    }
    .to_owned()
}
