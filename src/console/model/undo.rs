//! The actions of this console that can be undone, the newest last.
//!
//! Owns no rule about whether an action still can be undone: the reducer compares it with the newest snapshot.

use super::view_state::ItemKey;
use holdpoint_governance::ids::CapabilityId;

/// The most actions that are remembered.
const ACTIONS_MAX: usize = 50;

/// An action that the key of undo is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UndoableAction {
    /// An alarm was acknowledged. It is refused: see `update/undo.rs`.
    Acknowledge(String),
    /// An alarm was shelved.
    Shelve(String),
    /// A version was put on hold.
    Hold(CapabilityId),
    /// An alarm or a version was marked.
    Mark(ItemKey),
    /// A goal was set.
    Goal {
        /// As it was typed.
        set: String,
        /// The goal before it.
        before: String,
    },
}

/// What a request does to the actions that can be undone, once the engine has accepted it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UndoChange {
    /// Its own action can be undone.
    Adds(UndoableAction),
    /// It undoes this action.
    Removes(UndoableAction),
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UndoList {
    /// Each action with the console time at which it was done, ms.
    actions: Vec<(UndoableAction, u64)>,
}

impl UndoList {
    /// The newest action, and the console time at which it was done, ms.
    #[must_use]
    pub fn last(&self) -> Option<&(UndoableAction, u64)> {
        self.actions.last()
    }

    /// Remembers an action. A repeated one counts once, as the newest.
    pub fn add(&mut self, action: UndoableAction, now_ms: u64) {
        self.remove(&action);
        if self.actions.len() >= ACTIONS_MAX {
            self.actions.remove(0);
        }
        self.actions.push((action, now_ms));
    }

    pub fn remove(&mut self, action: &UndoableAction) {
        self.actions.retain(|(known, _)| known != action);
    }

    /// Forgets the marks that are gone.
    pub fn retain_marks(&mut self, is_marked: impl Fn(&ItemKey) -> bool) {
        self.actions.retain(|(action, _)| match action {
            UndoableAction::Mark(item) => is_marked(item),
            UndoableAction::Acknowledge(_)
            | UndoableAction::Shelve(_)
            | UndoableAction::Hold(_)
            | UndoableAction::Goal { .. } => true,
        });
    }
}
