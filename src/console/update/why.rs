//! Why a check came out as it did, and the work that shows it: what opens them, and their keys.

use std::sync::Arc;

use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::{act, asking, tell};
use crate::action::Action;
use crate::effect::{Effect, Question};
use crate::model::{AskedFor, Model, Overlay, View, WhyScreen};
use crate::player::Player;
use crate::rows::CandidateItem;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::film::{Film, FilmAsked, FilmOf};

/// Opens why, for what lies under the cursor of the candidate view. Tells whether there is one.
pub(super) fn open(model: &mut Model) -> bool {
    if model.place.view != View::Candidate {
        return false;
    }
    let rows = model.candidate_rows(model.place.pane());
    let about = match rows.get(model.row()) {
        Some(CandidateItem::Dimension(result)) => Some(result.dimension),
        Some(CandidateItem::Reason(reason)) => Some(reason.dimension),
        Some(CandidateItem::Worsening(_)) => Some(Dimension::Behavior),
        Some(CandidateItem::Drill(_)) => Some(Dimension::Recovery),
        _ => None,
    };
    let Some(detail) = model.subject_detail() else { return false };
    let Some(at) = about.and_then(|about| detail.why.iter().position(|why| why.about == about)) else {
        return false;
    };
    model.entry.overlay = Some(Overlay::Why(WhyScreen { version: detail.version.clone(), at, scroll: 0 }));
    true
}

/// Keys in the explanation. None of them changes anything.
pub(super) fn why_key(model: &mut Model, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let count = model.subject_detail().map_or(0, |detail| detail.why.len());
    let Some(Overlay::Why(screen)) = &mut model.entry.overlay else { return Vec::new() };
    match (key.code, action) {
        (KeyCode::Char('w') | KeyCode::Enter, _) => return ask(model),
        (_, Some(Action::Stop | Action::Abort)) => return leave(model, action),
        (_, Some(Action::Back | Action::Quit)) => model.entry.overlay = None,
        (_, Some(Action::Left | Action::PreviousPane)) => {
            *screen = screen.turned((screen.at + count.saturating_sub(1)) % count.max(1));
        }
        (_, Some(Action::Right | Action::NextPane)) => {
            *screen = screen.turned((screen.at + 1) % count.max(1));
        }
        (_, Some(Action::Down)) => screen.scroll = screen.scroll.saturating_add(1),
        (_, Some(Action::Up)) => screen.scroll = screen.scroll.saturating_sub(1),
        (_, Some(Action::PageDown)) => screen.scroll = screen.scroll.saturating_add(10),
        (_, Some(Action::PageUp)) => screen.scroll = screen.scroll.saturating_sub(10),
        (_, Some(Action::Top)) => screen.scroll = 0,
        (_, Some(Action::OpenRecording | Action::OpenLive | Action::Copy)) => return leave(model, action),
        (_, Some(shown)) if leads_elsewhere(shown) => return leave(model, action),
        _ => {}
    }
    Vec::new()
}

/// Whether an action goes to another view, or to its help.
const fn leads_elsewhere(action: Action) -> bool {
    matches!(
        action,
        Action::ShowOverview
            | Action::ShowRegistry
            | Action::ShowCandidate
            | Action::ShowShadow
            | Action::ShowAlarms
            | Action::ShowApprovals
            | Action::ShowAudit
            | Action::ShowHealth
            | Action::JumpToAlarm
            | Action::CommandLine
            | Action::Help
    )
}

/// Closes what is open, then does what the key means.
fn leave(model: &mut Model, action: Option<Action>) -> Vec<Effect> {
    if action != Some(Action::Stop) {
        model.entry.overlay = None;
    }
    action.map_or_else(Vec::new, |action| act(model, action))
}

/// Asks for the work that shows what is explained.
fn ask(model: &mut Model) -> Vec<Effect> {
    let Some(Overlay::Why(screen)) = &model.entry.overlay else { return Vec::new() };
    let (version, at) = (screen.version.clone(), screen.at);
    let detail = model.subject_detail().filter(|detail| detail.version == version);
    match detail.and_then(|detail| detail.why.get(at)).and_then(|why| why.film) {
        Some(asked) => watch(model, version, asked),
        None => {
            tell(model, "nothing was worked for this check that could be seen again", true);
            Vec::new()
        }
    }
}

fn watch(
    model: &mut Model,
    version: holdpoint_governance::ids::CapabilityId,
    asked: FilmAsked,
) -> Vec<Effect> {
    if model.asking.pending.values().any(|pending| pending.about == AskedFor::Film) {
        tell(model, "one is being worked again already", false);
        return Vec::new();
    }
    tell(model, "working it again", false);
    asking::ask(model, format!("see {version} work"), Question::Film { version, asked })
}

/// A film came: it is shown if whoever asked for it still waits there.
pub(super) fn film(model: &mut Model, film: Box<Film>) {
    let waits = match &model.entry.overlay {
        Some(Overlay::Why(screen)) => screen.version == film.candidate.version,
        Some(Overlay::Film(watched)) => watched.back.version == film.candidate.version,
        _ => false,
    };
    if !waits {
        return tell(model, "what was to be seen again is there; ask for it anew to see it", false);
    }
    let back = match model.entry.overlay.take() {
        Some(Overlay::Why(screen)) => screen,
        Some(Overlay::Film(watched)) => watched.back,
        other => {
            model.entry.overlay = other;
            return;
        }
    };
    model.notice = None;
    let player = Player::new(Arc::from(film), model.now_ms);
    model.entry.overlay = Some(Overlay::Film(Box::new(Watched { player, back })));
}

pub(super) use crate::model::Watched;

/// Keys while a film is watched.
pub(super) fn film_key(model: &mut Model, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Film(watched)) = &mut model.entry.overlay else { return Vec::new() };
    let player = &mut watched.player;
    match (key.code, action) {
        (KeyCode::Char(' '), _) => player.toggle(now_ms),
        (KeyCode::Char('.'), _) => player.step(true),
        (KeyCode::Char(','), _) => player.step(false),
        (KeyCode::Char('m') | KeyCode::Enter, _) => {
            let fails = player.to_failure();
            if !fails {
                tell(model, "nothing goes wrong in it", false);
            }
        }
        (KeyCode::Char(']'), _) => player.to_mark(true),
        (KeyCode::Char('['), _) => player.to_mark(false),
        (KeyCode::Char('n'), _) => return other(model, true),
        (KeyCode::Char('b'), _) => return other(model, false),
        (_, Some(Action::ZoomIn)) => player.speed = player.speed.faster(),
        (_, Some(Action::ZoomOut)) => player.speed = player.speed.slower(),
        (_, Some(Action::Right)) => player.skip(true),
        (_, Some(Action::Left)) => player.skip(false),
        (_, Some(Action::Top)) => player.begin(),
        (_, Some(Action::Bottom)) => player.end(),
        (_, Some(Action::Stop)) => return act(model, Action::Stop),
        (_, Some(shown)) if leads_elsewhere(shown) => return leave(model, action),
        (_, Some(Action::Back | Action::Quit)) => {
            let back = watched.back.clone();
            model.entry.overlay = Some(Overlay::Why(back));
        }
        _ => {}
    }
    Vec::new()
}

/// The next piece of work of the same kind, or the one before.
fn other(model: &mut Model, forward: bool) -> Vec<Effect> {
    let Some(Overlay::Film(watched)) = &model.entry.overlay else { return Vec::new() };
    let Film { of, number, count, .. } = *watched.player.film;
    let version = watched.back.version.clone();
    let next =
        if forward { number.checked_add(1).filter(|next| *next <= count) } else { number.checked_sub(1) };
    match next.filter(|next| *next > 0) {
        Some(number) => watch(model, version, FilmAsked { of, number: Some(number) }),
        None => {
            let what = match of {
                FilmOf::Drill => "failed drill",
                FilmOf::Episode | FilmOf::Confirmation | FilmOf::Alone => "episode",
            };
            tell(model, format!("this is the {} {what}", if forward { "last" } else { "first" }), false);
            Vec::new()
        }
    }
}

/// Time passes in a film that runs.
pub(super) fn pass(model: &mut Model) {
    let now_ms = model.now_ms;
    if let Some(Overlay::Film(watched)) = &mut model.entry.overlay {
        watched.player.pass(now_ms);
    }
}
