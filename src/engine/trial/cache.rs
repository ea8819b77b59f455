//! Where episodes and drills of active versions are kept, that need not be run again: by default in the store, or in a
//! folder that several runs share.

use holdpoint_registry::{KeptCells, Store, StoreError};
use holdpoint_runtime::seeds::SeedKey;

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

    /// What bundles' seeds are drawn under: what a script of this seed works comes out the same on every store,
    /// otherwise nobody can compute them who cannot read the secret of what is kept.
    ///
    /// # Errors
    /// As [`holdpoint_registry::KeptSecret::derived`].
    pub fn seed_key(&self, store: &Store, script: Option<u64>) -> Result<SeedKey, StoreError> {
        match script {
            Some(seed) => Ok(SeedKey::of_run(seed)),
            None => Ok(SeedKey::secret(&self.cells(store).secret().derived("bundle seeds")?)),
        }
    }
}
