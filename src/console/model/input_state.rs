//! The input that has the keys instead of the view: a dialog over it, or a line at the foot of the screen.

use super::engine_data::EventLogLine;
use crate::approval_screen::{ApprovalFocus, ApprovalScreen, VisibleRows};
use crate::form::{DismissedForm, Form};
use crate::line::EditLine;
use crate::palette::Palette;
use crate::player::Player;
use crate::replay::model::ReplayModel;
use crate::secret::PassphraseEntry;
use holdpoint_governance::ids::CapabilityId;

/// A dialog over the view, which takes the keys. At most one at a time.
#[derive(Clone, Debug, PartialEq)]
pub enum Overlay {
    /// Help, which is the palette as well.
    Palette(Palette),
    Approval(Box<ApprovalScreen>),
    /// An operation that needs a reason or a confirmation.
    Form(Box<Form>),
    /// The explanation of a check's result.
    Why(WhyScreen),
    /// The re-run of a part of an evaluation.
    Film(Box<FilmScreen>),
    /// The replay of a recording.
    Replay(Box<ReplayModel>),
    /// What each key did, with the row under the cursor.
    KeyLog(usize),
    /// The whole text of an event.
    Event(EventScreen),
}

impl Overlay {
    /// The passphrase entry of the open request or form; absent while nothing is being signed.
    pub fn signing_mut(&mut self) -> Option<&mut dyn PassphraseEntry> {
        match self {
            Self::Approval(prompt) => Some(prompt.signing.as_mut()?),
            Self::Form(form) => Some(form.signing.as_mut()?),
            Self::Palette(_)
            | Self::Why(_)
            | Self::Film(_)
            | Self::Replay(_)
            | Self::KeyLog(_)
            | Self::Event(_) => None,
        }
    }

    /// Whether typed letters are text here.
    #[must_use]
    pub fn takes_text(&self) -> bool {
        match self {
            Self::Palette(_) => true,
            Self::Approval(prompt) => {
                prompt.focus != ApprovalFocus::Later || prompt.signing.is_some() || prompt.dismissed.is_some()
            }
            Self::Form(form) => {
                (form.void.is_some() && !form.is_one_key()) || form.types() || form.signing.is_some()
            }
            Self::Replay(replay) => replay.typing.is_some(),
            Self::Why(_) | Self::Film(_) | Self::KeyLog(_) | Self::Event(_) => false,
        }
    }

    /// How many lines of the open request or form have not been on the screen.
    #[must_use]
    pub fn unread(&self) -> usize {
        match self {
            Self::Approval(prompt) => prompt.unread(),
            Self::Form(form) => form.unread(),
            Self::Palette(_)
            | Self::Why(_)
            | Self::Film(_)
            | Self::Replay(_)
            | Self::KeyLog(_)
            | Self::Event(_) => 0,
        }
    }

    /// Notes the lines of the open request or form that were on the screen.
    pub fn mark_read(&mut self, visible: &VisibleRows) {
        match self {
            Self::Approval(prompt) => prompt.mark_read(visible),
            Self::Form(form) => form.mark_read(visible),
            Self::Palette(_)
            | Self::Why(_)
            | Self::Film(_)
            | Self::Replay(_)
            | Self::KeyLog(_)
            | Self::Event(_) => {}
        }
    }
}

/// An event on the screen in full. The line is a copy: the log forgets old lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EventScreen {
    pub line: EventLogLine,
    /// Rows that have gone out at the top.
    pub scroll: usize,
}

/// The explanation on the screen, and how far it is scrolled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WhyScreen {
    /// The version that is explained.
    pub version: CapabilityId,
    /// Its place among the explanations.
    pub at: usize,
    /// Rows that have gone out at the top.
    pub scroll: usize,
}

impl WhyScreen {
    /// Another explanation, from its beginning.
    #[must_use]
    pub fn turned(&self, at: usize) -> Self {
        Self { version: self.version.clone(), at, scroll: 0 }
    }
}

/// A film, and the explanation it is watched from.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmScreen {
    pub player: Player,
    pub back: WhyScreen,
}

/// Text that is being typed at the foot of the screen.
#[derive(Clone, Debug, PartialEq)]
pub enum Typing {
    /// A command, typed after `:`.
    Command(EditLine),
    /// The view's filter, typed after `/`.
    Filter(EditLine),
    /// The text to find, typed after `/` in a view without a filter.
    Find(EditLine),
}

/// The completions of a command line, while Tab steps through them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompletionMenu {
    /// The line before completion.
    pub typed: String,
    /// Whole lines, the best first; at least one.
    pub lines: Vec<String>,
    /// Which of them stands in the line.
    pub at: usize,
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputState {
    /// What lies over the view.
    pub overlay: Option<Overlay>,
    /// What is typed at the foot.
    pub typing: Option<Typing>,
    /// What Tab goes through; absent before it was pressed, and once anything else was.
    pub menu: Option<CompletionMenu>,
    /// Command lines of this session, oldest first.
    pub history: Vec<String>,
    /// A field that was asked for and did not open, while its reason or passphrase may still be typed.
    pub refused_form: Option<DismissedForm>,
}
