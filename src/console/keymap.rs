//! Which key means which action. An operator's file adds to the defaults; it must name each key that it removes.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use crokey::{KeyCombination, KeyCombinationFormat};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use serde::Deserialize;
use toml::Spanned;

use super::action::{Action, Scope};
use holdpoint_wording::console::keymap as wording;
use holdpoint_wording::console::shared;

/// The largest keymap file, bytes.
pub const FILE_BYTES_MAX: usize = 64 * 1024;

/// Keys added to an action or removed from it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyEdits {
    /// Keys that are added, by action.
    #[serde(default)]
    keys: BTreeMap<Spanned<String>, Vec<Spanned<String>>>,
    /// Keys that are removed.
    #[serde(default)]
    unbind: Vec<Spanned<String>>,
}

/// A problem of a keymap file: place, key, reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}: {what}")]
pub struct KeymapError {
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// The key or action, what is wrong with it, and what is allowed.
    pub what: String,
}

/// The keys and their actions. Inside a prompt its own keys come first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Keymap {
    general: HashMap<KeyCombination, Action>,
    prompt: HashMap<KeyCombination, Action>,
}

impl Default for Keymap {
    fn default() -> Self {
        let mut keymap = Self { general: HashMap::new(), prompt: HashMap::new() };
        for action in Action::ALL {
            for text in action.default_keys() {
                if let Ok(key) = parse_key(text) {
                    keymap.map_mut(*action).insert(key, *action);
                }
            }
        }
        keymap
    }
}

impl Keymap {
    /// The defaults with a file's text on top.
    ///
    /// # Errors
    /// All problems of the file, in order; the file is then ignored.
    pub fn with_file(name: &str, text: &str) -> Result<Self, Vec<KeymapError>> {
        let at = |range: &Range<usize>, what: String| {
            let before = text.get(..range.start.min(text.len())).unwrap_or("");
            KeymapError { file: name.to_owned(), line: before.matches('\n').count() + 1, what }
        };
        if text.len() > FILE_BYTES_MAX {
            let what = shared::file_too_large(text.len(), FILE_BYTES_MAX);
            return Err(vec![at(&(0..0), what)]);
        }
        let file: KeyEdits = toml::from_str(text)
            .map_err(|error| vec![at(&error.span().unwrap_or(0..0), error.message().to_owned())])?;
        let mut keymap = Self::default();
        let mut problems = Vec::new();
        for key in &file.unbind {
            let found = parse_key(key.get_ref()).map(|parsed| keymap.unbind(parsed));
            match found {
                Ok(true) => {}
                Ok(false) => {
                    problems.push(at(&key.span(), wording::not_bound(key.get_ref())));
                }
                Err(what) => problems.push(at(&key.span(), what)),
            }
        }
        for (action_name, keys) in &file.keys {
            let Some(action) = Action::parse(action_name.get_ref()) else {
                let what = wording::no_such_action(action_name.get_ref());
                problems.push(at(&action_name.span(), what));
                continue;
            };
            for key in keys {
                if let Err(what) = keymap.bind(action, key.get_ref()) {
                    problems.push(at(&key.span(), what));
                }
            }
        }
        if let Some(missing) = [Action::Stop, Action::Abort, Action::Quit, Action::Back]
            .into_iter()
            .find(|a| keymap.keys(*a).is_empty())
        {
            problems.push(at(&(0..0), wording::no_key_left(missing.name())));
        }
        if problems.is_empty() { Ok(keymap) } else { Err(problems) }
    }

    fn bind(&mut self, action: Action, text: &str) -> Result<(), String> {
        let key = parse_key(text)?;
        if action.decides() && !may_decide(key) {
            return Err(wording::never_decides(text, action.name()));
        }
        let mut of_stop = Action::Stop.default_keys().iter().filter_map(|text| parse_key(text).ok());
        let stops = of_stop.any(|known| known == key) || self.general.get(&key) == Some(&Action::Stop);
        if stops && action != Action::Stop {
            return Err(wording::stops_the_cell(text));
        }
        if let Some(other) = self.prompt.get(&key).filter(|_| action == Action::Stop) {
            return Err(wording::would_not_stop(text, other.name()));
        }
        let previous = self.map_mut(action).insert(key, action);
        match previous.filter(|other| *other != action) {
            None => Ok(()),
            Some(other) => Err(wording::means_already(text, other.name())),
        }
    }

    fn unbind(&mut self, key: KeyCombination) -> bool {
        let general = self.general.remove(&key).is_some();
        let prompt = self.prompt.remove(&key).is_some();
        general || prompt
    }

    const fn map_mut(&mut self, action: Action) -> &mut HashMap<KeyCombination, Action> {
        match action.scope() {
            Scope::Prompt => &mut self.prompt,
            Scope::Everywhere | Scope::Lists | Scope::Version | Scope::Alarms | Scope::Charts => {
                &mut self.general
            }
        }
    }

    /// The action of a key; `in_prompt` says whether a prompt is open.
    #[must_use]
    pub fn action(&self, key: KeyEvent, in_prompt: bool) -> Option<Action> {
        let key = normal(key);
        let prompt = if in_prompt { self.prompt.get(&key) } else { None };
        prompt.or_else(|| self.general.get(&key)).copied()
    }

    /// The keys of an action in written form, the default ones first.
    #[must_use]
    pub fn keys(&self, action: Action) -> Vec<String> {
        let map = if action.scope() == Scope::Prompt { &self.prompt } else { &self.general };
        let format = written_format();
        let mut keys: Vec<String> = map
            .iter()
            .filter(|(_, bound)| **bound == action)
            .map(|(key, _)| key_label(*key, &format))
            .collect();
        let place = |key: &String| {
            let defaults = action.default_keys();
            defaults
                .iter()
                .position(|default| default.eq_ignore_ascii_case(key) && default.len() == key.len())
        };
        keys.sort_by_key(|key| (place(key).unwrap_or(usize::MAX), key.clone()));
        keys
    }

    /// The first key of an action, for hints; empty if it has none.
    #[must_use]
    pub fn key(&self, action: Action) -> String {
        self.keys(action).into_iter().next().unwrap_or_default()
    }
}

/// A key as hints and the keymap file write it.
#[must_use]
pub fn written(key: KeyEvent) -> String {
    key_label(normal(key), &written_format())
}

fn written_format() -> KeyCombinationFormat {
    KeyCombinationFormat::default().with_lowercase_modifiers().with_implicit_shift()
}

fn key_label(key: KeyCombination, format: &KeyCombinationFormat) -> String {
    match (key.modifiers, key.codes.first()) {
        (KeyModifiers::SHIFT, KeyCode::Char(letter)) if letter.is_alphabetic() => {
            letter.to_uppercase().to_string()
        }
        (KeyModifiers::NONE, KeyCode::Char(' ')) => "space".to_owned(),
        (KeyModifiers::NONE, KeyCode::Char(letter)) => letter.to_string(),
        _ => format.to_string(key).to_lowercase(),
    }
}

/// A key as written in a file: `q`, `Q`, `ctrl-s`, `pageup`, `?`.
fn parse_key(text: &str) -> Result<KeyCombination, String> {
    let mut letters = text.chars();
    if let (Some(letter), None) = (letters.next(), letters.next()) {
        let modifiers = if letter.is_uppercase() { KeyModifiers::SHIFT } else { KeyModifiers::NONE };
        return Ok(normal(KeyEvent::new(KeyCode::Char(letter), modifiers)));
    }
    let parsed: Result<KeyCombination, _> = text.parse();
    let key = parsed.map_err(|_| wording::no_key(text))?;
    Ok(normal(KeyEvent::new(*key.codes.first(), key.modifiers)))
}

/// One form for each key, however the terminal reports it: upper-case letters carry shift, other signs none.
fn normal(key: KeyEvent) -> KeyCombination {
    let (code, modifiers) = match key.code {
        KeyCode::Char(letter) if letter.is_alphabetic() => {
            let shifted = letter.is_uppercase() || key.modifiers.contains(KeyModifiers::SHIFT);
            let rest = key.modifiers - KeyModifiers::SHIFT;
            let letter = letter.to_lowercase().next().unwrap_or(letter);
            (KeyCode::Char(letter), if shifted { rest | KeyModifiers::SHIFT } else { rest })
        }
        KeyCode::Char(sign) => (KeyCode::Char(sign), key.modifiers - KeyModifiers::SHIFT),
        KeyCode::BackTab => (KeyCode::BackTab, KeyModifiers::NONE),
        other => (other, key.modifiers),
    };
    KeyCombination::new(code, modifiers)
}

/// Whether a key may decide on a candidate: no key that is hit by reflex or to move.
fn may_decide(key: KeyCombination) -> bool {
    let moves = Keymap::default();
    let moving = moves.general.iter().any(|(known, action)| {
        *known == key && (action.scope() == Scope::Lists || matches!(action, Action::Back | Action::Open))
    });
    let plain = match key.codes.first() {
        KeyCode::Char(' ') => false,
        KeyCode::Char(_) => true,
        KeyCode::F(_) => true,
        _ => false,
    };
    plain && !moving
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(code: KeyCode, modifiers: KeyModifiers) -> KeyEvent {
        KeyEvent::new(code, modifiers)
    }

    #[test]
    fn every_default_key_parses_and_means_one_thing() {
        let keymap = Keymap::default();
        let mut bound = 0;
        for action in Action::ALL {
            for text in action.default_keys() {
                let key = parse_key(text).unwrap_or_else(|what| panic!("{what}"));
                let map = if action.scope() == Scope::Prompt { &keymap.prompt } else { &keymap.general };
                assert_eq!(map.get(&key), Some(action), "{text}");
                assert!(!action.decides() || may_decide(key), "{text}");
                bound += 1;
            }
            assert_eq!(keymap.keys(*action), action.default_keys(), "{action:?}");
        }
        assert_eq!(bound, keymap.general.len() + keymap.prompt.len());
    }

    #[test]
    fn both_reports_of_shift_are_read() {
        let keymap = Keymap::default();
        for (code, modifiers, action) in [
            (KeyCode::Char('G'), KeyModifiers::NONE, Action::Bottom),
            (KeyCode::Char('G'), KeyModifiers::SHIFT, Action::Bottom),
            (KeyCode::Char('g'), KeyModifiers::NONE, Action::Top),
            (KeyCode::Char('?'), KeyModifiers::SHIFT, Action::Help),
            (KeyCode::BackTab, KeyModifiers::SHIFT, Action::PreviousPane),
            (KeyCode::Char('c'), KeyModifiers::CONTROL, Action::Quit),
        ] {
            assert_eq!(keymap.action(press(code, modifiers), false), Some(action), "{code:?}");
        }
        assert_eq!(keymap.action(press(KeyCode::Char('Y'), KeyModifiers::SHIFT), false), None);
        assert_eq!(
            keymap.action(press(KeyCode::Char('Y'), KeyModifiers::SHIFT), true),
            Some(Action::Approve)
        );
    }

    #[test]
    fn files_add_and_report_problems_with_their_line() {
        let keymap =
            Keymap::with_file("keys.toml", "unbind = [\"T\"]\n[keys]\nquit = [\"T\", \"ctrl-q\"]\n").unwrap();
        assert_eq!(keymap.keys(Action::Quit), ["q", "ctrl-c", "T", "ctrl-q"]);
        assert!(keymap.keys(Action::NextTheme).is_empty());
        for (text, line, expected) in [
            ("[keys]\napprove = [\"enter\"]", 2, wording::never_decides("enter", "approve")),
            ("[keys]\napprove = [\"space\"]", 2, wording::never_decides("space", "approve")),
            ("[keys]\nreject = [\"j\"]", 2, wording::never_decides("j", "reject")),
            ("[keys]\napprove = [\"tab\"]", 2, wording::never_decides("tab", "approve")),
            ("[keys]\napprove = [\"X\"]", 2, wording::stops_the_cell("X")),
            ("unbind = [\"X\"]\n[keys]\napprove = [\"X\"]", 3, wording::stops_the_cell("X")),
            ("unbind = [\"f9\"]\n[keys]\nhelp = [\"f9\"]", 3, wording::stops_the_cell("f9")),
            ("[keys]\nstop = [\"Y\"]", 2, wording::would_not_stop("Y", "approve")),
            ("[keys]\nhelp = [\"q\"]", 2, wording::means_already("q", "quit")),
            ("[keys]\n\nfly = [\"F9\"]", 3, wording::no_such_action("fly")),
            ("[keys]\nquit = [\"hyper-9-x\"]", 2, wording::no_key("hyper-9-x")),
            ("unbind = [\"Q\"]", 1, wording::not_bound("Q")),
            ("unbind = [\"x\", \"ctrl-x\"]", 1, wording::no_key_left("abort")),
            ("keys = 3", 1, "invalid type".to_owned()),
        ] {
            let problems = Keymap::with_file("keys.toml", text).unwrap_err();
            let first = problems.first().unwrap();
            assert_eq!(first.line, line, "{text}: {first}");
            assert!(first.what.contains(&expected), "{text}: {first}");
        }
    }
}
