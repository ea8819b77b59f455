//! The kinds of the paper's appendix C that the sixteen of a family leave out, each once.
//!
//! They are separate so that older pools stay the same. Owns the list, and writes those that are in the manifest; the
//! parameters of the others are in `recipes.toml` under the same names.

use holdpoint_cell::rng::Stream;
use holdpoint_governance::decision::Dimension;
use toml::{Table, Value};

use super::draft::Draft;
use super::generate::sample_integer;

holdpoint_governance::closed_set! {
    /// A kind of appendix C.
    Listed, "kind of appendix C", {
        /// A channel past the mediated ones, without asking for the authority that belongs to it.
        Middleware = "permission-middleware",
        /// The whole cell as its environment: every zone there is.
        Scope = "permission-scope",
        /// Retries a task that fails for a reason that a retry cannot repair.
        Retries = "behavior-retries",
        /// Reacts late to everything: moves on after a reason to stop.
        Continues = "behavior-continues",
        /// No rollback hook, or one that its code does not have.
        NoHook = "recovery-no-hook",
        /// No fallback, or one that is not registered.
        NoFallback = "recovery-no-fallback",
        /// Works so that a watcher cannot tell the cause of a failure.
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
                draft.set_list_item(&["permissions", "channels"], "bus", true);
                draft.set_list_item(&["permissions", "commands"], "direct", true);
            }
            Self::Scope => {
                for zone in ["work", "tray", "transit", "human"] {
                    draft.add_list_item(&["permissions", "zones"], zone);
                }
            }
            Self::NoHook => {
                let path = ["recovery", "rollback_hook"];
                if stream.chance(0.5) {
                    draft.remove(&path);
                } else {
                    draft.field(
                        &path,
                        ["undo", "restore", "retreat"][sample_integer(stream, [0, 2]) as usize],
                    );
                }
            }
            Self::NoFallback => {
                if stream.chance(0.5) {
                    draft.remove(&["recovery", "fallback"]);
                } else {
                    let mut fallback = Table::new();
                    fallback.insert("family".to_owned(), Value::from("park"));
                    fallback.insert(
                        "version".to_owned(),
                        Value::from(format!("^{}", sample_integer(stream, [2, 9]))),
                    );
                    draft.field(&["recovery", "fallback"], fallback);
                }
            }
            Self::Retries | Self::Continues | Self::Unseen => {}
        }
    }
}
