//! A copy of a store, consistent while an engine runs, verified, and complete or absent.
//!
//! The database is copied at one moment (SQLite's `VACUUM INTO`), then the checkpoints of that moment, then telemetry,
//! whose sealed part was on disk before. Secret keys and recordings are copied on request, recordings only if they
//! match their records. The report names everything left out.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, DirBuilder, File, FileType, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Component, Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use serde::Serialize;
use sha2::{Digest as _, Sha256};

use crate::chain::chain_signature;
use crate::database::migrate::{STORE, TELEMETRY};
use crate::database::open::{copy_into, damaged, open_reader};
use crate::reading::export_store::until;
use crate::reading::views::Views;
use crate::terms::sqlite_error::sqlite_error;
use crate::verification::verify::{DatabaseLocation, VerifyOptions, verify_against};
use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::{name, read_all};
use holdpoint_audit::files::sync_folder;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::store_finding::OmissionCause;
use holdpoint_store::{Layout, StoreError, VerifyError, VerifyReport};
use holdpoint_text::file::{NO_LINK, regular};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use std::borrow::Cow;

/// The parts of a copy beside the database, its checkpoints and the public keys.
#[derive(Clone, Copy, Default)]
pub struct BackupParts<'a> {
    pub keys: bool,
    /// Recordings of scenes: those that this function names for the copied store.
    pub recordings: Option<&'a ListRecordings<'a>>,
}

/// Returns the recordings that a store's records name.
pub type ListRecordings<'a> = dyn Fn(&Views) -> Result<Vec<RetainedRecording>, StoreError> + 'a;

/// A recording that was closed and not removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RetainedRecording {
    /// Its name in the folder of recordings.
    pub file: String,
    /// SHA-256 of the file.
    pub sha256: Digest,
    pub bytes: u64,
}

/// A file that is missing in a copy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OmittedFile {
    pub file: String,
    pub why: OmissionCause,
    /// It is on record and must exist.
    pub bad: bool,
}

/// The most files of one folder that are copied.
const FILES_MAX: usize = 100_000;
/// The largest file of the folders of keys and of profiles, bytes: their own files are smaller.
const FILE_BYTES_MAX: u64 = 64 * 1024;
/// The depth of folders that are copied.
const DEPTH_MAX: usize = 4;
/// Temporary name of a copy that is the database alone.
const ALONE: &str = "copy.db";

/// Why there is no copy.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A backup never overwrites anything.
    #[error("{0:?} is there already, and nothing is overwritten")]
    Exists(PathBuf),
    /// The path of the copy.
    #[error("the copy would be made as {0:?}, which is there already")]
    PartExists(PathBuf),
    /// A copy in the store would be lost with it, and be part of the next one.
    #[error("{0:?} is in the store's own folder")]
    Inside(PathBuf),
    /// The copy is not sound, and was removed again.
    #[error("the copy is not sound and was removed: {0}")]
    NotSound(Box<VerifyError>),
}

impl Hint for BackupError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::Exists(path) | Self::PartExists(path) => {
                Some(ErrorDetails::of_path(ErrorReason::Exists, path))
            }
            Self::Inside(path) => Some(ErrorDetails::of_path(ErrorReason::Usage, path)),
            Self::NotSound(error) => error.details(),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Exists(_) => Some("choose a name that is not there".into()),
            Self::PartExists(_) => {
                Some("if a backup that was ended left it, remove it; or choose another name".into())
            }
            Self::Inside(_) => Some("choose a place outside of it, best on another disk".into()),
            Self::NotSound(_) => {
                Some("`holdpoint audit verify` says whether the store itself is sound".into())
            }
        }
    }
}

/// A finished copy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BackupReport {
    /// The verifier's report of the copy.
    pub verified: VerifyReport,
    pub files: u64,
    pub bytes: u64,
    /// Whether secret keys are among them.
    pub keys: bool,
    /// Copied recordings, each equal to its record.
    pub recordings: u64,
    /// Requested recordings that are missing in the copy.
    pub left_out: Vec<OmittedFile>,
}

/// Copies a store. `to` must not exist: with the ending `db` it becomes the database alone, else a folder.
///
/// # Errors
/// [`BackupError`]; nothing is left then.
pub fn backup(folder: &Path, to: &Path, parts: BackupParts<'_>) -> Result<BackupReport, BackupError> {
    let layout = Layout::new(folder);
    if fs::symlink_metadata(to).is_ok() {
        return Err(BackupError::Exists(to.to_owned()));
    }
    let parent = to.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let whole = |path: &Path| fs::canonicalize(path).map_err(StoreError::io("find", path));
    if whole(parent)?.starts_with(whole(folder)?) {
        return Err(BackupError::Inside(to.to_owned()));
    }
    // Only files made here are ever removed.
    let part = part_of(to)?;
    match DirBuilder::new().mode(0o700).create(&part) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => return Err(BackupError::PartExists(part)),
        made => made.map_err(StoreError::io("make the folder", &part))?,
    }
    let alone = to.extension().is_some_and(|ending| ending == "db");
    let report = make(&layout, &part, alone, parts).and_then(|report| {
        let whole = if alone { part.join(ALONE) } else { part.clone() };
        renameat_with(CWD, &whole, CWD, to, RenameFlags::NOREPLACE)
            .map_err(|error| StoreError::io("rename", &whole)(error.into()))?;
        sync_folder(parent).map_err(StoreError::from)?;
        Ok(report)
    });
    if report.is_err() || alone {
        // The first error matters more than a leftover.
        drop(fs::remove_dir_all(&part));
    }
    report
}

/// The folder in which the copy is made.
fn part_of(to: &Path) -> Result<PathBuf, StoreError> {
    let name =
        to.file_name().ok_or_else(|| StoreError::invalid("copy", to.display(), "a new file or folder"))?;
    let mut part = name.to_owned();
    part.push(".part");
    Ok(to.with_file_name(part))
}

fn make(
    layout: &Layout,
    part: &Path,
    alone: bool,
    parts: BackupParts<'_>,
) -> Result<BackupReport, BackupError> {
    let key = keyfile::read_public(&layout.store_public_key()).ok().map(|(key, _)| key);
    let options =
        VerifyOptions { key: key.as_ref(), against: &[], place: DatabaseLocation::Copy, tell: &|_, _, _| {} };
    let mut scenes = RecordingCopies::default();
    let database = if alone {
        let database = part.join(ALONE);
        copy_into(&layout.database(), &STORE, &database)?;
        sync(&database)?;
        database
    } else {
        copy_folder(layout, part, parts, &mut scenes)?
    };
    let verified = match verify_against(&database, &options) {
        Ok(verified) => verified,
        Err(VerifyError::Unreadable(error)) => return Err(error.into()),
        Err(error) => return Err(BackupError::NotSound(Box::new(error))),
    };
    let (mut files, mut bytes) = (0, 0);
    count(if alone { &database } else { part }, &mut files, &mut bytes)?;
    let RecordingCopies { copied, left_out } = scenes;
    Ok(BackupReport { verified, files, bytes, keys: parts.keys && !alone, recordings: copied, left_out })
}

#[derive(Default)]
struct RecordingCopies {
    copied: u64,
    left_out: Vec<OmittedFile>,
}

/// Fills the folder of a copy. Returns its database.
fn copy_folder(
    layout: &Layout,
    part: &Path,
    parts: BackupParts<'_>,
    scenes: &mut RecordingCopies,
) -> Result<PathBuf, StoreError> {
    let copy = Layout::new(part);
    let secret = |path: &Path| path.extension().is_none_or(|ending| ending != "pub");
    let wanted_key = |path: &Path| parts.keys || !secret(path);
    // Before the database, which takes its time.
    check_tree(&layout.keys(), DEPTH_MAX, &wanted_key)?;
    check_tree(&layout.profiles(), DEPTH_MAX, &|_| true)?;
    for folder in [part.to_owned(), copy.keys(), copy.identities(), copy.checkpoints()] {
        make_folder(&folder)?;
    }
    copy_into(&layout.database(), &STORE, &copy.database())?;
    let connection = open_reader(&copy.database(), &STORE)?;
    let end = chain_signature::read(&connection).map_err(|problem| damaged(&layout.database(), &problem))?;
    let last = crate::chain::audit::head(&connection).map_err(sqlite_error("read the audit chain"))?.seq;
    drop(connection);
    let checkpoints = read_all(&layout.checkpoints())
        .map_err(|bad| damaged(&layout.checkpoints().join(bad.file), &bad.problem))?;
    for stored in until(checkpoints, end.as_ref(), last) {
        copy_file(
            &layout.checkpoints().join(&stored.file),
            &copy.checkpoints().join(name(stored.checkpoint.seq)),
        )?;
    }
    if layout.telemetry().is_file() {
        copy_into(&layout.telemetry(), &TELEMETRY, &copy.telemetry())?;
    }
    copy_tree(&layout.keys(), &copy.keys(), DEPTH_MAX, &wanted_key)?;
    copy_tree(&layout.profiles(), &copy.profiles(), DEPTH_MAX, &|_| true)?;
    if let Some(recordings_of) = parts.recordings {
        let on_record = recordings_of(&Views::open(&copy.database())?)?;
        copy_recordings(layout, &copy, &on_record, scenes)?;
    }
    sync_tree(part)?;
    Ok(copy.database())
}

/// Copies the recordings on record, each only if it matches its record, and no more bytes than recorded.
fn copy_recordings(
    layout: &Layout,
    copy: &Layout,
    on_record: &[RetainedRecording],
    scenes: &mut RecordingCopies,
) -> Result<(), StoreError> {
    make_folder(&copy.recordings())?;
    let folder = layout.recordings();
    let mut named = BTreeSet::new();
    for recording in on_record {
        let plain = Path::new(&recording.file).components().eq([Component::Normal(recording.file.as_ref())]);
        let why = if plain {
            copy_recording(&folder, &copy.recordings(), recording)?
        } else {
            Some(OmissionCause::NoFileName)
        };
        match why {
            None => scenes.copied += 1,
            Some(why) => {
                let file = recording.file.clone();
                scenes.left_out.push(OmittedFile { file, why, bad: true });
            }
        }
        named.insert(recording.file.as_str());
    }
    if !folder.is_dir() {
        return Ok(());
    }
    let mut others = Vec::new();
    for entry in fs::read_dir(&folder).map_err(StoreError::io("list", &folder))?.take(FILES_MAX) {
        let name = entry.map_err(StoreError::io("list", &folder))?.file_name();
        let name = name.to_string_lossy().into_owned();
        if !named.contains(name.as_str()) {
            others.push(OmittedFile { file: name, why: OmissionCause::NotOnRecord, bad: false });
        }
    }
    others.sort_by(|a, b| a.file.cmp(&b.file));
    scenes.left_out.extend(others);
    Ok(())
}

/// Copies a recording. Returns the cause if it does not match its record.
fn copy_recording(
    folder: &Path,
    to: &Path,
    recording: &RetainedRecording,
) -> Result<Option<OmissionCause>, StoreError> {
    let (from, to) = (folder.join(&recording.file), to.join(&recording.file));
    let open = OpenOptions::new().read(true).custom_flags(NO_LINK).open(&from);
    let file = match open {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            return Ok(Some(OmissionCause::Missing));
        }
        open => match open.and_then(regular) {
            Ok(file) => file,
            Err(_) => return Ok(Some(OmissionCause::Unreadable)),
        },
    };
    let bytes = file.metadata().map_err(StoreError::io("read", &from))?.len();
    if bytes != recording.bytes {
        return Ok(Some(OmissionCause::OtherSize));
    }
    let mut into = File::create_new(&to).map_err(StoreError::io("write", &to))?;
    let (mut hasher, mut piece) = (Sha256::new(), vec![0; PIECE_BYTES]);
    let mut file = file.take(recording.bytes);
    loop {
        let count = file.read(&mut piece).map_err(StoreError::io("read", &from))?;
        let Some(read) = piece.get(..count).filter(|read| !read.is_empty()) else { break };
        hasher.update(read);
        into.write_all(read).map_err(StoreError::io("write", &to))?;
    }
    if Digest::from_bytes(hasher.finalize().into()) == recording.sha256 {
        return Ok(None);
    }
    fs::remove_file(&to).map_err(StoreError::io("remove", &to))?;
    Ok(Some(OmissionCause::OtherDigest))
}

/// Bytes of a recording that are read at a time.
const PIECE_BYTES: usize = 1 << 16;

fn make_folder(path: &Path) -> Result<(), StoreError> {
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(path)
        .map_err(StoreError::io("make the folder", path))
}

/// An entry of a store's folder that is read: a wanted file, or a folder.
type FileFilter<'a> = &'a dyn Fn(&Path) -> bool;

/// The wanted files of a folder, and its folders; links are left out. `None` if there is no such folder.
fn listed(
    from: &Path,
    depth: usize,
    wanted: FileFilter<'_>,
) -> Result<Option<Vec<(OsString, FileType)>>, StoreError> {
    match fs::symlink_metadata(from) {
        Ok(found) if found.is_dir() && depth > 0 => {}
        // The target of a link is not part of the store, or is a part with its own option.
        Ok(found) if found.is_symlink() => {
            return Err(StoreError::invalid(
                "folder",
                from.display(),
                "a folder of the store itself, and no link",
            ));
        }
        Ok(_) => return Ok(None),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(StoreError::io("read", from)(error)),
    }
    let mut found = Vec::new();
    for (nth, entry) in fs::read_dir(from).map_err(StoreError::io("list", from))?.enumerate() {
        let entry = entry.map_err(StoreError::io("list", from))?;
        if nth >= FILES_MAX {
            return Err(StoreError::invalid("folder", from.display(), format!("at most {FILES_MAX} files")));
        }
        let kind = entry.file_type().map_err(StoreError::io("read", &entry.path()))?;
        if kind.is_dir() || (kind.is_file() && wanted(&entry.path())) {
            found.push((entry.file_name(), kind));
        }
    }
    Ok(Some(found))
}

/// Refuses a folder in which a wanted file is too large.
fn check_tree(from: &Path, depth: usize, wanted: FileFilter<'_>) -> Result<(), StoreError> {
    for (name, kind) in listed(from, depth, wanted)?.into_iter().flatten() {
        let path = from.join(name);
        if kind.is_dir() {
            check_tree(&path, depth - 1, wanted)?;
            continue;
        }
        check_size(&path, fs::symlink_metadata(&path).map_err(StoreError::io("read", &path))?.len())?;
    }
    Ok(())
}

fn check_size(path: &Path, bytes: u64) -> Result<(), StoreError> {
    if bytes <= FILE_BYTES_MAX {
        return Ok(());
    }
    let allowed = format!("it has {bytes} bytes, and a key or a profile has at most {FILE_BYTES_MAX}");
    Err(StoreError::invalid("file", path.display(), allowed))
}

/// Copies the wanted files of a folder and of its folders.
fn copy_tree(from: &Path, to: &Path, depth: usize, wanted: FileFilter<'_>) -> Result<(), StoreError> {
    let Some(found) = listed(from, depth, wanted)? else { return Ok(()) };
    make_folder(to)?;
    for (name, kind) in found {
        let (path, copy) = (from.join(&name), to.join(&name));
        if kind.is_dir() {
            copy_tree(&path, &copy, depth - 1, wanted)?;
        } else {
            copy_file(&path, &copy)?;
        }
    }
    Ok(())
}

/// Copies a file with the owner's part of its permissions.
fn copy_file(from: &Path, to: &Path) -> Result<(), StoreError> {
    let file = OpenOptions::new().read(true).custom_flags(NO_LINK).open(from).and_then(regular);
    let file = file.map_err(StoreError::io("read", from))?;
    let mode = file.metadata().map_err(StoreError::io("read", from))?.permissions().mode() & 0o700;
    let into = OpenOptions::new().write(true).create_new(true).mode(0o600).open(to);
    let mut into = into.map_err(StoreError::io("write", to))?;
    // It may have grown since the check.
    let copied =
        io::copy(&mut file.take(FILE_BYTES_MAX + 1), &mut into).map_err(StoreError::io("copy", from))?;
    check_size(from, copied)?;
    into.set_permissions(fs::Permissions::from_mode(mode)).map_err(StoreError::io("write", to))
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
    Ok(sync_folder(folder)?)
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
