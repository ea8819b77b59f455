//! A store that belongs to this process and whose record was not read yet: its rows can be shown, marked as unverified,
//! and nothing can be written.

use std::path::Path;

use ed25519_dalek::SigningKey;

use super::checkpoint;
use super::error::StoreError;
use super::layout::{EngineLock, Layout};
use super::open::{damaged, other_public_key};
use super::store::Store;
use super::telemetry::TelemetryLimits;
use super::views::Views;
use holdpoint_approvals::keyfile;

/// See the module's head.
#[derive(Debug)]
pub struct UnreadStore {
    pub(crate) layout: Layout,
    pub(crate) lock: EngineLock,
    pub(crate) key: SigningKey,
    pub(crate) created: bool,
    pub(crate) limits: TelemetryLimits,
}

impl UnreadStore {
    /// Takes the store in `folder` for this process, whether one is there or is to be made.
    ///
    /// # Errors
    /// [`StoreError`]: another engine has it, or it has lost its database or its key.
    pub fn take(folder: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::take_with(folder.as_ref(), TelemetryLimits::default())
    }

    pub(crate) fn take_with(folder: &Path, limits: TelemetryLimits) -> Result<Self, StoreError> {
        let layout = Layout::new(folder);
        layout.create()?;
        let lock = EngineLock::take(&layout)?;
        let created = std::fs::symlink_metadata(layout.database()).is_err();
        if created && !checkpoint::names(&layout.checkpoints())?.is_empty() {
            let problem = "the database is missing although there are checkpoints of it";
            return Err(damaged(&layout.database(), problem));
        }
        let key = store_key(&layout, created)?;
        Ok(Self { layout, lock, key, created, limits })
    }

    /// What its rows hold, which nobody has held against the record; `None` if the store is new. To be dropped before
    /// [`Self::read`].
    ///
    /// # Errors
    /// If the database cannot be opened.
    pub fn views(&self) -> Result<Option<Views>, StoreError> {
        if self.created { Ok(None) } else { Views::open(&self.layout.database()).map(Some) }
    }

    /// Where the store keeps what.
    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Reads the record, holds every row against it, and opens the store. `watch` is told how many records were read,
    /// some thousand at a time.
    ///
    /// # Errors
    /// [`StoreError`]; the store was not touched then.
    pub fn read(self, watch: &mut dyn FnMut(u64)) -> Result<Store, StoreError> {
        Store::on(self, watch)
    }
}

/// The store's signing key; a new one only for a new store.
fn store_key(layout: &Layout, created: bool) -> Result<SigningKey, StoreError> {
    let (secret, public) = (layout.store_key(), layout.store_public_key());
    let wrong = |source| StoreError::Key { path: secret.clone(), source };
    if created && std::fs::symlink_metadata(&secret).is_err() {
        keyfile::write_secret(&secret, &keyfile::generate().map_err(wrong)?).map_err(wrong)?;
    }
    let key = keyfile::read_secret(&secret).map_err(wrong)?;
    if std::fs::symlink_metadata(&public).is_err() {
        keyfile::write_public(&public, &key.verifying_key(), "").map_err(wrong)?;
    }
    let (beside, _) =
        keyfile::read_public(&public).map_err(|source| StoreError::Key { path: public.clone(), source })?;
    if beside != key.verifying_key() {
        return Err(other_public_key(&public));
    }
    Ok(key)
}
