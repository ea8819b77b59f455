//! A copy of a store, consistent while an engine works on it, verified, and there whole or not at all.
//!
//! The database is copied at one moment (SQLite's `VACUUM INTO`), then the checkpoints of that moment, then telemetry:
//! what the chain seals of it was on disk before. Secrets stay where they are unless they are asked for.

use std::fs::{self, DirBuilder, File};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::Serialize;

use super::checkpoint::{name, read_all};
use super::error::StoreError;
use super::exported::until;
use super::layout::{Layout, sync_folder};
use super::migrate::{STORE, TELEMETRY};
use super::open::{copy_into, damaged, open_reader, remove_database};
use super::signed;
use super::unsound::VerifyError;
use super::verify::{JudgedBy, Place, VerifyReport, verify_against};
use holdpoint_approvals::keyfile;
use holdpoint_text::Hint;
use std::borrow::Cow;

/// What a copy holds beside the database, its checkpoints and the public keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackupParts {
    /// Secret keys.
    pub keys: bool,
    /// Recordings of scenes.
    pub recordings: bool,
}

/// The most files of one folder that are copied.
const FILES_MAX: usize = 100_000;
/// Folders below each other that are copied.
const DEPTH_MAX: usize = 4;

/// A copy that was not made.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    #[error(transparent)]
    Store(#[from] StoreError),
    /// What was copied is not sound; the copy is gone again.
    #[error("the copy is not sound and was removed: {0}")]
    NotSound(Box<VerifyError>),
}

impl Hint for BackupError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::NotSound(_) => {
                Some("`holdpoint audit verify` says whether the store itself is sound".into())
            }
        }
    }
}

/// What was copied.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BackupReport {
    /// What the verifier says of the copy.
    pub verified: VerifyReport,
    pub files: u64,
    pub bytes: u64,
    /// Whether secret keys are among them.
    pub keys: bool,
}

/// Copies a store. `to` must not exist: with the ending `db` it becomes the database alone, else a folder.
///
/// # Errors
/// [`BackupError`]; nothing is left then.
pub fn backup(folder: &Path, to: &Path, parts: BackupParts) -> Result<BackupReport, BackupError> {
    let layout = Layout::new(folder);
    if fs::symlink_metadata(to).is_ok() {
        return Err(StoreError::Exists { what: "file or folder", name: to.display().to_string() }.into());
    }
    let beside = part_of(to)?;
    remove(&beside)?;
    let made = make(&layout, &beside, to, parts).and_then(|report| {
        renameat_with(CWD, &beside, CWD, to, RenameFlags::NOREPLACE)
            .map_err(|error| StoreError::io("rename", &beside)(error.into()))?;
        to.parent().filter(|parent| !parent.as_os_str().is_empty()).map_or(Ok(()), sync_folder)?;
        Ok(report)
    });
    if made.is_err() {
        // What went wrong matters more than a leftover, which the next one removes.
        drop(remove(&beside));
    }
    made
}

/// The name under which the copy is made.
fn part_of(to: &Path) -> Result<PathBuf, StoreError> {
    let name =
        to.file_name().ok_or_else(|| StoreError::invalid("copy", to.display(), "a new file or folder"))?;
    let mut part = name.to_owned();
    part.push(".part");
    Ok(to.with_file_name(part))
}

fn remove(path: &Path) -> Result<(), StoreError> {
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => fs::remove_dir_all(path).map_err(StoreError::io("remove", path)),
        Ok(_) => remove_database(path),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(StoreError::io("read", path)(error)),
    }
}

fn make(layout: &Layout, part: &Path, to: &Path, parts: BackupParts) -> Result<BackupReport, BackupError> {
    let key = keyfile::read_public(&layout.store_public_key()).ok().map(|(key, _)| key);
    let judged = JudgedBy { key: key.as_ref(), against: &[], place: Place::Copy, tell: &|_, _, _| {} };
    let alone = to.extension().is_some_and(|ending| ending == "db");
    let database = if alone { part.to_owned() } else { copy_folder(layout, part, parts)? };
    if alone {
        copy_into(&layout.database(), &STORE, part)?;
        sync(part)?;
    }
    let verified = match verify_against(&database, &judged) {
        Ok(verified) => verified,
        Err(VerifyError::Unreadable(error)) => return Err(error.into()),
        Err(error) => return Err(BackupError::NotSound(Box::new(error))),
    };
    let (mut files, mut bytes) = (0, 0);
    count(part, &mut files, &mut bytes)?;
    Ok(BackupReport { verified, files, bytes, keys: parts.keys && !alone })
}

/// Fills the folder of a copy. Tells its database.
fn copy_folder(layout: &Layout, part: &Path, parts: BackupParts) -> Result<PathBuf, StoreError> {
    let copy = Layout::new(part);
    for folder in [part.to_owned(), copy.keys(), copy.identities(), copy.checkpoints()] {
        make_folder(&folder)?;
    }
    copy_into(&layout.database(), &STORE, &copy.database())?;
    let connection = open_reader(&copy.database(), &STORE)?;
    let end = signed::read(&connection).map_err(|problem| damaged(&layout.database(), &problem))?;
    let last = super::audit::head(&connection).map_err(StoreError::sql("read the audit chain"))?.seq;
    drop(connection);
    let kept = read_all(&layout.checkpoints())
        .map_err(|bad| damaged(&layout.checkpoints().join(bad.file), &bad.problem))?;
    for kept in until(kept, end.as_ref(), last) {
        copy_file(
            &layout.checkpoints().join(&kept.file),
            &copy.checkpoints().join(name(kept.checkpoint.seq)),
        )?;
    }
    if layout.telemetry().is_file() {
        copy_into(&layout.telemetry(), &TELEMETRY, &copy.telemetry())?;
    }
    let secret = |path: &Path| path.extension().is_none_or(|ending| ending != "pub");
    copy_tree(&layout.keys(), &copy.keys(), DEPTH_MAX, &|path| parts.keys || !secret(path))?;
    copy_tree(&layout.profiles(), &copy.profiles(), DEPTH_MAX, &|_| true)?;
    if parts.recordings {
        copy_tree(&layout.recordings(), &copy.recordings(), DEPTH_MAX, &|_| true)?;
    }
    sync_tree(part)?;
    Ok(copy.database())
}

fn make_folder(path: &Path) -> Result<(), StoreError> {
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
        .map_err(StoreError::io("make the folder", path))
}

/// Copies the files of a folder that are wanted, and those of the folders in it; links are left out.
fn copy_tree(from: &Path, to: &Path, depth: usize, wanted: &dyn Fn(&Path) -> bool) -> Result<(), StoreError> {
    if depth == 0 || !from.is_dir() {
        return Ok(());
    }
    make_folder(to)?;
    for (nth, entry) in fs::read_dir(from).map_err(StoreError::io("list", from))?.enumerate() {
        let entry = entry.map_err(StoreError::io("list", from))?;
        if nth >= FILES_MAX {
            return Err(StoreError::invalid("folder", from.display(), format!("at most {FILES_MAX} files")));
        }
        let (path, copy) = (entry.path(), to.join(entry.file_name()));
        let kind = entry.file_type().map_err(StoreError::io("read", &path))?;
        if kind.is_dir() {
            copy_tree(&path, &copy, depth - 1, wanted)?;
        } else if kind.is_file() && wanted(&path) {
            copy_file(&path, &copy)?;
        }
    }
    Ok(())
}

/// Copies a file with its permissions, of which the copy has those of its owner.
fn copy_file(from: &Path, to: &Path) -> Result<(), StoreError> {
    fs::copy(from, to).map_err(StoreError::io("copy", from))?;
    let mode = fs::metadata(from).map_err(StoreError::io("read", from))?.permissions().mode() & 0o700;
    fs::set_permissions(to, fs::Permissions::from_mode(mode)).map_err(StoreError::io("write", to))
}

fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(StoreError::io("write", path))
}

fn sync_tree(folder: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(folder).map_err(StoreError::io("list", folder))? {
        let path = entry.map_err(StoreError::io("list", folder))?.path();
        if path.is_dir() {
            sync_tree(&path)?;
        } else {
            sync(&path)?;
        }
    }
    sync_folder(folder)
}

/// Adds up the files of a folder.
pub(crate) fn count(path: &Path, files: &mut u64, bytes: &mut u64) -> Result<(), StoreError> {
    let found = fs::symlink_metadata(path).map_err(StoreError::io("read", path))?;
    if !found.is_dir() {
        *files += 1;
        *bytes += found.len();
        return Ok(());
    }
    for entry in fs::read_dir(path).map_err(StoreError::io("list", path))? {
        count(&entry.map_err(StoreError::io("list", path))?.path(), files, bytes)?;
    }
    Ok(())
}
