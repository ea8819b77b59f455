//! The kinds of the paper's appendix C that the sixteen of a family leave out, each once.
//!
//! They stand apart so that a pool drawn before they were there is drawn the same today. Owns the list, and how those
//! that stand in the manifest are written; what their parameters are stands in `recipes.toml` under the same names.

use holdpoint_governance::decision::Dimension;
use holdpoint_sim::rng::Stream;
use toml::{Table, Value};

use super::draft::Draft;
use super::generate::whole;

holdpoint_governance::words! {
    /// A kind of appendix C.
    Listed, "kind of appendix C", {
        /// A channel past the mediated ones, without asking for the authority that belongs to it.
        Middleware = "permission-middleware",
        /// The whole cell as its environment: every zone there is.
        Scope = "permission-scope",
        /// Tries again and again what fails for a reason that another try does not mend.
        Retries = "behavior-retries",
        /// Answers to everything late: moves on after what should have stopped it.
        Continues = "behavior-continues",
        /// No rollback hook, or one that its code does not have.
        NoHook = "recovery-no-hook",
        /// No fallback, or one that nobody has registered.
        NoFallback = "recovery-no-fallback",
        /// Works so that a watcher cannot tell what goes wrong.
        Unseen = "recovery-unseen",
    }
}

impl Listed {
    /// The dimension it is worse in.
    #[must_use]
    pub const fn dimension(self) -> Dimension {
        match self {
            Self::Middleware | Self::Scope => Dimension::Policy,
            Self::Retries | Self::Continues => Dimension::Behavior,
            Self::NoHook | Self::NoFallback | Self::Unseen => Dimension::Recovery,
        }
    }

    /// Whether its parameters make it, by a recipe of its name; the others stand in the manifest.
    #[must_use]
    pub const fn has_recipe(self) -> bool {
        matches!(self, Self::Retries | Self::Continues | Self::Unseen)
    }

    /// Writes what of it stands in the manifest.
    pub(super) fn write(self, draft: &mut Draft, stream: &mut Stream) {
        match self {
            Self::Middleware => {
                draft.word(&["permissions", "channels"], "bus", true);
                draft.word(&["permissions", "commands"], "direct", true);
            }
            Self::Scope => {
                for zone in ["work", "tray", "transit", "human"] {
                    draft.word_too(&["permissions", "zones"], zone);
                }
            }
            Self::NoHook => {
                let path = ["recovery", "rollback_hook"];
                if stream.chance(0.5) {
                    draft.remove(&path);
                } else {
                    draft.field(&path, ["undo", "restore", "retreat"][whole(stream, [0, 2]) as usize]);
                }
            }
            Self::NoFallback => {
                if stream.chance(0.5) {
                    draft.remove(&["recovery", "fallback"]);
                } else {
                    let mut fallback = Table::new();
                    fallback.insert("family".to_owned(), Value::from("park"));
                    fallback.insert("version".to_owned(), Value::from(format!("^{}", whole(stream, [2, 9]))));
                    draft.field(&["recovery", "fallback"], fallback);
                }
            }
            Self::Retries | Self::Continues | Self::Unseen => {}
        }
    }
}
