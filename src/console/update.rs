//! The reducer: a model and a message give a changed model and effects.
//!
//! Pure: no clock, no terminal, no engine. Each action of an operator passes here, so a table test beside it covers
//! what must never happen (a reflex key that approves, an approval over stale evidence).

pub mod availability;
mod cell_restart;
mod engine_requests;
mod engine_updates;
pub(super) mod event_screen;
mod find_in_view;
pub(super) mod health;
mod identity_offer;
mod key_log;
mod mouse;
pub(super) mod navigation;
mod operations;
mod overlays;
mod recording;
pub(super) mod selection;
mod text_entry;
mod undo;
pub(super) mod why;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

pub(super) use text_entry::into_line;

use super::action::Action;
use super::effect::Effect;
use super::form::DismissedForm;
use super::model::{ConsoleModel, ConsoleNotice, FrozenView, NOTICE_BYTE_MS, NOTICE_MS, Overlay, View};
use super::msg::{Msg, MsgKind};
use super::palette::Palette;
use super::state_filter::StateFilter;
use holdpoint_text::Hint as _;
use holdpoint_wording::console::shared;
use holdpoint_wording::console::update as wording;

/// Halvings of a chart's range at most.
const ZOOM_MAX: u8 = 6;

/// How often the operator's own files are checked, ms.
const OWN_FILES_MS: u64 = 2_000;

/// Views remembered for going back.
const BACK_MAX: usize = 16;

/// Updates the model with a message. The cursor stays on its item, wherever that moves.
pub fn update(model: &mut ConsoleModel, msg: Msg) -> Vec<Effect> {
    let by_itself = match &msg.what {
        // These change no list.
        MsgKind::Tick
        | MsgKind::Burst
        | MsgKind::LineMode(_)
        | MsgKind::VideoFrame(_)
        | MsgKind::Resize(..)
        | MsgKind::Theme(_)
        | MsgKind::OperatorFiles { .. }
        | MsgKind::Completions { .. }
        | MsgKind::RecordingRead { .. }
        | MsgKind::DecisionShown(_) => None,
        MsgKind::Key(_) | MsgKind::Paste(_) | MsgKind::Wheel(_) | MsgKind::Click(..) => Some(false),
        MsgKind::EngineStarted
        | MsgKind::Events(_)
        | MsgKind::Past { .. }
        | MsgKind::Attached(..)
        | MsgKind::ReconnectFailed(_)
        | MsgKind::Answer { .. }
        | MsgKind::Lagged(_)
        | MsgKind::Snapshot(_)
        | MsgKind::EngineEnded(_)
        | MsgKind::Identities(_)
        | MsgKind::Operator(_)
        | MsgKind::Done { .. }
        | MsgKind::NoIdentity { .. }
        | MsgKind::Unsigned { .. }
        | MsgKind::EndRequested => Some(true),
    };
    let mut effects = take_in(model, msg);
    effects.extend(engine_requests::request_approval_text(model));
    if let Some(by_itself) = by_itself {
        navigation::follow(model, by_itself);
    }
    effects
}

fn take_in(model: &mut ConsoleModel, msg: Msg) -> Vec<Effect> {
    model.now_ms = model.now_ms.max(msg.now_ms);
    if model.notice.as_ref().is_some_and(|notice| notice.until_ms <= model.now_ms) {
        model.notice = None;
    }
    match msg.what {
        MsgKind::Key(key) if key.kind == KeyEventKind::Release => Vec::new(),
        MsgKind::Key(key) => key_log::note(model, key, on_key),
        MsgKind::Paste(text) => {
            overlays::guard_again(model);
            text_entry::paste(model, &text)
        }
        MsgKind::Burst => {
            overlays::guard_again(model);
            Vec::new()
        }
        MsgKind::Wheel(rows) => navigation::wheel(model, rows),
        MsgKind::Click(column, row) => mouse::click(model, column, row),
        MsgKind::Resize(columns, rows) => {
            model.size = (columns, rows);
            Vec::new()
        }
        MsgKind::LineMode(is_on) => {
            model.line_mode = is_on;
            Vec::new()
        }
        MsgKind::EngineStarted => engine_updates::started(model),
        MsgKind::Events(events) => engine_updates::events(model, events),
        MsgKind::Past { events, earlier } => engine_updates::past(model, &events, earlier),
        MsgKind::Attached(process, unverified) => engine_updates::attached(model, process, unverified),
        MsgKind::ReconnectFailed(seeking) => {
            model.engine_data.reconnect = Some(seeking);
            Vec::new()
        }
        MsgKind::Answer { id, reply } => engine_updates::answer(model, &id, *reply),
        MsgKind::Lagged(missed) => {
            model.engine_data.missed = model.engine_data.missed.saturating_add(missed);
            model.requests.changes += 1;
            Vec::new()
        }
        MsgKind::Snapshot(snapshot) => engine_updates::snapshot(model, snapshot),
        MsgKind::VideoFrame(frame) => {
            model.engine_data.framing.see(&frame);
            model.engine_data.frame = Some(frame);
            Vec::new()
        }
        MsgKind::EngineEnded(how) => engine_updates::ended(model, how),
        MsgKind::Identities(identities) => {
            model.session.identities = identities;
            Vec::new()
        }
        MsgKind::Operator(operator) => {
            model.session.requested_name = None;
            show_message(model, format!("now {} ({})", operator.name, operator.role), false);
            model.session.operator = Some(operator);
            Vec::new()
        }
        MsgKind::Done { text, bad } => {
            show_message(model, text, bad);
            Vec::new()
        }
        MsgKind::NoIdentity { name, text } => identity_offer::unknown_identity(model, name, text),
        MsgKind::Completions { typed, lines } => {
            text_entry::offer(model, typed, lines);
            Vec::new()
        }
        MsgKind::RecordingRead { recording, why } => {
            recording::open(model, *recording, &why);
            Vec::new()
        }
        MsgKind::Theme(name) => {
            show_message(model, format!("theme {name}"), false);
            model.settings.theme = name;
            Vec::new()
        }
        MsgKind::Unsigned { id, text } => {
            overlays::unsigned(model, &id, text);
            Vec::new()
        }
        MsgKind::DecisionShown(visible) => {
            if let Some(overlay) = &mut model.input.overlay {
                overlay.mark_read(&visible);
            }
            Vec::new()
        }
        MsgKind::EndRequested => vec![Effect::End],
        MsgKind::OperatorFiles { keymap, themes } => {
            (model.keymap, model.themes) = (keymap, themes);
            show_message(model, wording::RELOADED, false);
            Vec::new()
        }
        MsgKind::Tick => {
            why::pass(model);
            recording::pass(model);
            let mut effects = engine_requests::refresh(model);
            if model.now_ms.saturating_sub(model.requests.own_files_ms) >= OWN_FILES_MS {
                model.requests.own_files_ms = model.now_ms;
                effects.push(Effect::CheckOperatorFiles);
            }
            effects
        }
    }
}

/// Shows a sentence in the status line.
fn show_message(model: &mut ConsoleModel, text: impl Into<String>, bad: bool) {
    let text = text.into();
    model.key_log.note_text(&text, bad);
    // A long answer takes longer to read.
    let reading_ms = u64::try_from(text.len()).unwrap_or(u64::MAX).saturating_mul(NOTICE_BYTE_MS);
    let until_ms = model.now_ms.saturating_add(reading_ms.max(NOTICE_MS));
    model.notice = Some(ConsoleNotice { text, bad, until_ms });
}

/// Passes a key to typed text, an overlay, or the view.
fn on_key(model: &mut ConsoleModel, key: KeyEvent) -> Vec<Effect> {
    let in_prompt = matches!(model.input.overlay, Some(Overlay::Approval(_)));
    let action = model.keymap.action(key, in_prompt);
    // Stopping works everywhere, also while text is typed.
    let chord = key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT)
        || matches!(key.code, KeyCode::F(_));
    if let Some(action) = action.filter(|action| chord && action.works_while_typing()) {
        return act(model, action);
    }
    if model.input.typing.is_some() {
        return text_entry::key(model, key);
    }
    if belongs_to_refused_form(model, key, action) {
        return Vec::new();
    }
    match &model.input.overlay {
        Some(Overlay::Palette(_)) => overlays::palette_key(model, key),
        Some(Overlay::Approval(_)) => overlays::approval_key(model, key, action),
        Some(Overlay::Form(_)) => overlays::form_key(model, key, action),
        Some(Overlay::Why(_)) => why::why_key(model, key, action),
        Some(Overlay::Film(_)) => why::film_key(model, key, action),
        Some(Overlay::Replay(_)) => recording::key(model, key, action),
        Some(Overlay::KeyLog(_)) => key_log::log_key(model, action),
        Some(Overlay::Event(_)) => event_screen::key(model, action),
        None => {
            // A key that decides says what it needs: a passphrase may follow it.
            let action = action.or_else(|| model.keymap.action(key, true).filter(|action| action.decides()));
            action.map_or_else(Vec::new, |action| act(model, action))
        }
    }
}

/// Whether a key was typed for a field that did not open. It goes nowhere, unless it stops the arm. The first key after
/// a pause is a key again, and so is any key that types nothing.
fn belongs_to_refused_form(model: &mut ConsoleModel, key: KeyEvent, action: Option<Action>) -> bool {
    let is_open = model.input.overlay.is_some();
    if model.input.overlay.as_ref().is_some_and(Overlay::takes_text) {
        return false;
    }
    let Some(refused_form) = &mut model.input.refused_form else { return false };
    let is_typed = match key.code {
        KeyCode::Char(_) | KeyCode::Enter | KeyCode::Backspace => true,
        // In an open form it leads to a field.
        KeyCode::Tab => !is_open,
        _ => false,
    };
    if refused_form.key(model.now_ms) || !is_typed {
        model.input.refused_form = None;
        return false;
    }
    action != Some(Action::Stop)
}

/// Carries out an action in this view. If the action asks for a reason or a passphrase and nothing opened for it,
/// letters go nowhere for a moment: they may be that text.
fn act(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    model.key_log.note_action(action);
    let effects = carry_out(model, action);
    if (action.asks_for_reason() || action.decides()) && model.input.overlay.is_none() {
        swallow_text(model);
    }
    effects
}

/// Lets typed text go nowhere until a pause: the field for it did not open.
fn swallow_text(model: &mut ConsoleModel) {
    model.input.refused_form = Some(DismissedForm::new(String::new(), model.now_ms));
}

fn carry_out(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    if model.settings.read_only && action.changes_something() {
        show_message(model, wording::impossible_read_only(action.name()), true);
        return Vec::new();
    }
    let bare = model.bare_absence().is_some();
    if let Some(absence) = model.absence()
        && (if bare { !works_without_engine(action) } else { action.changes_something() && !brakes(action) })
    {
        return refuse(model, &absence.problem().sentence());
    }
    if action.aims_at_item() && navigation::has_slipped(model) {
        return refuse(model, wording::HAS_LEFT_THE_LIST);
    }
    match action {
        Action::Show(view) if view.description().is_about_version => show_about(model, view),
        Action::Show(view) => show(model, view),
        Action::JumpToAlarm => navigation::jump_to_alarm(model),
        Action::Help => {
            let bare = model.bare_absence().is_some();
            let actions = Action::ALL.iter().copied().filter(|action| {
                means_something(model.view_state.view, *action) && (!bare || works_without_engine(*action))
            });
            let mut actions: Vec<Action> = actions.collect();
            actions.sort_by_key(|action| help_rank(*action));
            model.input.overlay = Some(Overlay::Palette(Palette::new(actions)));
            Vec::new()
        }
        Action::CommandLine => text_entry::begin_command(model),
        Action::Filter => text_entry::begin_filter(model),
        Action::StateFilter => navigation::next_state_filter(model),
        Action::KeyLog => key_log::open(model),
        Action::Undo => undo::undo(model),
        Action::Back => back(model),
        Action::Detach => operations::detach(model),
        Action::Quit => operations::quit(model),
        Action::Suspend => {
            show_message(model, wording::NO_SUSPENDING, true);
            Vec::new()
        }
        Action::Tour => {
            model.settings.tour = if model.settings.tour.is_some() { None } else { Some(0) };
            Vec::new()
        }
        Action::NextTheme => next_theme(model),
        Action::Mouse => {
            model.settings.mouse = !model.settings.mouse;
            let text =
                if model.settings.mouse { wording::MOUSE_IS_OURS } else { wording::MOUSE_IS_THE_TERMINALS };
            show_message(model, text, false);
            vec![Effect::TakeMouse(model.settings.mouse)]
        }
        Action::Copy => match model.view_state.view.behavior().copied(model) {
            Some(text) => vec![Effect::Copy(text)],
            None => refuse(model, wording::NOTHING_TO_COPY),
        },
        Action::Export => vec![Effect::Export(model.view_state.view)],
        Action::OpenRecording => match model.version_here() {
            Some(version) => vec![Effect::OpenRecording(version)],
            // If nothing is evaluated, the cell itself is shown.
            None if model.view_state.view == View::Overview => vec![Effect::OpenLive],
            None => refuse(model, shared::NO_VERSION_HERE),
        },
        Action::OpenLive => vec![Effect::OpenLive],
        Action::Verify => engine_requests::verify(model),
        Action::Demo => engine_requests::register(model, None),
        Action::Up
        | Action::Down
        | Action::PageUp
        | Action::PageDown
        | Action::Top
        | Action::Bottom
        | Action::Left
        | Action::Right
        | Action::NextPane
        | Action::PreviousPane
        | Action::Open => navigation::go(model, action),
        Action::Sort | Action::SortReverse => navigation::sort(model, action),
        Action::FindNext => find_in_view::next(model),
        Action::Mark => selection::mark(model),
        Action::Stop => engine_requests::stop(model),
        Action::Go => cell_restart::go(model),
        Action::Abort
        | Action::Pause
        | Action::Resume
        | Action::Refuse
        | Action::Demote
        | Action::Rollback
        | Action::Restrict
        | Action::Repeat
        | Action::Release
        | Action::Continue
        | Action::Rearm
        | Action::Anchor => operations::on_version(model, action),
        Action::BreakGlass => operations::break_glass(model),
        Action::Acknowledge | Action::Shelve | Action::Unshelve | Action::ResetAlarm => {
            operations::on_alarm(model, action)
        }
        Action::Freeze => freeze(model),
        Action::ZoomIn | Action::ZoomOut | Action::ZoomReset => {
            model.view_state.view.behavior().zoom(model, action)
        }
        // Without an open prompt these decide nothing.
        Action::Approve | Action::Reject | Action::Reread => refuse(model, wording::OPEN_THE_APPROVAL),
    }
}

/// Whether an action works before any engine has been connected.
const fn works_without_engine(action: Action) -> bool {
    matches!(
        action,
        Action::Stop
            | Action::Detach
            | Action::Quit
            | Action::Help
            | Action::CommandLine
            | Action::Back
            | Action::NextTheme
            | Action::Mouse
            | Action::Suspend
    )
}

/// Whether an action stops or tightens an active version: it goes to any running engine.
const fn brakes(action: Action) -> bool {
    matches!(action, Action::Abort | Action::Pause | Action::Rollback | Action::Restrict)
}

/// Whether an action belongs into a view's help.
#[must_use]
pub fn means_something(view: View, action: Action) -> bool {
    use super::action::Scope;
    match action.scope() {
        Scope::Everywhere | Scope::Lists => true,
        scope @ (Scope::Version | Scope::Alarms | Scope::Charts) => {
            view.description().scopes.contains(&scope)
        }
        Scope::Prompt => false,
    }
}

/// The order of the help: the keys of this view come before those of every view. The first row changes nothing, because
/// Enter runs it.
const fn help_rank(action: Action) -> u8 {
    use super::action::Scope;
    match (action, action.scope()) {
        (Action::Help, _) => 0,
        (Action::Stop | Action::Go | Action::Abort, _)
        | (_, Scope::Version | Scope::Alarms | Scope::Charts | Scope::Prompt) => 1,
        (_, Scope::Lists) => 2,
        (_, Scope::Everywhere) => 3,
    }
}

pub(super) fn refuse(model: &mut ConsoleModel, why: &str) -> Vec<Effect> {
    show_message(model, why, true);
    Vec::new()
}

/// Goes to a view and requests its data.
pub(super) fn show(model: &mut ConsoleModel, view: View) -> Vec<Effect> {
    if model.view_state.view != view {
        model.view_state.back.retain(|known| *known != model.view_state.view);
        model.view_state.back.push(model.view_state.view);
        if model.view_state.back.len() > BACK_MAX {
            model.view_state.back.remove(0);
        }
        model.view_state.view = view;
        model.view_state.opened = None;
    }
    engine_requests::refresh_now(model)
}

/// A view of one version: of the one under the cursor, if there is one. The row of a family stands for its active
/// version; without one, the view would be about a version elsewhere.
fn show_about(model: &mut ConsoleModel, view: View) -> Vec<Effect> {
    if let Some(version) = model.version_here() {
        model.view_state.chosen = Some(version);
    } else if let Some(family) = navigation::family_here(model) {
        return refuse(model, &wording::no_active_version(&family));
    }
    show(model, view)
}

fn back(model: &mut ConsoleModel) -> Vec<Effect> {
    if model.view_state.view == View::Audit && model.view_state.opened.take().is_some() {
        return Vec::new();
    }
    if selection::clear(model) {
        show_message(model, wording::NOTHING_MARKED_ANY_MORE, false);
        return Vec::new();
    }
    if model.view_state.set_filter(String::new()) {
        return engine_requests::refresh_now(model);
    }
    if model.view_state.lists_versions() && model.view_state.state_filter != StateFilter::All {
        return navigation::filter_by_state(model, StateFilter::All);
    }
    match model.view_state.back.pop() {
        Some(view) => {
            model.view_state.view = view;
            engine_requests::refresh_now(model)
        }
        None => {
            model.notice = None;
            // Once the engine answers again, a failed stop does not block its restart.
            let data = &mut model.engine_data;
            let snapshot_ms = data.snapshot_ms;
            data.pending_stop.take_if(|stop| stop.why.is_some() && snapshot_ms > stop.since_ms);
            Vec::new()
        }
    }
}

fn next_theme(model: &mut ConsoleModel) -> Vec<Effect> {
    let at = model.themes.iter().position(|name| *name == model.settings.theme);
    let next = at.map_or(0, |at| at + 1) % model.themes.len().max(1);
    model.themes.get(next).map(|name| Effect::UseTheme(name.clone())).into_iter().collect()
}

fn freeze(model: &mut ConsoleModel) -> Vec<Effect> {
    model.view_state.frozen = match (&model.view_state.frozen, &model.engine_data.snapshot) {
        (None, Some(snapshot)) => Some(FrozenView {
            at_ms: model.engine_ms(),
            snapshot: snapshot.clone(),
            event_log: model.engine_data.events.clone(),
        }),
        (Some(_), _) | (None, None) => None,
    };
    Vec::new()
}

/// Halves or doubles the range of the charts, or shows all of it.
pub(super) fn zoom(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    let halvings = model.view_state.zoom;
    let halvings = match action {
        Action::ZoomIn => halvings.saturating_add(1),
        Action::ZoomOut => halvings.saturating_sub(1),
        _ => 0,
    };
    model.view_state.zoom = halvings.min(ZOOM_MAX);
    Vec::new()
}

#[cfg(test)]
mod tests;
