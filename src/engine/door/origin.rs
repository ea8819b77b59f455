//! Where an answer comes from: whether who serves a socket is the engine that has the store, as the kernel tells both.
//!
//! The peer's process is that of the socket's credentials; the engine's is the one that holds the lock of the folder in
//! which the socket lies. A program of the same account can read every key and cannot be kept out by any handshake;
//! this is so that it is seen.

use std::fmt;
use std::path::Path;

use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_registry::{LockHolder, lock_holder};

/// Who answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The process that has the store.
    Engine,
    /// Another one.
    Other {
        /// The process that answers.
        answers: i32,
        /// The process that has the store; absent if none has.
        holds: Option<i32>,
    },
    /// The kernel does not say who answers, or who has the store.
    Untold,
}

impl Origin {
    /// Who answers as process `answers` at the socket in a folder.
    pub(super) fn of(answers: i32, folder: &Path) -> Self {
        match lock_holder(folder) {
            _ if answers <= 0 => Self::Untold,
            LockHolder::Process(holds) if holds == answers => Self::Engine,
            LockHolder::Process(holds) => Self::Other { answers, holds: Some(holds) },
            LockHolder::Nobody => Self::Other { answers, holds: None },
            LockHolder::Untold => Self::Untold,
        }
    }

    /// Why the answer is not known to come from the engine; `None` if it is.
    #[must_use]
    pub fn doubt(self) -> Option<Doubt> {
        (self != Self::Engine).then_some(Doubt(self))
    }
}

/// Why an answer is not known to come from the engine. Shown as a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Doubt(Origin);

impl Doubt {
    /// The name of this state in JSON.
    pub const CODE: &'static str = "not-known-to-come-from-the-engine";

    /// For a place with little room.
    #[must_use]
    pub const fn short(self) -> &'static str {
        "NOT KNOWN TO COME FROM THE ENGINE"
    }
}

impl Doubt {
    /// With what was answered, as far as that is words.
    #[must_use]
    pub fn of(self, reply: &Reply) -> String {
        match reply {
            Reply::Accepted { text, .. } | Reply::Stopped { text, .. } | Reply::Refused { text, .. } => {
                format!("{self}; it says: {text}")
            }
            _ => self.to_string(),
        }
    }

    /// The answer where nothing was asked of whoever that is.
    #[must_use]
    pub fn unasked(self) -> Reply {
        let hint = "ask again in a moment: the engine takes its name back".to_owned();
        Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("{self}; nothing was asked of it"),
            hint: Some(hint),
        }
    }

    /// What stands for an answer to something that was to be done.
    #[must_use]
    pub fn in_place_of(self, reply: &Reply) -> Reply {
        let text = self.of(reply);
        let hint = "what the engine did is on its record: `holdpoint audit list`".to_owned();
        Reply::Refused { code: Refusal::NoAnswer, text, hint: Some(hint) }
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("this answer is not known to come from the engine: ")?;
        match self.0 {
            Origin::Other { answers, holds: Some(holds) } => {
                write!(f, "process {answers} answers at the socket, and process {holds} has the store")
            }
            Origin::Other { answers, holds: None } => {
                write!(f, "process {answers} answers at the socket, and no process has the store")
            }
            Origin::Untold | Origin::Engine => f.write_str(
                "the kernel does not say whether the process that answers is the one that has the store",
            ),
        }
    }
}
