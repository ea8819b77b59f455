//! A store that belongs to this process and whose record was not read yet: its rows can be shown, marked as unverified,
//! and nothing can be written.

use std::path::Path;

use ed25519_dalek::SigningKey;

use super::checkpoint;
use super::error::StoreError;
use super::layout::{EngineLock, Layout, sync_folder};
use super::open::{damaged, other_public_key};
use super::store::Store;
use super::telemetry::TelemetryLimits;
use super::views::Views;
use holdpoint_approvals::keyfile;

/// The most keys that are set aside in one store.
const ASIDES_MAX: u32 = 99;

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
        if created {
            if let Some(left) = left_behind(&layout)? {
                let problem = format!("the database is missing although {left}");
                return Err(damaged(&layout.database(), &problem));
            }
            set_key_aside(&layout)?;
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

/// What tells that a store was here before, if anything does: its database was taken away, and no new history may begin in its
/// place as if it were the same store.
fn left_behind(layout: &Layout) -> Result<Option<&'static str>, StoreError> {
    if !checkpoint::names(&layout.checkpoints())?.is_empty() {
        return Ok(Some("there are checkpoints of it"));
    }
    let telemetry = layout.telemetry();
    if std::fs::symlink_metadata(&telemetry).is_ok() {
        return Ok(Some("there is the telemetry of a store"));
    }
    for (folder, what) in [
        (layout.recordings(), "there are recordings of a store"),
        (layout.compiled(), "there are compiled forms of a store"),
    ] {
        // A folder that is not there has nothing in it.
        let holds = std::fs::read_dir(&folder).is_ok_and(|mut entries| entries.next().is_some());
        if holds {
            return Ok(Some(what));
        }
    }
    Ok(None)
}

/// A new store gets a key of its own, and with it a name of its own. A key that lies there, of a store whose creation was cut
/// off or of one that was taken away, is set aside and not thrown away: a backup may yet need it.
fn set_key_aside(layout: &Layout) -> Result<(), StoreError> {
    for path in [layout.store_key(), layout.store_public_key()] {
        if std::fs::symlink_metadata(&path).is_err() {
            continue;
        }
        let asides =
            (1..=ASIDES_MAX).map(|turn| path.with_extension(format!("{}.aside-{turn}", ending(&path))));
        let free = asides.into_iter().find(|aside| std::fs::symlink_metadata(aside).is_err());
        let Some(free) = free else {
            let problem = format!("{ASIDES_MAX} keys were set aside already; remove some");
            return Err(damaged(&path, &problem));
        };
        std::fs::rename(&path, &free).map_err(StoreError::io("set aside", &path))?;
    }
    sync_folder(&layout.keys())
}

fn ending(path: &Path) -> String {
    path.extension().map_or_else(String::new, |ending| ending.to_string_lossy().into_owned())
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
