//! Everything that can happen to the console: one closed set, so that each cause of a change is easy to see.

use std::sync::Arc;

use ratatui::crossterm::event::KeyEvent;

use super::approval_screen::VisibleRows;
use super::keymap::Keymap;
use super::model::ReconnectStatus;
use super::operator::Operator;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_recordings::recording::Recording;
use holdpoint_service::control_socket::UnverifiedOrigin;
use holdpoint_service::engine_handle::EngineEndError;

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
    /// The next key follows the one before it faster than a person types.
    Burst,
    /// The mouse wheel turned: rows down.
    Wheel(i32),
    /// The mouse was clicked at this column and row, from 0.
    Click(u16, u16),
    /// The terminal has this many columns and rows now.
    Resize(u16, u16),
    /// Whether the terminal is in line mode, so that no key arrives alone.
    LineMode(bool),
    /// The engine is up.
    EngineStarted,
    Events(Vec<Event>),
    /// Events from before this console was attached, oldest first, and the number of still earlier ones.
    Past {
        events: Vec<Event>,
        earlier: u64,
    },
    /// The console is attached to the engine with this process id, its first or another one; and why the origin of
    /// the data is unverified.
    Attached(Option<i32>, Option<UnverifiedOrigin>),
    /// A search for an engine found none.
    ReconnectFailed(ReconnectStatus),
    Answer {
        id: String,
        reply: Box<Reply>,
    },
    /// The console was too slow and missed this number of events.
    Lagged(u64),
    /// The current snapshot.
    Snapshot(Arc<Snapshot>),
    /// The newest camera frame of the cell.
    VideoFrame(Arc<VideoFrame>),
    EngineEnded(Result<(), EngineEndError>),
    /// The identities that this console could use.
    Identities(Vec<Operator>),
    /// The operator from now on.
    Operator(Operator),
    /// A decision could not be signed with the typed passphrase, and why.
    Unsigned {
        id: String,
        text: String,
    },
    /// A frame had these rows of the open decision on the screen.
    DecisionShown(VisibleRows),
    /// This name cannot be used here, and why.
    NoIdentity {
        name: String,
        text: String,
    },
    /// Completions of a typed line, from the contents of its folder.
    Completions {
        typed: String,
        lines: Vec<String>,
    },
    /// The result of an effect: one sentence, and whether it failed.
    Done {
        text: String,
        bad: bool,
    },
    /// A recording was read to be replayed here, and why no viewer shows it.
    RecordingRead {
        recording: Box<Recording>,
        why: String,
    },
    /// The operator's own files changed: the current keys, and the names of the current themes.
    OperatorFiles {
        keymap: Arc<Keymap>,
        themes: Vec<String>,
    },
    /// A theme is in use.
    Theme(String),
    /// A signal, or the terminal's loss, asks the program to end.
    EndRequested,
    Tick,
}
