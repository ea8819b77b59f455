//! What each key of this console did, or why it did nothing, with the engine's answer once there is one.
//!
//! Keys that only move the cursor and typed text are not in it, so no passphrase is either. It ends with the console.

use std::collections::VecDeque;

use crate::action::Action;

/// The most entries.
pub const KEY_LOG_MAX: usize = 200;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KeyLogEntry {
    /// When the key was pressed, as a time of day; as time since the start where the engine reports none.
    pub at: String,
    /// The key as hints write it, or the command line that it ended.
    pub key: String,
    /// What it did, or why it did nothing.
    pub text: String,
    /// Whether it was refused.
    pub refused: bool,
    /// The engine's answers; empty without one.
    pub answer: String,
    /// Whether the engine refused a request of it.
    pub answer_refused: bool,
    /// Its requests without an answer, by id.
    waits_for: Vec<String>,
}

impl KeyLogEntry {
    /// Whether an answer is missing.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        !self.waits_for.is_empty()
    }
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KeyLog {
    /// The entries, oldest first.
    pub entries: VecDeque<KeyLogEntry>,
    /// The key that is being handled, with its action; absent between two keys.
    current: Option<(KeyLogEntry, Option<Action>)>,
}

impl KeyLog {
    /// A key is handled from now on.
    pub fn begin(&mut self, at: String, key: String) {
        self.current = Some((KeyLogEntry { at, key, ..KeyLogEntry::default() }, None));
    }

    /// The key ended this command line.
    pub fn note_command(&mut self, line: &str) {
        if let Some((entry, _)) = &mut self.current {
            entry.key = format!(":{line}");
        }
    }

    /// The key carries out an action.
    pub fn note_action(&mut self, action: Action) {
        if let Some((_, current)) = &mut self.current {
            *current = Some(action);
        }
    }

    /// The console showed this about the key.
    pub fn note_text(&mut self, text: &str, refused: bool) {
        if let Some((entry, _)) = &mut self.current {
            text.clone_into(&mut entry.text);
            entry.refused = refused;
        }
    }

    /// The key sent a request for this, which is what it did unless more is shown about it.
    pub fn note_request(&mut self, id: &str, what: &str) {
        if let Some((entry, _)) = &mut self.current {
            if entry.text.is_empty() {
                what.clone_into(&mut entry.text);
            }
            entry.waits_for.push(id.to_owned());
        }
    }

    /// The action of the key, if nothing was shown about it.
    #[must_use]
    pub fn unexplained(&self) -> Option<Action> {
        self.current.as_ref().filter(|(entry, _)| entry.text.is_empty()).and_then(|(_, action)| *action)
    }

    /// The key is handled. One that did nothing is left out.
    pub fn finish(&mut self) {
        let Some((entry, _)) = self.current.take() else { return };
        if entry.text.is_empty() {
            return;
        }
        if self.entries.len() >= KEY_LOG_MAX {
            self.entries.pop_front();
        }
        self.entries.push_back(entry);
    }

    /// The engine answered a request, or it could not be sent.
    pub fn answered(&mut self, id: &str, text: &str, refused: bool) {
        let entries = self.entries.iter_mut().chain(self.current.as_mut().map(|(entry, _)| entry));
        for entry in entries.filter(|entry| entry.waits_for.iter().any(|known| known == id)) {
            entry.waits_for.retain(|known| known != id);
            if !entry.answer.is_empty() {
                entry.answer.push_str("; ");
            }
            entry.answer.push_str(text);
            entry.answer_refused |= refused;
        }
    }

    /// No request gets an answer any more.
    pub fn lost(&mut self, why: &str) {
        let ids: Vec<String> = self.entries.iter().flat_map(|entry| entry.waits_for.clone()).collect();
        for id in ids {
            self.answered(&id, why, true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressed(log: &mut KeyLog, key: &str, text: &str) {
        log.begin("08:00:00".to_owned(), key.to_owned());
        log.note_text(text, false);
        log.finish();
    }

    #[test]
    fn the_log_is_bounded_and_keeps_the_newest() {
        let mut log = KeyLog::default();
        for number in 0..=KEY_LOG_MAX {
            pressed(&mut log, "p", &format!("held {number}"));
        }
        assert_eq!(log.entries.len(), KEY_LOG_MAX);
        assert_eq!(log.entries.front().map(|entry| entry.text.as_str()), Some("held 1"));
        // A key without any effect is left out, and nothing is noted between two keys.
        log.begin("08:00:01".to_owned(), "j".to_owned());
        log.finish();
        log.note_text("the engine is gone", true);
        assert_eq!(log.entries.back().map(|entry| entry.text.as_str()), Some("held 200"));
    }

    #[test]
    fn answers_go_to_the_key_that_asked() {
        let mut log = KeyLog::default();
        log.begin("08:00:00".to_owned(), "F".to_owned());
        log.note_text("asked", false);
        log.note_request("console-1", "reject grasp@1.1.0");
        log.note_request("console-2", "reject grasp@1.2.0");
        log.finish();
        pressed(&mut log, "y", "copied");
        log.answered("console-2", "done", false);
        assert!(log.entries[0].is_waiting() && log.entries[0].answer == "done");
        log.answered("console-1", "too late", true);
        log.answered("console-1", "again", true);
        assert!(!log.entries[0].is_waiting() && log.entries[0].answer_refused);
        assert_eq!(log.entries[0].answer, "done; too late");
        assert!(log.entries[1].answer.is_empty());
        // A request alone is what the key did.
        log.begin("08:00:02".to_owned(), ":pace 5".to_owned());
        log.note_request("console-3", "change the pace");
        log.finish();
        assert_eq!((log.entries[2].text.as_str(), log.entries[2].is_waiting()), ("change the pace", true));
    }
}
