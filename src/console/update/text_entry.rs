//! Text at the foot of the screen: the command line and the filter.

use std::collections::BTreeSet;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use tui_input::InputRequest;

use super::{act, engine_requests, find_in_view, show, show_message};
use crate::commands::{self, ConsoleCommand};
use crate::effect::{Effect, EngineQuery};
use crate::line::EditLine;
use crate::model::{CompletionMenu, ConsoleModel, Overlay, Typing, View};
use holdpoint_wording::console::shared;
use holdpoint_wording::console::text_entry as wording;

const HISTORY_MAX: usize = 100;

/// The most lines of a menu.
const COMPLETIONS_MAX: usize = 200;

pub(super) fn begin_command(model: &mut ConsoleModel) -> Vec<Effect> {
    model.input.typing = Some(Typing::Command(EditLine::default()));
    Vec::new()
}

/// Filters narrow long lists. Alarms, waiting requests and decisions are never narrowed: there the cursor moves to
/// the typed text. The line begins empty; Up brings the last text back.
pub(super) fn begin_filter(model: &mut ConsoleModel) -> Vec<Effect> {
    let line = EditLine::default();
    let narrows = model.view_state.view.behavior().is_filtered(model);
    model.input.typing = Some(if narrows { Typing::Filter(line) } else { Typing::Find(line) });
    Vec::new()
}

/// The effect of a key on a line, if it edits.
pub(super) const fn edit(key: KeyEvent) -> Option<InputRequest> {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match (key.code, control) {
        (KeyCode::Backspace, false) => InputRequest::DeletePrevChar,
        (KeyCode::Delete, _) => InputRequest::DeleteNextChar,
        (KeyCode::Left, false) => InputRequest::GoToPrevChar,
        (KeyCode::Right, false) => InputRequest::GoToNextChar,
        (KeyCode::Left, true) => InputRequest::GoToPrevWord,
        (KeyCode::Right, true) => InputRequest::GoToNextWord,
        (KeyCode::Home, _) | (KeyCode::Char('a'), true) => InputRequest::GoToStart,
        (KeyCode::End, _) | (KeyCode::Char('e'), true) => InputRequest::GoToEnd,
        (KeyCode::Backspace | KeyCode::Char('w'), true) => InputRequest::DeletePrevWord,
        (KeyCode::Char('u'), true) => InputRequest::DeleteLine,
        (KeyCode::Char('k'), true) => InputRequest::DeleteTillEnd,
        _ => return None,
    })
}

/// Types a key into a line. Returns false if the key neither is text nor edits.
pub(crate) fn into_line(line: &mut EditLine, key: KeyEvent) -> bool {
    if let Some(request) = edit(key) {
        line.edit(request);
        return true;
    }
    match key.code {
        KeyCode::Char(typed) if !key.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT) => {
            line.insert(typed);
            true
        }
        _ => false,
    }
}

pub(super) fn key(model: &mut ConsoleModel, key: KeyEvent) -> Vec<Effect> {
    let cancels = key.code == KeyCode::Esc
        || (key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL));
    let menu = model.input.menu.take();
    if cancels {
        // Leaves the menu first: the typed text is restored.
        model.input.typing = menu.map(|menu| Typing::Command(EditLine::new(&menu.typed)));
        return Vec::new();
    }
    match key.code {
        KeyCode::Enter => return finish(model),
        KeyCode::Tab => return complete(model, menu, true),
        KeyCode::BackTab => return complete(model, menu, false),
        KeyCode::Up => recall(model, true),
        KeyCode::Down => recall(model, false),
        _ => {
            let Some(Typing::Command(line) | Typing::Filter(line) | Typing::Find(line)) =
                &mut model.input.typing
            else {
                return Vec::new();
            };
            // Deleting in an empty line leaves it.
            if key.code == KeyCode::Backspace && line.text().is_empty() {
                model.input.typing = None;
            } else {
                into_line(line, key);
            }
            find_in_view::look(model);
        }
    }
    Vec::new()
}

fn finish(model: &mut ConsoleModel) -> Vec<Effect> {
    match model.input.typing.take() {
        None => Vec::new(),
        Some(Typing::Find(line)) => {
            line.text().clone_into(&mut model.view_state.search);
            if !find_in_view::is_there(model, line.text()) {
                show_message(model, shared::not_in_this_list(line.text()), true);
            }
            Vec::new()
        }
        Some(Typing::Filter(line)) => {
            let text = line.text().trim().to_owned();
            if !text.is_empty() {
                // The same text can be found in the other lists.
                model.view_state.search.clone_from(&text);
            }
            model.view_state.set_filter(text);
            Vec::new()
        }
        Some(Typing::Command(line)) => {
            let text = line.text().trim().to_owned();
            if text.is_empty() {
                return Vec::new();
            }
            model.input.history.retain(|known| *known != text);
            model.input.history.push(text.clone());
            if model.input.history.len() > HISTORY_MAX {
                model.input.history.remove(0);
            }
            model.key_log.note_command(&text);
            match commands::parse(&text) {
                Ok(command) => run(model, command),
                Err(why) => {
                    show_message(model, why, true);
                    Vec::new()
                }
            }
        }
    }
}

fn run(model: &mut ConsoleModel, command: ConsoleCommand) -> Vec<Effect> {
    if model.settings.read_only && command.changes_something() {
        show_message(model, shared::READ_ONLY, true);
        return Vec::new();
    }
    match command {
        ConsoleCommand::Action(action) => act(model, action),
        ConsoleCommand::Demo(name) => engine_requests::register(model, name),
        ConsoleCommand::Register(folder) => engine_requests::register(model, Some(folder)),
        ConsoleCommand::As(name) => {
            model.session.requested_name = Some(name.clone());
            vec![Effect::UseIdentity(name)]
        }
        ConsoleCommand::Theme(name) => {
            if model.themes.contains(&name) {
                return vec![Effect::UseTheme(name)];
            }
            let known = model.themes.join(", ");
            show_message(model, wording::no_such_theme(&name, &known), true);
            Vec::new()
        }
        ConsoleCommand::StateFilter(filter) => super::navigation::filter_by_state(model, filter),
        ConsoleCommand::Pace(times) => {
            engine_requests::send_query(model, wording::CHANGE_THE_PACE.to_owned(), EngineQuery::Pace(times))
        }
        ConsoleCommand::PaceNow => {
            let pace = model.engine_data.snapshot.as_ref().map(|now| now.live.pace);
            let text = match pace {
                None => wording::NO_PACE_YET.to_owned(),
                Some(times) => wording::pace(times),
            };
            show_message(model, text, false);
            Vec::new()
        }
        ConsoleCommand::Drift(drift) => {
            let question = EngineQuery::Drift(drift);
            engine_requests::send_query(model, wording::LET_A_DRIFT_SET_IN.to_owned(), question)
        }
        ConsoleCommand::Profile(profile, close) => super::operations::on_profile(model, profile, close),
        ConsoleCommand::Goal(goal) => super::operations::goal(model, goal),
        ConsoleCommand::ConfirmTime => super::operations::confirm_time(model),
        ConsoleCommand::Note(text) => super::operations::note(model, &text),
        ConsoleCommand::Candidate(version) => {
            model.view_state.chosen = Some(version);
            show(model, View::Candidate)
        }
    }
}

/// Tab: the first completion of the line, then the next one, in a circle.
fn complete(model: &mut ConsoleModel, menu: Option<CompletionMenu>, forward: bool) -> Vec<Effect> {
    let Some(Typing::Command(line)) = &model.input.typing else { return Vec::new() };
    if let Some(menu) = menu {
        let count = menu.lines.len().max(1);
        let at = if forward { menu.at + 1 } else { menu.at + count - 1 } % count;
        put(model, CompletionMenu { at, ..menu });
        return Vec::new();
    }
    let typed = line.text().to_owned();
    if let Some(path) = commands::path_of(&typed) {
        return vec![Effect::ReadFolder { typed: typed.clone(), path: path.to_owned() }];
    }
    let snapshot = model.engine_data.snapshot.iter();
    let candidates = snapshot.flat_map(|snapshot| &snapshot.candidates).map(|one| &one.version);
    let listed = model.engine_data.registry.page.rows.iter().map(|row| &row.version);
    let versions: BTreeSet<String> = candidates.chain(listed).map(ToString::to_string).collect();
    let versions: Vec<String> = versions.into_iter().collect();
    let people: Vec<String> = model.session.identities.iter().map(|who| who.name.clone()).collect();
    let known = commands::KnownNames { versions: &versions, people: &people, themes: &model.themes };
    offer(model, typed.clone(), commands::complete(&typed, &known));
    Vec::new()
}

/// Offers completions of a line, unless it changed meanwhile.
pub(super) fn offer(model: &mut ConsoleModel, typed: String, mut lines: Vec<String>) {
    let Some(Typing::Command(line)) = &model.input.typing else { return };
    // A complete name stays before longer ones: one key too many must not select another command.
    if let Some(at) = lines.iter().position(|line| *line == typed) {
        lines[..=at].rotate_right(1);
    }
    lines.truncate(COMPLETIONS_MAX);
    if line.text() == typed && !lines.is_empty() {
        put(model, CompletionMenu { typed, lines, at: 0 });
    }
}

/// Puts the menu's current entry into the line. A single entry needs no menu.
fn put(model: &mut ConsoleModel, menu: CompletionMenu) {
    if let Some(text) = menu.lines.get(menu.at) {
        model.input.typing = Some(Typing::Command(EditLine::new(text)));
    }
    model.input.menu = Some(menu).filter(|menu| menu.lines.len() > 1);
}

/// An earlier or a later command line; earlier than an empty filter or search, the last text of either.
fn recall(model: &mut ConsoleModel, earlier: bool) {
    if let Some(Typing::Filter(line) | Typing::Find(line)) = &mut model.input.typing {
        if earlier && line.text().is_empty() {
            *line = EditLine::new(&model.view_state.search);
            find_in_view::look(model);
        }
        return;
    }
    let Some(Typing::Command(line)) = &model.input.typing else { return };
    let at = model.input.history.iter().position(|known| known == line.text());
    let place = match (at, earlier) {
        (Some(at), true) => at.checked_sub(1),
        (Some(at), false) => Some(at + 1),
        (None, true) => model.input.history.len().checked_sub(1),
        (None, false) => None,
    };
    let recalled = place.and_then(|place| model.input.history.get(place));
    if let Some(text) = recalled {
        model.input.typing = Some(Typing::Command(EditLine::new(text)));
    } else if !earlier {
        model.input.typing = Some(Typing::Command(EditLine::default()));
    }
}

/// Pasted text is only text: it runs nothing, and a prompt accepts none.
pub(super) fn paste(model: &mut ConsoleModel, text: &str) -> Vec<Effect> {
    model.input.menu = None;
    match (&mut model.input.typing, &mut model.input.overlay) {
        (Some(Typing::Command(line) | Typing::Filter(line) | Typing::Find(line)), _) => line.paste(text),
        (None, Some(Overlay::Palette(palette))) => {
            palette.line.paste(text);
            palette.cursor = 0;
        }
        (None, Some(Overlay::Form(form))) => {
            if let Some(signing) = &mut form.signing {
                signing.paste(text);
            } else if let Some(line) = form.line_mut() {
                line.paste(text);
            } else {
                show_message(model, wording::PASTE_IGNORED, false);
            }
        }
        (None, Some(Overlay::Approval(prompt))) if prompt.signing.is_some() => {
            if let Some(signing) = &mut prompt.signing {
                signing.paste(text);
            }
        }
        (None, Some(Overlay::Approval(_))) => {
            show_message(model, wording::NO_PASTE_IN_A_PROMPT, true);
        }
        (None, Some(Overlay::Replay(replay))) if replay.typing.is_some() => {
            if let Some(line) = &mut replay.typing {
                line.paste(text);
            }
        }
        (
            None,
            Some(
                Overlay::Why(_)
                | Overlay::Film(_)
                | Overlay::Replay(_)
                | Overlay::KeyLog(_)
                | Overlay::Event(_),
            )
            | None,
        ) => {
            show_message(model, wording::PASTE_IGNORED, false);
        }
    }
    Vec::new()
}
