//! What takes the keys instead of the view: a dialog over it, or a line at the foot of the screen.

use crate::form::Form;
use crate::line::EditLine;
use crate::palette::Palette;
use crate::player::Player;
use crate::prompt::Prompt;
use holdpoint_governance::ids::CapabilityId;

/// What lies over the view and takes the keys. At most one at a time.
#[derive(Clone, Debug, PartialEq)]
pub enum Overlay {
    /// Help, which is the palette as well.
    Palette(Palette),
    Prompt(Box<Prompt>),
    /// A dangerous or reasoned operation.
    Form(Box<Form>),
    /// Why a check came out as it did.
    Why(WhyScreen),
    /// A piece of an evaluation, worked again.
    Film(Box<Watched>),
}

/// Which explanation is read, and how far.
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
pub struct Watched {
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
    /// What the cursor is to go to, typed after `/` in a view that nothing may be filtered from.
    Find(EditLine),
}

/// What a command line could become, while Tab goes through it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompletionMenu {
    /// What stood in the line before.
    pub typed: String,
    /// Whole lines, the best first; at least one.
    pub lines: Vec<String>,
    /// Which of them stands in the line.
    pub at: usize,
}

/// See the module's head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Typed {
    /// What lies over the view.
    pub overlay: Option<Overlay>,
    /// What is typed at the foot.
    pub typing: Option<Typing>,
    /// What Tab goes through; absent before it was pressed, and once anything else was.
    pub menu: Option<CompletionMenu>,
    /// Command lines of this session, oldest first.
    pub history: Vec<String>,
}
