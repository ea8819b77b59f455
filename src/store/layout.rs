//! The layout of a store: the folder, its files, and the lock that gives it to one engine.

use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::StoreError;
use crate::stop_mark::StopMarks;
use holdpoint_audit::files::sync_folder;
use holdpoint_governance::calendar;
use holdpoint_text::file::{NO_LINK, kind_of, regular};
use holdpoint_text::users::described_user;

/// The paths of one store.
#[derive(Clone, Debug)]
pub struct Layout {
    folder: PathBuf,
}

impl Layout {
    /// The layout of the store in `folder`; nothing is touched.
    #[must_use]
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Registry, evidence, approvals and audit chain.
    #[must_use]
    pub fn database(&self) -> PathBuf {
        self.folder.join("holdpoint.db")
    }

    /// Telemetry batches and cached results.
    #[must_use]
    pub fn telemetry(&self) -> PathBuf {
        self.folder.join("telemetry.db")
    }

    /// Compiled components; their sources are in the database.
    #[must_use]
    pub fn compiled(&self) -> PathBuf {
        self.folder.join("compiled")
    }

    /// The lock of the engine that has the store.
    #[must_use]
    pub fn lock(&self) -> PathBuf {
        self.folder.join("engine.lock")
    }

    #[must_use]
    pub fn keys(&self) -> PathBuf {
        self.folder.join("keys")
    }

    #[must_use]
    pub fn identities(&self) -> PathBuf {
        self.folder.join("keys").join("identities")
    }

    /// The key that signs checkpoints.
    #[must_use]
    pub fn store_key(&self) -> PathBuf {
        self.keys().join("store.key")
    }

    #[must_use]
    pub fn store_public_key(&self) -> PathBuf {
        self.keys().join("store.pub")
    }

    /// Signed checkpoints of the audit chain.
    #[must_use]
    pub fn checkpoints(&self) -> PathBuf {
        self.folder.join("checkpoints")
    }

    #[must_use]
    pub fn recordings(&self) -> PathBuf {
        self.folder.join("recordings")
    }

    /// Profiles of the site's own, with their policies.
    #[must_use]
    pub fn profiles(&self) -> PathBuf {
        self.folder.join("profiles")
    }

    #[must_use]
    pub fn logs(&self) -> PathBuf {
        self.folder.join("logs")
    }

    /// The file for a person's stop of the cell that could not be recorded.
    #[must_use]
    pub fn stop_marks(&self) -> StopMarks {
        StopMarks::of(self)
    }

    /// The mark that requests a stop of the cell, for use when the socket does not respond.
    #[must_use]
    pub fn stop_request(&self) -> PathBuf {
        self.folder.join("stop.asked")
    }

    /// Makes the missing folders, accessible to their owner only.
    ///
    /// # Errors
    /// If one cannot be made or written to.
    pub fn create(&self) -> Result<(), StoreError> {
        let folders = [
            self.folder.clone(),
            self.keys(),
            self.identities(),
            self.checkpoints(),
            self.recordings(),
            self.logs(),
        ];
        // Made when the first compiled form is stored.
        let compiled = fs::symlink_metadata(self.compiled()).is_ok().then(|| self.compiled());
        let new = !self.keys().is_dir();
        for path in folders.into_iter().chain(compiled) {
            // Its files would end up elsewhere. The store itself may lie behind a link.
            if path != self.folder
                && let Ok(found) = fs::symlink_metadata(&path)
                && !found.is_dir()
            {
                let kind = kind_of(&found);
                let allowed = format!(
                    "a folder of the store's own, not {kind}; to keep it on another disk, mount that here"
                );
                return Err(StoreError::invalid("store folder", path.display(), allowed));
            }
            let made = DirBuilder::new().recursive(true).mode(0o700).create(&path);
            made.map_err(|error| match other_owner(&self.folder) {
                Some(other) => other,
                None => StoreError::io("make the store folder", &path)(error),
            })?;
        }
        if new {
            sync_folder(&self.folder)?;
            // If the parent folder cannot be read, the system checks it.
            drop(self.folder.parent().map(sync_folder));
        }
        Ok(())
    }
}

/// The error for a store's folder that another user owns and does not share; `None` for every other folder.
#[must_use]
pub fn other_owner(folder: &Path) -> Option<StoreError> {
    let own = rustix::process::geteuid().as_raw();
    let owner = fs::metadata(folder).ok()?.uid();
    let is_closed = rustix::fs::access(folder, rustix::fs::Access::EXEC_OK).is_err();
    (owner != own && is_closed).then(|| StoreError::OtherUser {
        path: folder.to_owned(),
        owner: described_user(owner),
        own: described_user(own),
    })
}

/// The store belongs to this engine until this value is dropped or the process ends.
///
/// Locks the folder itself, which cannot be deleted while it has entries. It also locks a file that names the owner,
/// for earlier versions of the program.
#[derive(Debug)]
pub struct EngineLock {
    folder: File,
    file: File,
}

impl Drop for EngineLock {
    fn drop(&mut self) {
        // A starting child inherits both descriptors until it runs its own program; the lock ends here all the same.
        for lock in [&self.file, &self.folder] {
            drop(lock.unlock());
        }
    }
}

impl EngineLock {
    /// Takes the lock, or returns its holder.
    ///
    /// # Errors
    /// [`StoreError::InUse`] with the first engine's process id and start; [`StoreError::Io`].
    pub fn take(layout: &Layout) -> Result<Self, StoreError> {
        let path = layout.lock();
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            // The content must not be written through a link.
            .custom_flags(NO_LINK)
            .open(&path)
            .and_then(regular)
            .map_err(StoreError::io("open the engine lock", &path))?;
        let folder = File::open(layout.folder()).map_err(StoreError::io("open", layout.folder()))?;
        for (lock, named) in [(&folder, layout.folder()), (&file, path.as_path())] {
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    let mut owner = String::new();
                    let read = (&file).take(200).read_to_string(&mut owner).is_ok();
                    let owner = owner.trim_end();
                    let owner = if read && owner.starts_with("process ") { owner } else { "another process" };
                    let owner = owner.to_owned();
                    return Err(StoreError::InUse { path: layout.folder().to_owned(), owner });
                }
                Err(TryLockError::Error(source)) => return Err(StoreError::io("lock", named)(source)),
            }
        }
        let text = format!("process {} since {}\n", std::process::id(), utc_now());
        file.set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| file.write_all(text.as_bytes()))
            .map_err(StoreError::io("write the engine lock", &path))?;
        Ok(Self { folder, file })
    }
}

/// The engine that has the store, `None` if it is free. The lock taken for this check is released at once.
///
/// # Errors
/// If the store's folder cannot be looked at.
pub fn lock_owner(layout: &Layout) -> Result<Option<String>, StoreError> {
    let folder = File::open(layout.folder()).map_err(StoreError::io("open", layout.folder()))?;
    match folder.try_lock_shared() {
        Ok(()) => {
            drop(folder.unlock());
            Ok(None)
        }
        Err(TryLockError::WouldBlock) => {
            let mut owner = String::new();
            let read = OpenOptions::new()
                .read(true)
                .custom_flags(NO_LINK)
                .open(layout.lock())
                .and_then(regular)
                .and_then(|file| file.take(200).read_to_string(&mut owner));
            let known = read.is_ok() && owner.starts_with("process ");
            Ok(Some(if known { owner.trim_end().to_owned() } else { "another process".to_owned() }))
        }
        Err(TryLockError::Error(source)) => Err(StoreError::io("lock", layout.folder())(source)),
    }
}

/// The present wall time as text, UTC.
fn utc_now() -> String {
    let secs = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    utc(secs)
}

/// A size as text, in the largest fitting unit.
#[must_use]
pub fn size(bytes: u64) -> String {
    let units = [("GiB", 1_u64 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];
    units.into_iter().find(|(_, unit)| bytes >= *unit).map_or_else(
        || format!("{bytes} B"),
        // A fraction of a unit to one digit.
        |(name, unit)| format!("{:.1} {name}", bytes as f64 / unit as f64),
    )
}

/// Seconds since 1970 as `2026-11-21 02:10:24 UTC`.
#[must_use]
pub fn utc(secs: u64) -> String {
    let ms = i64::try_from(secs).unwrap_or(i64::MAX).saturating_mul(1_000);
    calendar::formatted(ms, "%F %T UTC")
}

#[cfg(test)]
mod tests {
    use super::size;

    #[test]
    fn sizes_are_formatted() {
        for (bytes, text) in [
            (0, "0 B"),
            (1_023, "1023 B"),
            (1_536, "1.5 KiB"),
            (5 << 20, "5.0 MiB"),
            (1_023 << 20, "1023.0 MiB"),
            (37 << 30, "37.0 GiB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }
}
