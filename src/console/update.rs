//! The reducer: a model and something that happened give a changed model and what is to be done.
//!
//! Pure: no clock, no terminal, no engine. Everything an operator can do passes here, so what can never happen
//! (a reflex key that approves, an approval over stale evidence) is a table test beside it.

mod asking;
mod clicking;
mod engine;
mod finding;
mod halted;
mod health;
mod marking;
mod moving;
mod operating;
mod overlays;
pub mod possible;
mod seating;
mod typing;
mod why;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

pub(super) use typing::into_line;

use super::action::Action;
use super::effect::Effect;
use super::model::{Frozen, Model, NOTICE_BYTE_MS, NOTICE_MS, Notice, Overlay, View};
use super::msg::{Msg, MsgKind};
use super::palette::Palette;
use holdpoint_text::Hint as _;

/// Halvings of a chart's range at most.
const ZOOM_MAX: u8 = 6;

/// How often the operator's own files are looked at, ms.
const OWN_FILES_MS: u64 = 2_000;

/// Views remembered for the way back.
const BACK_MAX: usize = 16;

/// Takes in what happened. The cursor stays on its item, wherever that is afterwards.
pub fn update(model: &mut Model, msg: Msg) -> Vec<Effect> {
    let by_itself = match &msg.what {
        // These change no list.
        MsgKind::Tick
        | MsgKind::Picture(_)
        | MsgKind::Resize(..)
        | MsgKind::Theme(_)
        | MsgKind::OwnFiles { .. }
        | MsgKind::Completions { .. }
        | MsgKind::DecisionShown(_) => None,
        MsgKind::Key(_) | MsgKind::Paste(_) | MsgKind::Wheel(_) | MsgKind::Click(..) => Some(false),
        MsgKind::EngineStarted
        | MsgKind::Events(_)
        | MsgKind::Past { .. }
        | MsgKind::Seated(..)
        | MsgKind::Sought(_)
        | MsgKind::Answer { .. }
        | MsgKind::Lagged(_)
        | MsgKind::Snapshot(_)
        | MsgKind::EngineEnded(_)
        | MsgKind::Identities(_)
        | MsgKind::Operator(_)
        | MsgKind::Done { .. }
        | MsgKind::NoIdentity { .. }
        | MsgKind::Unsigned { .. }
        | MsgKind::EndAsked => Some(true),
    };
    let mut effects = take_in(model, msg);
    effects.extend(asking::question(model));
    if let Some(by_itself) = by_itself {
        moving::follow(model, by_itself);
    }
    effects
}

fn take_in(model: &mut Model, msg: Msg) -> Vec<Effect> {
    model.now_ms = model.now_ms.max(msg.now_ms);
    if model.notice.as_ref().is_some_and(|notice| notice.until_ms <= model.now_ms) {
        model.notice = None;
    }
    match msg.what {
        MsgKind::Key(key) if key.kind == KeyEventKind::Release => Vec::new(),
        MsgKind::Key(key) => on_key(model, key),
        MsgKind::Paste(text) => typing::paste(model, &text),
        MsgKind::Wheel(rows) => moving::wheel(model, rows),
        MsgKind::Click(column, row) => clicking::click(model, column, row),
        MsgKind::Resize(columns, rows) => {
            model.size = (columns, rows);
            Vec::new()
        }
        MsgKind::EngineStarted => engine::started(model),
        MsgKind::Events(events) => engine::events(model, events),
        MsgKind::Past { events, earlier } => engine::past(model, &events, earlier),
        MsgKind::Seated(process, doubt) => engine::seated(model, process, doubt),
        MsgKind::Sought(seeking) => {
            model.told.seeking = Some(seeking);
            Vec::new()
        }
        MsgKind::Answer { id, reply } => engine::answer(model, &id, *reply),
        MsgKind::Lagged(missed) => {
            model.told.missed = model.told.missed.saturating_add(missed);
            model.asking.changes += 1;
            Vec::new()
        }
        MsgKind::Snapshot(snapshot) => engine::snapshot(model, snapshot),
        MsgKind::Picture(picture) => {
            model.told.framing.see(&picture);
            model.told.picture = Some(picture);
            Vec::new()
        }
        MsgKind::EngineEnded(how) => engine::ended(model, how),
        MsgKind::Identities(identities) => {
            model.seat.identities = identities;
            Vec::new()
        }
        MsgKind::Operator(operator) => {
            model.seat.wanted = None;
            tell(model, format!("{} ({}) sits here now", operator.name, operator.role), false);
            model.seat.operator = Some(operator);
            Vec::new()
        }
        MsgKind::Done { text, bad } => {
            tell(model, text, bad);
            Vec::new()
        }
        MsgKind::NoIdentity { name, text } => seating::nobody(model, name, text),
        MsgKind::Completions { typed, lines } => {
            typing::offer(model, typed, lines);
            Vec::new()
        }
        MsgKind::Theme(name) => {
            model.settings.theme = name;
            Vec::new()
        }
        MsgKind::Unsigned { id, text } => {
            overlays::unsigned(model, &id, text);
            Vec::new()
        }
        MsgKind::DecisionShown(seen) => {
            match &mut model.entry.overlay {
                Some(Overlay::Prompt(prompt)) => prompt.saw(&seen),
                Some(Overlay::Form(form)) => form.saw(&seen),
                Some(Overlay::Palette(_) | Overlay::Why(_) | Overlay::Film(_)) | None => {}
            }
            Vec::new()
        }
        MsgKind::EndAsked => vec![Effect::End],
        MsgKind::OwnFiles { keymap, themes } => {
            (model.keymap, model.themes) = (keymap, themes);
            tell(model, "keys and themes were read anew: their files changed", false);
            Vec::new()
        }
        MsgKind::Tick => {
            why::pass(model);
            let mut effects = asking::refresh(model);
            if model.now_ms.saturating_sub(model.asking.own_files_ms) >= OWN_FILES_MS {
                model.asking.own_files_ms = model.now_ms;
                effects.push(Effect::LookAtOwnFiles);
            }
            effects
        }
    }
}

/// Puts a sentence into the status line.
fn tell(model: &mut Model, text: impl Into<String>, bad: bool) {
    let text = text.into();
    // A long answer takes longer to read.
    let reading_ms = u64::try_from(text.len()).unwrap_or(u64::MAX).saturating_mul(NOTICE_BYTE_MS);
    let until_ms = model.now_ms.saturating_add(reading_ms.max(NOTICE_MS));
    model.notice = Some(Notice { text, bad, until_ms });
}

/// A key goes to what has the keys: typed text, an overlay, the view.
fn on_key(model: &mut Model, key: KeyEvent) -> Vec<Effect> {
    let in_prompt = matches!(model.entry.overlay, Some(Overlay::Prompt(_)));
    let action = model.keymap.action(key, in_prompt);
    // Stopping works everywhere, also while text is typed.
    let chord = key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT)
        || matches!(key.code, KeyCode::F(_));
    if let Some(action) = action.filter(|action| chord && action.works_while_typing()) {
        return act(model, action);
    }
    if model.entry.typing.is_some() {
        return typing::key(model, key);
    }
    match &model.entry.overlay {
        Some(Overlay::Palette(_)) => overlays::palette_key(model, key),
        Some(Overlay::Prompt(_)) => overlays::prompt_key(model, key, action),
        Some(Overlay::Form(_)) => overlays::form_key(model, key, action),
        Some(Overlay::Why(_)) => why::why_key(model, key, action),
        Some(Overlay::Film(_)) => why::film_key(model, key, action),
        None => action.map_or_else(Vec::new, |action| act(model, action)),
    }
}

/// Does what an action means in this view.
fn act(model: &mut Model, action: Action) -> Vec<Effect> {
    if model.settings.read_only && action.changes_something() {
        tell(model, format!("{:?} is not possible: this console is read-only", action.word()), true);
        return Vec::new();
    }
    let bare = model.bare_absence().is_some();
    if let Some(absence) = model.absence()
        && (if bare { !works_without_engine(action) } else { action.changes_something() && !brakes(action) })
    {
        return refuse(model, &absence.problem().sentence());
    }
    if action.aims_at_item() && moving::has_slipped(model) {
        return refuse(
            model,
            "what was under the cursor has just left the list: look again, then press the key",
        );
    }
    match action {
        Action::ShowOverview => show(model, View::Overview),
        Action::ShowRegistry => show(model, View::Registry),
        Action::ShowCandidate => show_about(model, View::Candidate),
        Action::ShowShadow => show_about(model, View::Shadow),
        Action::ShowAlarms => show(model, View::Alarms),
        Action::ShowApprovals => show(model, View::Approvals),
        Action::ShowAudit => show(model, View::Audit),
        Action::ShowHealth => show(model, View::Health),
        Action::JumpToAlarm => moving::jump_to_alarm(model),
        Action::Help => {
            let bare = model.bare_absence().is_some();
            let actions = Action::ALL.iter().copied().filter(|action| {
                means_something(model.place.view, *action) && (!bare || works_without_engine(*action))
            });
            model.entry.overlay = Some(Overlay::Palette(Palette::new(actions.collect())));
            Vec::new()
        }
        Action::CommandLine => typing::begin_command(model),
        Action::Filter => typing::begin_filter(model),
        Action::Back => back(model),
        Action::Detach => operating::detach(model),
        Action::Quit => operating::quit(model),
        Action::Suspend => {
            tell(model, "suspending would stop the monitors; `:quit` ends in good order", true);
            Vec::new()
        }
        Action::Tour => {
            model.settings.tour = if model.settings.tour.is_some() { None } else { Some(0) };
            Vec::new()
        }
        Action::NextTheme => next_theme(model),
        Action::Mouse => {
            model.settings.mouse = !model.settings.mouse;
            let text = if model.settings.mouse {
                "the mouse is this console's: it clicks and turns here"
            } else {
                "the mouse is the terminal's again: it marks text there"
            };
            tell(model, text, false);
            vec![Effect::TakeMouse(model.settings.mouse)]
        }
        Action::Copy => match moving::copied(model) {
            Some(text) => vec![Effect::Copy(text)],
            None => refuse(model, "there is nothing under the cursor to copy"),
        },
        Action::Export => vec![Effect::Export(model.place.view)],
        Action::OpenRecording => match model.version_here() {
            Some(version) => vec![Effect::OpenRecording(version)],
            // If nothing is evaluated the cell itself is what there is to look at.
            None if model.place.view == View::Overview => vec![Effect::OpenLive],
            None => refuse(model, "there is no version under the cursor"),
        },
        Action::OpenLive => vec![Effect::OpenLive],
        Action::Verify => asking::verify(model),
        Action::Demo => asking::register(model, None),
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
        | Action::Open => moving::go(model, action),
        Action::Sort | Action::SortReverse => moving::sort(model, action),
        Action::FindNext => finding::next(model),
        Action::Mark => marking::mark(model),
        Action::Stop => asking::stop(model),
        Action::Go => halted::go(model),
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
        | Action::Rearm => operating::on_version(model, action),
        Action::BreakGlass => operating::break_glass(model),
        Action::Acknowledge | Action::Shelve | Action::Unshelve | Action::ResetAlarm => {
            operating::on_alarm(model, action)
        }
        Action::Freeze => freeze(model),
        Action::ZoomIn | Action::ZoomOut | Action::ZoomReset if model.place.view == View::Health => {
            health::zoom(model, action)
        }
        Action::ZoomIn => zoom(model, model.place.zoom.saturating_add(1)),
        Action::ZoomOut => zoom(model, model.place.zoom.saturating_sub(1)),
        Action::ZoomReset => zoom(model, 0),
        // Without an open prompt these decide nothing.
        Action::Approve | Action::Reject | Action::Reread => {
            refuse(model, "open the waiting approval first (a, then Enter)")
        }
    }
}

/// Whether an action does something where no engine is at work and nothing was ever told.
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

/// Whether an action stops or tightens what acts: asked of whatever engine is at work.
const fn brakes(action: Action) -> bool {
    matches!(action, Action::Abort | Action::Pause | Action::Rollback | Action::Restrict)
}

/// Whether an action belongs into a view's help.
#[must_use]
pub fn means_something(view: View, action: Action) -> bool {
    use super::action::Scope;
    match action.scope() {
        Scope::Everywhere | Scope::Lists => true,
        Scope::Version => view != View::Alarms,
        Scope::Alarms => view == View::Alarms,
        Scope::Charts => matches!(view, View::Shadow | View::Overview | View::Health),
        Scope::Prompt => false,
    }
}

fn refuse(model: &mut Model, why: &str) -> Vec<Effect> {
    tell(model, why, true);
    Vec::new()
}

/// Goes to a view and asks for what it shows.
fn show(model: &mut Model, view: View) -> Vec<Effect> {
    if model.place.view != view {
        model.place.back.retain(|known| *known != model.place.view);
        model.place.back.push(model.place.view);
        if model.place.back.len() > BACK_MAX {
            model.place.back.remove(0);
        }
        model.place.view = view;
        model.place.opened = None;
    }
    asking::refresh_now(model)
}

/// A view of one version: of the one under the cursor, if there is one.
fn show_about(model: &mut Model, view: View) -> Vec<Effect> {
    if let Some(version) = model.version_here() {
        model.place.chosen = Some(version);
    }
    show(model, view)
}

fn back(model: &mut Model) -> Vec<Effect> {
    if model.place.view == View::Audit && model.place.opened.take().is_some() {
        return Vec::new();
    }
    if marking::clear(model) {
        tell(model, "nothing is marked any more", false);
        return Vec::new();
    }
    if model.place.set_filter(String::new()) {
        return asking::refresh_now(model);
    }
    match model.place.back.pop() {
        Some(view) => {
            model.place.view = view;
            asking::refresh_now(model)
        }
        None => {
            model.notice = None;
            // Nobody is kept from going on by a stop that came to nothing, once the engine is heard again.
            let told = &mut model.told;
            let heard_ms = told.snapshot_ms;
            told.stop_asked.take_if(|asked| asked.why.is_some() && heard_ms > asked.since_ms);
            Vec::new()
        }
    }
}

fn next_theme(model: &mut Model) -> Vec<Effect> {
    let at = model.themes.iter().position(|name| *name == model.settings.theme);
    let next = at.map_or(0, |at| at + 1) % model.themes.len().max(1);
    model.themes.get(next).map(|name| Effect::UseTheme(name.clone())).into_iter().collect()
}

fn freeze(model: &mut Model) -> Vec<Effect> {
    model.place.frozen = match (&model.place.frozen, &model.told.snapshot) {
        (None, Some(snapshot)) => Some(Frozen {
            at_ms: model.engine_ms(),
            snapshot: snapshot.clone(),
            story: model.told.story.clone(),
        }),
        (Some(_), _) | (None, None) => None,
    };
    Vec::new()
}

const fn zoom(model: &mut Model, halvings: u8) -> Vec<Effect> {
    model.place.zoom = if halvings > ZOOM_MAX { ZOOM_MAX } else { halvings };
    Vec::new()
}

#[cfg(test)]
mod tests;
