//! The reducer of a replay, pure: a message gives a changed model and effects.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::action::{self, ReplayAction};
use super::jump::{self, JumpTarget};
use super::message::ReplayMessage;
use super::model::ReplayModel;
use super::playback;
use super::timeline::TimelineCursor;
use crate::line::EditLine;
use crate::update::into_line;

/// One second of recorded time, ms.
const SECOND_MS: u64 = 1_000;

/// A message, at a moment of the screen's own clock.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayMsg {
    /// When, ms since the start; monotonic.
    pub now_ms: u64,
    pub what: ReplayMsgKind,
}

#[derive(Clone, Debug, PartialEq)]
pub enum ReplayMsgKind {
    /// A key went down (or repeats).
    Key(KeyEvent),
    Paste(String),
    /// The screen has another size.
    Resize,
    Tick,
}

/// An effect besides drawing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayEffect {
    Draw,
    Leave,
}

/// Applies one message.
pub fn update(model: &mut ReplayModel, msg: ReplayMsg) -> Vec<ReplayEffect> {
    let moved = playback::pass(model, msg.now_ms);
    match msg.what {
        ReplayMsgKind::Tick if !moved => Vec::new(),
        ReplayMsgKind::Tick | ReplayMsgKind::Resize => vec![ReplayEffect::Draw],
        ReplayMsgKind::Paste(text) => {
            if let Some(line) = &mut model.typing {
                line.paste(&text);
            }
            vec![ReplayEffect::Draw]
        }
        ReplayMsgKind::Key(key) => self::key(model, key),
    }
}

fn key(model: &mut ReplayModel, key: KeyEvent) -> Vec<ReplayEffect> {
    model.notice = None;
    if model.typing.is_some() {
        typed(model, key);
        return vec![ReplayEffect::Draw];
    }
    let requested = action::of(key);
    if let Some(first) = model.help {
        model.help = match (requested, key.code) {
            (Some(ReplayAction::Leave | ReplayAction::Help), _) => None,
            (_, KeyCode::Down | KeyCode::PageDown | KeyCode::Char('j')) => Some(first.saturating_add(1)),
            (_, KeyCode::Up | KeyCode::PageUp | KeyCode::Char('k')) => Some(first.saturating_sub(1)),
            _ => Some(first),
        };
        return vec![ReplayEffect::Draw];
    }
    match (requested, key.code) {
        (Some(ReplayAction::Leave), _) => return vec![ReplayEffect::Leave],
        (Some(action), _) => act(model, action),
        (None, KeyCode::Char(digit)) if digit.is_ascii_digit() && key.modifiers.is_empty() => {
            model.typing = Some(EditLine::new(&digit.to_string()));
        }
        (None, _) => {}
    }
    vec![ReplayEffect::Draw]
}

/// A key for the line with the jump target.
fn typed(model: &mut ReplayModel, key: KeyEvent) {
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

fn jump_to(model: &mut ReplayModel, text: &str) {
    let target_ms = match jump::parse(text) {
        Ok(JumpTarget::At(at_ms)) => at_ms,
        Ok(JumpTarget::On(by_ms)) => model.cursor.at_ms.saturating_add(by_ms),
        Ok(JumpTarget::Back(by_ms)) => model.cursor.at_ms.saturating_sub(by_ms),
        Err(error) => return model.show_notice(ReplayMessage::NoTarget(error)),
    };
    seek(model, target_ms);
    let (from_ms, to_ms) = model.timeline.span_ms();
    if !(from_ms..=to_ms).contains(&target_ms) {
        model.show_notice(ReplayMessage::Outside { from_ms, to_ms });
    }
}

fn act(model: &mut ReplayModel, action: ReplayAction) {
    match action {
        ReplayAction::Play => play(model),
        ReplayAction::NextFrame => next_frame(model),
        ReplayAction::PreviousFrame => previous_frame(model),
        ReplayAction::SecondOn => seek(model, model.cursor.at_ms.saturating_add(SECOND_MS)),
        ReplayAction::SecondBack => seek(model, model.cursor.at_ms.saturating_sub(SECOND_MS)),
        ReplayAction::Faster => model.speed = model.speed.faster(),
        ReplayAction::Slower => model.speed = model.speed.slower(),
        ReplayAction::NextEvent => next_event(model, false),
        ReplayAction::PreviousEvent => previous_event(model, false),
        ReplayAction::NextTurn => next_event(model, true),
        ReplayAction::PreviousTurn => previous_event(model, true),
        ReplayAction::Failure => next_failure(model),
        ReplayAction::First => seek(model, model.timeline.span_ms().0),
        ReplayAction::Last => seek(model, model.timeline.span_ms().1),
        ReplayAction::Jump => model.typing = Some(EditLine::default()),
        ReplayAction::NextCharts => turn_charts(model, 1),
        ReplayAction::PreviousCharts => turn_charts(model, model.timeline.groups().len().saturating_sub(1)),
        ReplayAction::SkipGaps => {
            model.skips_gaps = !model.skips_gaps;
            let message =
                if model.skips_gaps { ReplayMessage::GapsSkipped } else { ReplayMessage::GapsPlayed };
            model.show_notice(message);
        }
        ReplayAction::Help => model.help = Some(0),
        ReplayAction::Leave => {}
    }
}

/// At the end, playing starts over.
fn play(model: &mut ReplayModel) {
    model.playing = !model.playing;
    let (from_ms, to_ms) = model.timeline.span_ms();
    if model.playing && model.cursor.at_ms >= to_ms {
        seek(model, from_ms);
    }
}

fn seek(model: &mut ReplayModel, at_ms: u64) {
    go(model, model.timeline.at(at_ms));
}

fn go(model: &mut ReplayModel, cursor: TimelineCursor) {
    model.cursor = cursor;
    model.carried_quarters = 0;
    model.rests_until_ms = 0;
}

/// Pauses on an event, so that it can be read before the next one.
fn go_to_event(model: &mut ReplayModel, cursor: TimelineCursor) {
    go(model, cursor);
    playback::rest(model);
}

fn next_frame(model: &mut ReplayModel) {
    model.playing = false;
    let next = model.cursor.frame.map_or(0, |frame| frame + 1);
    match model.timeline.on_frame(next) {
        Some(cursor) => go(model, cursor),
        None => model.show_notice(ReplayMessage::NoFrameAfter),
    }
}

/// The frame before; the present one if that is no longer fresh.
fn previous_frame(model: &mut ReplayModel) {
    model.playing = false;
    let is_old = model.frame_age_ms().is_some_and(|age_ms| age_ms > super::FRESH_MS);
    let before = model.cursor.frame.and_then(|frame| frame.checked_sub(usize::from(!is_old)));
    match before.and_then(|frame| model.timeline.on_frame(frame)) {
        Some(cursor) => go(model, cursor),
        None => model.show_notice(ReplayMessage::NoFrameBefore),
    }
}

fn next_event(model: &mut ReplayModel, turns: bool) {
    let mut next = model.cursor.event.map_or(0, |event| event + 1);
    while turns && model.timeline.event(next).is_some() && !is_turn(model, next) {
        next += 1;
    }
    match model.timeline.on_event(next) {
        Some(cursor) => go_to_event(model, cursor),
        None if turns => model.show_notice(ReplayMessage::NoDecisionAfter),
        None => model.show_notice(ReplayMessage::NoEventAfter),
    }
}

/// Pauses at the next moment where it went wrong; after the last one, at the first.
fn next_failure(model: &mut ReplayModel) {
    match model.timeline.failures().next_ms(model.cursor.at_ms) {
        Some(at_ms) => {
            model.playing = false;
            seek(model, at_ms);
        }
        None => model.show_notice(ReplayMessage::NoFailure),
    }
}

/// The event before the cursor; while playing, the one before the last passed event.
fn previous_event(model: &mut ReplayModel, turns: bool) {
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
        None if turns => model.show_notice(ReplayMessage::NoDecisionBefore),
        None => model.show_notice(ReplayMessage::NoEventBefore),
    }
}

fn is_turn(model: &ReplayModel, event: usize) -> bool {
    model.timeline.mark(event).is_some_and(|mark| mark.is_turn)
}

/// Selects other charts. The stage's own charts follow the stage again.
fn turn_charts(model: &mut ReplayModel, by: usize) {
    let count = model.timeline.groups().len();
    let Some((shown, _)) = model.shown_charts() else {
        return model.show_notice(ReplayMessage::NoCharts);
    };
    let next = (shown + by) % count;
    model.charts = (next != model.charts_by_stage()).then_some(next);
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
