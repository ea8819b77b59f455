//! Where episodes and drills of active versions are kept, that need not be run again: by default in the store, or in a
//! folder that several runs share.

use holdpoint_registry::{KeptCells, Store};

/// Where they are kept.
#[derive(Clone, Debug, Default)]
pub enum EpisodeCache {
    /// In the store's own telemetry file.
    #[default]
    InStore,
    /// In a folder that runs share.
    Shared(KeptCells),
}

impl EpisodeCache {
    /// The cells.
    #[must_use]
    pub const fn cells<'a>(&'a self, store: &'a Store) -> &'a KeptCells {
        match self {
            Self::InStore => store.cells(),
            Self::Shared(cells) => cells,
        }
    }
}
