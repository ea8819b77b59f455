//! Text at the foot of the screen: the command line and the filter.

use std::collections::BTreeSet;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use tui_input::InputRequest;

use super::{act, asking, finding, show, tell};
use crate::commands::{self, Asked};
use crate::effect::{Effect, Question};
use crate::line::EditLine;
use crate::model::{CompletionMenu, Model, Overlay, Typing, View};

const HISTORY_MAX: usize = 100;

/// Lines that a menu offers at most.
const COMPLETIONS_MAX: usize = 200;

pub(super) fn begin_command(model: &mut Model) -> Vec<Effect> {
    model.entry.typing = Some(Typing::Command(EditLine::default()));
    Vec::new()
}

/// Filters narrow what can be long; alarms, what waits and what decided are never narrowed: there the cursor goes to
/// what is typed.
pub(super) fn begin_filter(model: &mut Model) -> Vec<Effect> {
    model.entry.typing = Some(match model.place.view {
        View::Audit if model.place.opened.is_some() => Typing::Find(EditLine::default()),
        View::Overview | View::Registry | View::Audit => Typing::Filter(EditLine::new(model.place.filter())),
        View::Candidate | View::Shadow | View::Alarms | View::Approvals | View::Health => {
            Typing::Find(EditLine::default())
        }
    });
    Vec::new()
}

/// What a key does to a line, if it edits.
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

/// Types a key into a line. False if the key is no text and edits nothing.
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

pub(super) fn key(model: &mut Model, key: KeyEvent) -> Vec<Effect> {
    let cancels = key.code == KeyCode::Esc
        || (key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL));
    let menu = model.entry.menu.take();
    if cancels {
        // Out of the menu first: what was typed stands there again.
        model.entry.typing = menu.map(|menu| Typing::Command(EditLine::new(&menu.typed)));
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
                &mut model.entry.typing
            else {
                return Vec::new();
            };
            // Deleting in an empty line leaves it.
            if key.code == KeyCode::Backspace && line.text().is_empty() {
                model.entry.typing = None;
            } else {
                into_line(line, key);
            }
            finding::look(model);
        }
    }
    Vec::new()
}

fn finish(model: &mut Model) -> Vec<Effect> {
    match model.entry.typing.take() {
        None => Vec::new(),
        Some(Typing::Find(line)) => {
            line.text().clone_into(&mut model.place.sought);
            if !finding::is_there(model, line.text()) {
                tell(model, format!("{:?} is not in this list", line.text()), true);
            }
            Vec::new()
        }
        Some(Typing::Filter(line)) => {
            let text = line.text().trim().to_owned();
            model.place.set_filter(text);
            Vec::new()
        }
        Some(Typing::Command(line)) => {
            let text = line.text().trim().to_owned();
            if text.is_empty() {
                return Vec::new();
            }
            model.entry.history.retain(|known| *known != text);
            model.entry.history.push(text.clone());
            if model.entry.history.len() > HISTORY_MAX {
                model.entry.history.remove(0);
            }
            match commands::parse(&text) {
                Ok(asked) => run(model, asked),
                Err(why) => {
                    tell(model, why, true);
                    Vec::new()
                }
            }
        }
    }
}

fn run(model: &mut Model, asked: Asked) -> Vec<Effect> {
    if model.settings.read_only && asked.changes_something() {
        tell(model, "this console is read-only", true);
        return Vec::new();
    }
    match asked {
        Asked::Action(action) => act(model, action),
        Asked::Demo(name) => asking::register(model, name),
        Asked::Register(folder) => asking::register(model, Some(folder)),
        Asked::As(name) => {
            model.seat.wanted = Some(name.clone());
            vec![Effect::UseIdentity(name)]
        }
        Asked::Theme(name) => {
            if model.themes.contains(&name) {
                return vec![Effect::UseTheme(name)];
            }
            let known = model.themes.join(", ");
            tell(model, format!("there is no theme {name:?}; there are {known}"), true);
            Vec::new()
        }
        Asked::Pace(times) => asking::ask(model, "change the pace".to_owned(), Question::Pace(times)),
        Asked::PaceNow => {
            let pace = model.told.snapshot.as_ref().map(|now| now.live.pace);
            let text = match pace {
                None => "no engine has told a pace yet".to_owned(),
                Some(None) => "the live cell works as fast as it computes; `:pace N` changes it".to_owned(),
                Some(Some(times)) => {
                    format!("the live cell works {times} simulated seconds in a second; `:pace N` changes it")
                }
            };
            tell(model, text, false);
            Vec::new()
        }
        Asked::Drift(drift) => {
            let question = Question::Drift(drift);
            asking::ask(model, "let a drift set in".to_owned(), question)
        }
        Asked::Profile(profile, close) => super::operating::on_profile(model, profile, close),
        Asked::Goal(goal) => super::operating::goal(model, goal),
        Asked::ConfirmTime => super::operating::confirm_time(model),
        Asked::Note(text) => super::operating::note(model, &text),
        Asked::Candidate(version) => {
            model.place.chosen = Some(version);
            show(model, View::Candidate)
        }
    }
}

/// Tab: the first thing that the line could become, then the next one, round and round.
fn complete(model: &mut Model, menu: Option<CompletionMenu>, forward: bool) -> Vec<Effect> {
    let Some(Typing::Command(line)) = &model.entry.typing else { return Vec::new() };
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
    let snapshot = model.told.snapshot.iter();
    let candidates = snapshot.flat_map(|snapshot| &snapshot.candidates).map(|one| &one.version);
    let listed = model.told.registry.page.rows.iter().map(|row| &row.version);
    let versions: BTreeSet<String> = candidates.chain(listed).map(ToString::to_string).collect();
    let versions: Vec<String> = versions.into_iter().collect();
    let people: Vec<String> = model.seat.identities.iter().map(|who| who.name.clone()).collect();
    let known = commands::KnownNames { versions: &versions, people: &people, themes: &model.themes };
    offer(model, typed.clone(), commands::complete(&typed, &known));
    Vec::new()
}

/// What a line could become, unless something else was typed meanwhile.
pub(super) fn offer(model: &mut Model, typed: String, mut lines: Vec<String>) {
    let Some(Typing::Command(line)) = &model.entry.typing else { return };
    // What is typed whole stays before whatever begins like it: a key too many must make no other command of it.
    if let Some(at) = lines.iter().position(|line| *line == typed) {
        lines[..=at].rotate_right(1);
    }
    lines.truncate(COMPLETIONS_MAX);
    if line.text() == typed && !lines.is_empty() {
        put(model, CompletionMenu { typed, lines, at: 0 });
    }
}

/// The line becomes what the menu is at. One thing alone needs no menu.
fn put(model: &mut Model, menu: CompletionMenu) {
    if let Some(text) = menu.lines.get(menu.at) {
        model.entry.typing = Some(Typing::Command(EditLine::new(text)));
    }
    model.entry.menu = Some(menu).filter(|menu| menu.lines.len() > 1);
}

/// An earlier or a later command line.
fn recall(model: &mut Model, earlier: bool) {
    let Some(Typing::Command(line)) = &model.entry.typing else { return };
    let at = model.entry.history.iter().position(|known| known == line.text());
    let place = match (at, earlier) {
        (Some(at), true) => at.checked_sub(1),
        (Some(at), false) => Some(at + 1),
        (None, true) => model.entry.history.len().checked_sub(1),
        (None, false) => None,
    };
    let recalled = place.and_then(|place| model.entry.history.get(place));
    if let Some(text) = recalled {
        model.entry.typing = Some(Typing::Command(EditLine::new(text)));
    } else if !earlier {
        model.entry.typing = Some(Typing::Command(EditLine::default()));
    }
}

/// Pasted text is text and nothing else: it runs nothing, and a prompt takes none of it.
pub(super) fn paste(model: &mut Model, text: &str) -> Vec<Effect> {
    model.entry.menu = None;
    match (&mut model.entry.typing, &mut model.entry.overlay) {
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
                tell(model, "pasted text is ignored here", false);
            }
        }
        (None, Some(Overlay::Prompt(prompt))) if prompt.signing.is_some() => {
            if let Some(signing) = &mut prompt.signing {
                signing.paste(text);
            }
        }
        (None, Some(Overlay::Prompt(_))) => tell(model, "a prompt takes no pasted text: type it", true),
        (None, Some(Overlay::Why(_) | Overlay::Film(_)) | None) => {
            tell(model, "pasted text is ignored here", false);
        }
    }
    Vec::new()
}
