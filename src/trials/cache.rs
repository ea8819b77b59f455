//! The cache of episodes and drills of active versions: by default in the store, or in a folder that several runs share.

use holdpoint_store::{OpenStore, ResultCache};

/// The location of cached episodes and drills.
#[derive(Clone, Debug, Default)]
pub enum EpisodeCache {
    /// In the store's own telemetry file.
    #[default]
    InStore,
    /// In a folder that runs share.
    Shared(ResultCache),
}

impl EpisodeCache {
    /// The cached results.
    #[must_use]
    pub fn result_cache<'a>(&'a self, store: &'a dyn OpenStore) -> &'a ResultCache {
        match self {
            Self::InStore => store.result_cache(),
            Self::Shared(cache) => cache,
        }
    }
}
