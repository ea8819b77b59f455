//! The attached consoles and their views. Grants nothing.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::account_role::AccountRole;
use holdpoint_governance::ids::{CapabilityId, is_name};

/// The longest title of a view, bytes.
const TITLE_BYTES_MAX: usize = 24;

/// What an attached console says of its user. It decides nothing: a decision is signed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConsolePresence {
    /// The operator's chosen name; absent until chosen.
    #[serde(default)]
    pub who: Option<String>,
    /// The title of the current view, one word; empty until the console shows one. A console shows only a title of its own
    /// views: any other word could be a false statement.
    pub view: String,
    /// The open approval request; absent if none.
    #[serde(default)]
    pub reading: Option<CapabilityId>,
    /// Read-only: this console sends no commands.
    #[serde(default)]
    pub read_only: bool,
}

impl ConsolePresence {
    /// The invalid field, if any: a name that no identity can have, or a view that is not one word. So neither can be a
    /// sentence on another screen.
    #[must_use]
    pub fn invalid_field(&self) -> Option<String> {
        if self.who.as_deref().is_some_and(|who| !is_name(who)) {
            return Some("who is a name: 1 to 64 characters of a-z, 0-9, '.', '_' and '-'".to_owned());
        }
        let is_word =
            self.view.len() <= TITLE_BYTES_MAX && self.view.bytes().all(|byte| byte.is_ascii_alphabetic());
        (!is_word)
            .then(|| format!("view is the title of a view: a word of at most {TITLE_BYTES_MAX} letters"))
    }
}

/// The Unix account of an attached console, as the system reports it; a client cannot forge it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConsoleAccount {
    /// Number of the user.
    pub uid: u32,
    /// Name of that user; absent if the system has none.
    #[serde(default)]
    pub user: Option<String>,
    /// The role of the account at this engine.
    pub role: AccountRole,
}

/// An attached console.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttachedConsoleView {
    /// Its number, in order of attachment; an engine never reuses one.
    pub seat: u64,
    /// Process id of the console; absent if the system does not report it.
    #[serde(default)]
    pub process: Option<u32>,
    /// The account of that process; absent if the system does not report it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub account: Option<ConsoleAccount>,
    /// What the console states.
    pub sitting: ConsolePresence,
    /// The console reads nothing: it is suspended, or its connection is dead. The engine soon disconnects it.
    #[serde(default)]
    pub not_reading: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A view of any text showed another account and role behind a console on the screens of others.
    #[test]
    fn a_presence_states_a_name_and_a_word_alone() {
        let sitting = |who: &str, view: &str| ConsolePresence {
            who: Some(who.to_owned()),
            view: view.to_owned(),
            ..ConsolePresence::default()
        };
        assert_eq!(sitting("bert", "Overview").invalid_field(), None);
        assert_eq!(ConsolePresence::default().invalid_field(), None);
        for (who, view, field) in [
            ("a\u{1b}[2J", "Overview", "who"),
            ("ana promoted it; ben", "Overview", "who"),
            ("", "Overview", "who"),
            ("bert", "Audit ", "view"),
            ("bert", "Audit\u{1b}", "view"),
            ("bert", "Abcdefghijklmnopqrstuvwxy", "view"),
            ("bert", "Audit), ana of account root, administrator (Approvals", "view"),
        ] {
            assert!(sitting(who, view).invalid_field().is_some_and(|text| text.starts_with(field)));
        }
    }
}
