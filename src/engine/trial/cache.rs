//! The cache of episodes and drills of active versions: by default in the store, or in a folder that several runs share.

use holdpoint_registry::{ResultCache, Store, StoreError};
use holdpoint_runtime::seeds::SeedKey;

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
    pub const fn result_cache<'a>(&'a self, store: &'a Store) -> &'a ResultCache {
        match self {
            Self::InStore => store.result_cache(),
            Self::Shared(cache) => cache,
        }
    }

    /// The key of bundles' seeds: a script's episodes are the same on every store; otherwise computing a seed needs
    /// the cache's secret.
    ///
    /// # Errors
    /// As [`holdpoint_registry::CacheSecret::derived`].
    pub fn seed_key(&self, store: &Store, script: Option<u64>) -> Result<SeedKey, StoreError> {
        match script {
            Some(seed) => Ok(SeedKey::of_run(seed)),
            None => Ok(SeedKey::secret(&self.result_cache(store).secret().derived("bundle seeds")?)),
        }
    }
}
