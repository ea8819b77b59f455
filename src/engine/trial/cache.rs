//! Episodes of active versions that need not be run again.
//!
//! By default they are kept in the store. A folder can be named instead, which several runs share:
//! one file an episode, written whole or not at all. A damaged or missing entry is no entry.

use std::path::PathBuf;

use holdpoint_registry::{EpisodeKey, Store, StoreError};

/// Where cached episodes are.
#[derive(Clone, Debug, Default)]
pub enum EpisodeCache {
    /// In the store's own telemetry file.
    #[default]
    InStore,
    /// In a folder that runs share.
    Shared(PathBuf),
}

/// The largest cached entry, bytes.
const ENTRY_BYTES_MAX: u64 = 1 << 20;

impl EpisodeCache {
    /// The stored bytes of a key; absent if there are none that can be read.
    #[must_use]
    pub fn get(&self, store: &Store, key: &EpisodeKey) -> Option<Vec<u8>> {
        match self {
            Self::InStore => store.cached_episode(key).ok().flatten(),
            Self::Shared(folder) => {
                let path = folder.join(file_name(key));
                let size = std::fs::metadata(&path).ok()?.len();
                if size > ENTRY_BYTES_MAX { None } else { std::fs::read(path).ok() }
            }
        }
    }

    /// Keeps the bytes of a key. A shared folder that cannot be written to only costs time.
    ///
    /// # Errors
    /// If the store's own cache fails.
    pub fn put(&self, store: &Store, key: &EpisodeKey, bytes: &[u8]) -> Result<(), StoreError> {
        match self {
            Self::InStore => store.put_cached_episode(key, bytes),
            Self::Shared(folder) => {
                let name = file_name(key);
                let part = folder.join(format!("{name}.{}.part", std::process::id()));
                let written = std::fs::create_dir_all(folder)
                    .and_then(|()| std::fs::write(&part, bytes))
                    .and_then(|()| std::fs::rename(&part, folder.join(&name)));
                if written.is_err() {
                    // Only the time to run the episode again is lost.
                    let _ = std::fs::remove_file(&part);
                }
                Ok(())
            }
        }
    }
}

fn file_name(key: &EpisodeKey) -> String {
    let digest = holdpoint_governance::ids::Digest::of_parts(
        "holdpoint.cache.v1",
        &[key.bundle.bytes(), key.scenario.bytes(), &key.seed.to_le_bytes(), key.engine_build.as_bytes()],
    );
    digest.to_string()
}
