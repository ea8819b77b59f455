//! A locked store whose record was not read yet: its rows can be shown, marked as unverified, and nothing can be
//! written.

use std::path::Path;

use ed25519_dalek::SigningKey;

use crate::database::open::{damaged, refused};
use crate::reading::views::Views;
use crate::telemetry::telemetry_file::TelemetryLimits;
use crate::writer::store::Store;
use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint;
use holdpoint_audit::files::sync_folder;
use holdpoint_store::{EngineLock, Layout, RefusalCause, StoreError};

/// The most replaced keys that one store keeps.
const QUARANTINED_KEYS_MAX: u32 = 99;

/// See the module's head.
#[derive(Debug)]
pub struct UnverifiedStore {
    pub(crate) layout: Layout,
    pub(crate) lock: EngineLock,
    pub(crate) key: SigningKey,
    pub(crate) created: bool,
    pub(crate) limits: TelemetryLimits,
}

impl UnverifiedStore {
    /// Locks the store in `folder` for this process, an existing or a new one.
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
            if let Some(left) = earlier_store_sign(&layout)? {
                let problem = format!("the database is missing although {left}");
                return Err(damaged(&layout.database(), &problem));
            }
            set_key_aside(&layout)?;
        }
        let key = store_key(&layout, created)?;
        Ok(Self { layout, lock, key, created, limits })
    }

    /// Its unverified rows; `None` if the store is new. Drop it before [`Self::read`].
    ///
    /// # Errors
    /// If the database cannot be opened.
    pub fn views(&self) -> Result<Option<Views>, StoreError> {
        if self.created { Ok(None) } else { Views::open(&self.layout.database()).map(Some) }
    }

    /// The paths of the store.
    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Reads the record, compares every row with it, and opens the store. `watch` gets the number of records read,
    /// every few thousand.
    ///
    /// # Errors
    /// [`StoreError`]; the store was not touched then.
    pub fn read(self, watch: &mut dyn FnMut(u64)) -> Result<Store, StoreError> {
        Store::on(self, watch)
    }
}

/// Evidence of an earlier store here, if any: its database was removed, and a new history must not continue under its
/// identity.
fn earlier_store_sign(layout: &Layout) -> Result<Option<&'static str>, StoreError> {
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
        // A missing folder is empty.
        let holds = std::fs::read_dir(&folder).is_ok_and(|mut entries| entries.next().is_some());
        if holds {
            return Ok(Some(what));
        }
    }
    Ok(None)
}

/// A new store gets its own key, and so its own id. An existing key, of an interrupted creation or a removed store, is
/// renamed and kept: a backup may need it.
fn set_key_aside(layout: &Layout) -> Result<(), StoreError> {
    for path in [layout.store_key(), layout.store_public_key()] {
        if std::fs::symlink_metadata(&path).is_err() {
            continue;
        }
        let asides = (1..=QUARANTINED_KEYS_MAX)
            .map(|turn| path.with_extension(format!("{}.aside-{turn}", ending(&path))));
        let free = asides.into_iter().find(|aside| std::fs::symlink_metadata(aside).is_err());
        let Some(free) = free else {
            let problem = format!("{QUARANTINED_KEYS_MAX} replaced keys are kept already; remove some");
            return Err(damaged(&path, &problem));
        };
        std::fs::rename(&path, &free).map_err(StoreError::io("set aside", &path))?;
    }
    Ok(sync_folder(&layout.keys())?)
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
        let problem = "it is not of the secret key store.key beside it";
        return Err(refused(&public, problem, RefusalCause::KeyHalves));
    }
    Ok(key)
}
