//! Whether the process that serves a socket is the engine that has the store, according to the kernel.
//!
//! The socket's credentials name the peer's process; the lock of the folder names the engine's process. A program of the
//! same account can read every key, so no handshake keeps it out; this check makes it visible.

use std::fmt;
use std::path::Path;

use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_store::{LockHolder, holds_lock, lock_holder};
use holdpoint_wording::program::engine as sentences;
use holdpoint_wording::program::engine::AnsweringProcess;

/// The process that answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnswerOrigin {
    /// The process that has the store.
    Engine,
    /// Another one.
    Other {
        /// The process that answers.
        answers: i32,
        /// The process that has the store; absent if none has.
        holds: Option<i32>,
    },
    /// The kernel does not name the answering process, or does not name in time the process that has the store.
    Untold,
}

impl AnswerOrigin {
    /// Compares the answering process with the process that has the store in `folder`.
    pub(super) fn of(answers: i32, folder: &Path) -> Self {
        if answers <= 0 {
            return Self::Untold;
        }
        if holds_lock(answers, folder) {
            return Self::Engine;
        }
        match lock_holder(folder) {
            LockHolder::Process(holds) if holds == answers => Self::Engine,
            LockHolder::Process(holds) => Self::Other { answers, holds: Some(holds) },
            LockHolder::Nobody => Self::Other { answers, holds: None },
            LockHolder::Untold => Self::Untold,
        }
    }

    /// Why the answer is not known to come from the engine; `None` if it is.
    #[must_use]
    pub fn unverified(self) -> Option<UnverifiedOrigin> {
        (self != Self::Engine).then_some(UnverifiedOrigin(self))
    }
}

/// Why an answer is not known to come from the engine. Shown as a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnverifiedOrigin(AnswerOrigin);

impl UnverifiedOrigin {
    /// The name of this state in JSON.
    pub const CODE: &'static str = "not-known-to-come-from-the-engine";

    /// A short form for places with little room.
    #[must_use]
    pub const fn short(self) -> &'static str {
        sentences::UNVERIFIED
    }
}

impl UnverifiedOrigin {
    /// The sentence, with the text of the answer if there is one.
    #[must_use]
    pub fn of(self, reply: &Reply) -> String {
        match reply {
            Reply::Accepted { text, .. } | Reply::Stopped { text, .. } | Reply::Refused { text, .. } => {
                sentences::unverified_answer(self, text)
            }
            _ => self.to_string(),
        }
    }

    /// The answer where the client sent the process no request.
    #[must_use]
    pub fn unasked(self) -> Reply {
        let hint = "ask again in a moment: the engine takes its name back".to_owned();
        Reply::Refused {
            code: Refusal::NotAllowed,
            text: format!("{self}; the client sent it no request"),
            hint: Some(hint),
        }
    }

    /// Replaces the answer to a command.
    #[must_use]
    pub fn in_place_of(self, reply: &Reply) -> Reply {
        let text = self.of(reply);
        let hint = "what the engine did is on its record: `holdpoint audit list`".to_owned();
        Reply::Refused { code: Refusal::NoAnswer, text, hint: Some(hint) }
    }
}

impl fmt::Display for UnverifiedOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&sentences::unverified(match self.0 {
            AnswerOrigin::Other { answers, holds } => AnsweringProcess::Other(answers, holds),
            AnswerOrigin::Untold | AnswerOrigin::Engine => AnsweringProcess::Untold,
        }))
    }
}
