//! The replay of a recording over the view, where no viewer can show it: opening, keys, and the passing of time.

use ratatui::crossterm::event::KeyEvent;

use super::{act, show_message};
use crate::action::Action;
use crate::effect::Effect;
use crate::model::{ConsoleModel, Overlay};
use crate::replay::model::ReplayModel;
use crate::replay::playback;
use crate::replay::speed::Speed;
use crate::replay::timeline::Timeline;
use crate::replay::update::{ReplayEffect, ReplayMsg, ReplayMsgKind, update};
use holdpoint_recordings::recording::Recording;
use holdpoint_wording::console::recording as wording;

/// Opens a recording, and says why no viewer shows it. What lies over the view, or is typed, stays.
pub(super) fn open(model: &mut ConsoleModel, recording: Recording, why: &str) {
    let version = recording.about.version.to_string();
    if model.input.overlay.is_some() || model.input.typing.is_some() {
        let text = wording::read_while_busy(&version);
        return show_message(model, text, false);
    }
    if recording.span_ms().is_none() {
        let text = wording::holds_nothing_yet(&version);
        return show_message(model, text, true);
    }
    let replay = ReplayModel::new(Timeline::new(recording), Speed::default());
    model.input.overlay = Some(Overlay::Replay(Box::new(replay)));
    show_message(model, wording::replayed_here(why), false);
}

/// Keys of the replay. The arm can be stopped meanwhile, unless a jump target is typed.
pub(super) fn key(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Replay(replay)) = &mut model.input.overlay else { return Vec::new() };
    if replay.typing.is_none() && action == Some(Action::Stop) {
        return act(model, Action::Stop);
    }
    if replay.typing.is_none() && action == Some(Action::JumpToAlarm) {
        model.input.overlay = None;
        return act(model, Action::JumpToAlarm);
    }
    let effects = update(replay, ReplayMsg { now_ms, what: ReplayMsgKind::Key(key) });
    if effects.contains(&ReplayEffect::Leave) {
        model.input.overlay = None;
    }
    Vec::new()
}

/// Advances a replay that plays.
pub(super) fn pass(model: &mut ConsoleModel) {
    let now_ms = model.now_ms;
    if let Some(Overlay::Replay(replay)) = &mut model.input.overlay {
        playback::pass(replay, now_ms);
    }
}
