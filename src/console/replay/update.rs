//! The reducer: what happened becomes a changed model and effects. Pure, and the one place where a replay changes.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::action::{self, Action};
use super::jump::{self, Target};
use super::model::Model;
use super::playing;
use super::timeline::Cursor;
use crate::line::Line;
use crate::update::into_line;

/// One second, ms.
const SECOND_MS: u64 = 1_000;

/// Something happened, at a moment of the screen's own clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Msg {
    /// When, ms since the start; monotonic.
    pub now_ms: u64,
    /// What.
    pub what: What,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// A key went down (or repeats).
    Key(KeyEvent),
    /// Text was pasted.
    Paste(String),
    /// The screen has another size.
    Resize,
    /// Time passed.
    Tick,
}

/// What is to be done beside drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Draw a frame.
    Draw,
    /// Leave the replay.
    Leave,
}

/// Folds one thing in.
pub fn update(model: &mut Model, msg: Msg) -> Vec<Effect> {
    let moved = playing::pass(model, msg.now_ms);
    match msg.what {
        What::Tick if !moved => Vec::new(),
        What::Tick | What::Resize => vec![Effect::Draw],
        What::Paste(text) => {
            if let Some(line) = &mut model.typing {
                line.paste(&text);
            }
            vec![Effect::Draw]
        }
        What::Key(key) => self::key(model, key),
    }
}

fn key(model: &mut Model, key: KeyEvent) -> Vec<Effect> {
    model.notice = None;
    if model.typing.is_some() {
        typed(model, key);
        return vec![Effect::Draw];
    }
    let asked = action::of(key);
    if let Some(first) = model.help {
        model.help = match (asked, key.code) {
            (Some(Action::Leave | Action::Help), _) => None,
            (_, KeyCode::Down | KeyCode::PageDown | KeyCode::Char('j')) => Some(first.saturating_add(1)),
            (_, KeyCode::Up | KeyCode::PageUp | KeyCode::Char('k')) => Some(first.saturating_sub(1)),
            _ => Some(first),
        };
        return vec![Effect::Draw];
    }
    match (asked, key.code) {
        (Some(Action::Leave), _) => return vec![Effect::Leave],
        (Some(action), _) => act(model, action),
        (None, KeyCode::Char(digit)) if digit.is_ascii_digit() && key.modifiers.is_empty() => {
            model.typing = Some(Line::new(&digit.to_string()));
        }
        (None, _) => {}
    }
    vec![Effect::Draw]
}

/// A key for the line in which the place to jump to is typed.
fn typed(model: &mut Model, key: KeyEvent) {
    let Some(line) = &mut model.typing else { return };
    let cancels = key.code == KeyCode::Esc
        || (key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL));
    let empties = key.code == KeyCode::Backspace && line.text().is_empty();
    if cancels || empties {
        model.typing = None;
    } else if key.code == KeyCode::Enter {
        let text = line.text().to_owned();
        model.typing = None;
        if !text.trim().is_empty() {
            jump_to(model, &text);
        }
    } else {
        into_line(line, key);
    }
}

fn jump_to(model: &mut Model, text: &str) {
    let target_ms = match jump::parse(text) {
        Ok(Target::At(at_ms)) => at_ms,
        Ok(Target::On(by_ms)) => model.cursor.at_ms.saturating_add(by_ms),
        Ok(Target::Back(by_ms)) => model.cursor.at_ms.saturating_sub(by_ms),
        Err(error) => return model.tell(error.to_string(), true),
    };
    seek(model, target_ms);
    let (from_ms, to_ms) = model.timeline.span_ms();
    if !(from_ms..=to_ms).contains(&target_ms) {
        model.tell(
            format!(
                "the recording goes from {} to {}",
                super::views::secs(from_ms),
                super::views::secs(to_ms)
            ),
            false,
        );
    }
}

fn act(model: &mut Model, action: Action) {
    match action {
        Action::Play => play(model),
        Action::NextPicture => picture_on(model),
        Action::PreviousPicture => picture_back(model),
        Action::SecondOn => seek(model, model.cursor.at_ms.saturating_add(SECOND_MS)),
        Action::SecondBack => seek(model, model.cursor.at_ms.saturating_sub(SECOND_MS)),
        Action::Faster => model.speed = model.speed.faster(),
        Action::Slower => model.speed = model.speed.slower(),
        Action::NextEvent => event_on(model, false),
        Action::PreviousEvent => event_back(model, false),
        Action::NextTurn => event_on(model, true),
        Action::PreviousTurn => event_back(model, true),
        Action::First => seek(model, model.timeline.span_ms().0),
        Action::Last => seek(model, model.timeline.span_ms().1),
        Action::Jump => model.typing = Some(Line::default()),
        Action::NextCharts => turn_charts(model, 1),
        Action::PreviousCharts => turn_charts(model, model.timeline.groups().len().saturating_sub(1)),
        Action::SkipGaps => {
            model.skips_gaps = !model.skips_gaps;
            let text =
                if model.skips_gaps { "gaps are skipped while playing" } else { "gaps are played through" };
            model.tell(text, false);
        }
        Action::Help => model.help = Some(0),
        Action::Leave => {}
    }
}

/// At the end playing begins anew.
fn play(model: &mut Model) {
    model.playing = !model.playing;
    let (from_ms, to_ms) = model.timeline.span_ms();
    if model.playing && model.cursor.at_ms >= to_ms {
        seek(model, from_ms);
    }
}

fn seek(model: &mut Model, at_ms: u64) {
    go(model, model.timeline.at(at_ms));
}

fn go(model: &mut Model, cursor: Cursor) {
    model.cursor = cursor;
    model.carried_quarters = 0;
    model.rests_until_ms = 0;
}

/// On an event, playing stands for a moment, so that it can be read before what follows.
fn go_to_event(model: &mut Model, cursor: Cursor) {
    go(model, cursor);
    playing::rest(model);
}

fn picture_on(model: &mut Model) {
    model.playing = false;
    let next = model.cursor.picture.map_or(0, |picture| picture + 1);
    match model.timeline.on_picture(next) {
        Some(cursor) => go(model, cursor),
        None => model.tell("no picture after this one", false),
    }
}

/// The picture before; the present one where that is not fresh any more.
fn picture_back(model: &mut Model) {
    model.playing = false;
    let is_old = model.picture_age_ms().is_some_and(|age_ms| age_ms > super::FRESH_MS);
    let before = model.cursor.picture.and_then(|picture| picture.checked_sub(usize::from(!is_old)));
    match before.and_then(|picture| model.timeline.on_picture(picture)) {
        Some(cursor) => go(model, cursor),
        None => model.tell("no picture before this one", false),
    }
}

fn event_on(model: &mut Model, turns: bool) {
    let mut next = model.cursor.event.map_or(0, |event| event + 1);
    while turns && model.timeline.event(next).is_some() && !is_turn(model, next) {
        next += 1;
    }
    match model.timeline.on_event(next) {
        Some(cursor) => go_to_event(model, cursor),
        None if turns => model.tell("no decision after this", false),
        None => model.tell("no event after this", false),
    }
}

/// The event before the cursor; while playing, the one before what has just passed.
fn event_back(model: &mut Model, turns: bool) {
    let passed_ms = if model.playing { model.speed.quarters(SECOND_MS) / 4 } else { 0 };
    let at_ms = model.cursor.at_ms.saturating_sub(passed_ms);
    let is_before = |event: &usize| {
        let is_wanted = !turns || is_turn(model, *event);
        let is_earlier = model.timeline.event(*event).is_some_and(|event| event.at_ms < at_ms);
        is_wanted && (is_earlier || model.cursor.event.is_some_and(|here| *event < here))
    };
    let last = model.cursor.event.map_or(0, |event| event + 1);
    match (0..last).rev().find(is_before).and_then(|event| model.timeline.on_event(event)) {
        Some(cursor) => go_to_event(model, cursor),
        None if turns => model.tell("no decision before this", false),
        None => model.tell("no event before this", false),
    }
}

fn is_turn(model: &Model, event: usize) -> bool {
    model.timeline.mark(event).is_some_and(|mark| mark.is_turn)
}

/// Other charts. Those that the stage asks for follow the stage again.
fn turn_charts(model: &mut Model, by: usize) {
    let count = model.timeline.groups().len();
    let Some((shown, _)) = model.shown_charts() else {
        return model.tell("this recording holds no charts", false);
    };
    let next = (shown + by) % count;
    model.charts = (next != model.charts_by_stage()).then_some(next);
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
