//! The explanation of a check's result, and the re-run that shows it: opening and keys.

use std::sync::Arc;

use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::{act, engine_requests, show_message};
use crate::action::Action;
use crate::effect::{Effect, EngineQuery};
use crate::model::{ConsoleModel, Overlay, RequestSubject, View, WhyScreen};
use crate::player::Player;
use crate::rows::CandidateItem;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::film::{Film, FilmRequest, FilmSubject};
use holdpoint_wording::console::why as wording;

/// Opens the explanation of the item under the cursor of the candidate view. Returns whether there is one.
pub(crate) fn open(model: &mut ConsoleModel) -> bool {
    if model.view_state.view != View::Candidate {
        return false;
    }
    let rows = model.candidate_rows(model.view_state.pane());
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
    model.input.overlay = Some(Overlay::Why(WhyScreen { version: detail.version.clone(), at, scroll: 0 }));
    true
}

/// Keys in the explanation. None of them changes anything.
pub(super) fn why_key(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let count = model.subject_detail().map_or(0, |detail| detail.why.len());
    let Some(Overlay::Why(screen)) = &mut model.input.overlay else { return Vec::new() };
    match (key.code, action) {
        (KeyCode::Char('w') | KeyCode::Enter, _) => return request_episode(model),
        (_, Some(Action::Stop | Action::Abort)) => return leave(model, action),
        (_, Some(Action::Back | Action::Quit)) => model.input.overlay = None,
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
    matches!(action, Action::Show(_) | Action::JumpToAlarm | Action::CommandLine | Action::Help)
}

/// Closes the overlay, then carries out the action.
fn leave(model: &mut ConsoleModel, action: Option<Action>) -> Vec<Effect> {
    if action != Some(Action::Stop) {
        model.input.overlay = None;
    }
    action.map_or_else(Vec::new, |action| act(model, action))
}

/// Requests the re-run that shows the explained result.
fn request_episode(model: &mut ConsoleModel) -> Vec<Effect> {
    let Some(Overlay::Why(screen)) = &model.input.overlay else { return Vec::new() };
    let (version, at) = (screen.version.clone(), screen.at);
    let detail = model.subject_detail().filter(|detail| detail.version == version);
    match detail.and_then(|detail| detail.why.get(at)).and_then(|why| why.film) {
        Some(request) => watch(model, version, request),
        None => {
            show_message(model, wording::NO_RERUN, true);
            Vec::new()
        }
    }
}

fn watch(
    model: &mut ConsoleModel,
    version: holdpoint_governance::ids::CapabilityId,
    request: FilmRequest,
) -> Vec<Effect> {
    if model.requests.pending.values().any(|pending| pending.about == RequestSubject::Film) {
        show_message(model, wording::RERUN_IN_PROGRESS, false);
        return Vec::new();
    }
    show_message(model, wording::WORKING_AGAIN, false);
    engine_requests::send_query(model, wording::see_it_work(&version), EngineQuery::Film { version, request })
}

/// Takes in a film and shows it if the operator still waits there.
pub(super) fn film(model: &mut ConsoleModel, film: Box<Film>) {
    let waits = match &model.input.overlay {
        Some(Overlay::Why(screen)) => screen.version == film.candidate.version,
        Some(Overlay::Film(watched)) => watched.back.version == film.candidate.version,
        _ => false,
    };
    if !waits {
        return show_message(model, wording::RERUN_READY, false);
    }
    let back = match model.input.overlay.take() {
        Some(Overlay::Why(screen)) => screen,
        Some(Overlay::Film(watched)) => watched.back,
        other => {
            model.input.overlay = other;
            return;
        }
    };
    model.notice = None;
    let player = Player::new(Arc::from(film), model.now_ms);
    model.input.overlay = Some(Overlay::Film(Box::new(FilmScreen { player, back })));
}

pub(super) use crate::model::FilmScreen;

/// Keys while a film is watched.
pub(super) fn film_key(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> Vec<Effect> {
    let now_ms = model.now_ms;
    let Some(Overlay::Film(watched)) = &mut model.input.overlay else { return Vec::new() };
    let player = &mut watched.player;
    match (key.code, action) {
        (KeyCode::Char(' '), _) => player.toggle(now_ms),
        (KeyCode::Char('.'), _) => player.step(true),
        (KeyCode::Char(','), _) => player.step(false),
        (KeyCode::Char('m') | KeyCode::Enter, _) => {
            let fails = player.to_failure();
            if !fails {
                show_message(model, wording::NOTHING_GOES_WRONG, false);
            }
        }
        (KeyCode::Char(']'), _) => player.to_mark(true),
        (KeyCode::Char('['), _) => player.to_mark(false),
        (KeyCode::Char('n'), _) => return adjacent_piece(model, true),
        (KeyCode::Char('b'), _) => return adjacent_piece(model, false),
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
            model.input.overlay = Some(Overlay::Why(back));
        }
        _ => {}
    }
    Vec::new()
}

/// The next re-run of the same kind, or the one before.
fn adjacent_piece(model: &mut ConsoleModel, forward: bool) -> Vec<Effect> {
    let Some(Overlay::Film(watched)) = &model.input.overlay else { return Vec::new() };
    let Film { of, number, count, .. } = *watched.player.film;
    let version = watched.back.version.clone();
    let next =
        if forward { number.checked_add(1).filter(|next| *next <= count) } else { number.checked_sub(1) };
    match next.filter(|next| *next > 0) {
        Some(number) => watch(model, version, FilmRequest { of, number: Some(number) }),
        None => {
            let what = match of {
                FilmSubject::Drill => "failed drill",
                FilmSubject::Episode | FilmSubject::Confirmation | FilmSubject::Alone => "episode",
            };
            show_message(model, wording::first_or_last(if forward { "last" } else { "first" }, what), false);
            Vec::new()
        }
    }
}

/// Advances a film that plays.
pub(super) fn pass(model: &mut ConsoleModel) {
    let now_ms = model.now_ms;
    if let Some(Overlay::Film(watched)) = &mut model.input.overlay {
        watched.player.pass(now_ms);
    }
}
