//! Copies of recordings that end at a chosen tick, for the viewer: their folder, and the removal of old ones.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::error::CliError;
use crate::scenes;
use holdpoint_text::{ErrorDetails, ErrorReason};

/// The prefix of this verb's folders.
const PREFIX: &str = "holdpoint-replay-";

/// How long a folder is kept for a viewer that reads from it.
const KEPT: Duration = Duration::from_hours(24);

/// The most entries of the temporary folder that are checked.
const ENTRIES_MAX: usize = 10_000;

/// A new private folder among the temporary ones. It outlives this program, because the viewer does; folders of
/// earlier calls are removed after a day.
///
/// # Errors
/// If it cannot be created.
pub(super) fn scratch() -> Result<PathBuf, CliError> {
    let among = std::env::temp_dir();
    clean(&among, SystemTime::now());
    let made = tempfile::Builder::new().prefix(PREFIX).tempdir_in(&among);
    let made = made.map_err(|error| {
        CliError::usage(format!("cannot create a folder in {among:?}: {error}"))
            .with_unwritable(&among, &error)
    })?;
    Ok(made.keep())
}

/// Removes this user's old folders. Errors are ignored: nothing depends on it.
fn clean(among: &Path, now: SystemTime) {
    let Ok(entries) = fs::read_dir(among) else { return };
    let own = rustix::process::getuid().as_raw();
    for entry in entries.take(ENTRIES_MAX).flatten() {
        if !entry.file_name().to_string_lossy().starts_with(PREFIX) {
            continue;
        }
        let Ok(about) = fs::symlink_metadata(entry.path()) else { continue };
        let age = about.modified().ok().and_then(|written| now.duration_since(written).ok());
        if about.is_dir() && about.uid() == own && age.is_some_and(|age| age > KEPT) {
            drop(fs::remove_dir_all(entry.path()));
        }
    }
}

/// Copies of the files with nothing later than `tick`, in the folder `scratch`.
///
/// # Errors
/// If one cannot be read or written, or this program was built without scenes.
pub(super) fn cut(files: &[PathBuf], tick: u64, scratch: &Path) -> Result<Vec<PathBuf>, CliError> {
    let mut cut = Vec::new();
    for (place, path) in files.iter().enumerate() {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let out = scratch.join(format!("{place}-{name}-to-{tick}.rrd"));
        scenes::until(path, tick, &out)?;
        cut.push(out);
    }
    Ok(cut)
}

/// A copy of the only file with nothing later than `tick`, as the new file `out`.
///
/// # Errors
/// If there are several files or `out` is there already; else as [`cut`].
pub(super) fn write(files: &[PathBuf], tick: u64, out: &Path) -> Result<(), CliError> {
    let [path] = files else {
        let text = format!("the recording has {} files, and --out writes only one", files.len());
        return Err(CliError::usage(text).with_hint("name a file instead of the version"));
    };
    if fs::symlink_metadata(out).is_ok() {
        let text = format!("cannot write {out:?}: it exists already");
        return Err(CliError::usage(text)
            .with_hint("name a new file")
            .with_details(ErrorDetails::of_path(ErrorReason::Exists, out)));
    }
    scenes::until(path, tick, out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_old_folders_of_this_verb_are_removed() {
        let root = tempfile::tempdir().unwrap();
        let (ours, other) = (root.path().join("holdpoint-replay-x"), root.path().join("other"));
        for folder in [&ours, &other] {
            fs::create_dir(folder).unwrap();
            fs::write(folder.join("a.rrd"), "").unwrap();
        }
        let link = root.path().join("holdpoint-replay-link");
        std::os::unix::fs::symlink(&other, &link).unwrap();
        clean(root.path(), SystemTime::now());
        assert!(ours.exists());
        clean(root.path(), SystemTime::now() + KEPT + Duration::from_mins(1));
        assert!(!ours.exists() && other.join("a.rrd").exists() && link.exists());
    }
}
