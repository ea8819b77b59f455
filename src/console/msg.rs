//! What can happen to the console: one closed set, so that everything that triggers a change is easy to see.

use std::sync::Arc;

use ratatui::crossterm::event::KeyEvent;

use super::keymap::Keymap;
use super::model::Seeking;
use super::operator::Operator;
use super::prompt::OnScreen;
use holdpoint_engine::door::Doubt;
use holdpoint_engine::host::EndFault;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::snapshot::Snapshot;

/// Something happened, at a moment of the console's own clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Msg {
    /// When, ms since the start; monotonic.
    pub now_ms: u64,
    pub what: MsgKind,
}

#[derive(Clone, Debug, PartialEq)]
pub enum MsgKind {
    /// A key went down (or repeats).
    Key(KeyEvent),
    Paste(String),
    /// The mouse wheel turned: rows down.
    Wheel(i32),
    /// The mouse was clicked at this column and row, from 0.
    Click(u16, u16),
    /// The terminal has this many columns and rows now.
    Resize(u16, u16),
    /// The engine is up.
    EngineStarted,
    Events(Vec<Event>),
    /// What happened before this console came, oldest first, and how many events came before that.
    Past {
        events: Vec<Event>,
        earlier: u64,
    },
    /// The console sits down at an engine of this process id, the first one, or another one than before; and why what is
    /// shown is not known to come from it.
    Seated(Option<i32>, Option<Doubt>),
    /// A look for an engine found none.
    Sought(Seeking),
    Answer {
        id: String,
        reply: Box<Reply>,
    },
    /// The console was too slow for so many events.
    Lagged(u64),
    /// How things stand now.
    Snapshot(Arc<Snapshot>),
    /// What the cell looks like now.
    Picture(Arc<Picture>),
    EngineEnded(Result<(), EndFault>),
    /// Who could sit here.
    Identities(Vec<Operator>),
    /// Who sits here from now on.
    Operator(Operator),
    /// A decision could not be signed with the passphrase that was typed: why.
    Unsigned {
        id: String,
        text: String,
    },
    /// A frame had these rows of the open decision on the screen.
    DecisionShown(OnScreen),
    /// Nobody of this name could sit down here: why.
    NoIdentity {
        name: String,
        text: String,
    },
    /// What a typed line could become, by what its folder holds.
    Completions {
        typed: String,
        lines: Vec<String>,
    },
    /// An effect came to this: one sentence, and whether it failed.
    Done {
        text: String,
        bad: bool,
    },
    /// The operator's own files changed: the keys and the names of the themes there are now.
    OwnFiles {
        keymap: Arc<Keymap>,
        themes: Vec<String>,
    },
    /// A theme is in use.
    Theme(String),
    /// A signal, or the terminal's loss, asks the program to end.
    EndAsked,
    Tick,
}
