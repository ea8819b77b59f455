//! A stop of the cell that could not be recorded: stored beside the record, where the next engine finds it.
//!
//! It is written in every place that accepts it: the store's folder, its folder of keys, and the user's runtime folder,
//! which is on another disk and lasts until the machine shuts down. A mark in any of them stops the next engine. Each
//! place holds one file of bounded size, and no file is written through a link.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::Write as _;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use holdpoint_governance::ids::Digest;
use holdpoint_text::file::{NO_LINK, read_text};

use crate::error::StoreError;
use crate::layout::Layout;
use holdpoint_audit::files::{sync_folder, write_atomically};

const STOP_BYTES_MAX: u64 = 64 * 1024;

/// The mark's file name in each place.
const NAME: &str = "stop.unrecorded";

/// The places of one store.
#[derive(Clone, Debug)]
pub struct StopMarks {
    places: Vec<PathBuf>,
    /// The folder of the last place, made on demand.
    runtime: Option<PathBuf>,
}

impl StopMarks {
    /// The places of the store in this folder. Touches nothing.
    #[must_use]
    pub fn of(layout: &Layout) -> Self {
        let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
        Self::with(layout, runtime.filter(|folder| folder.is_absolute()))
    }

    fn with(layout: &Layout, runtime: Option<PathBuf>) -> Self {
        let mut places = vec![layout.folder().join(NAME), layout.keys().join(NAME)];
        let runtime = runtime.map(|folder| folder.join("holdpoint"));
        places.extend(runtime.as_ref().map(|folder| {
            // By the store's path, which is unique.
            let store = fs::canonicalize(layout.folder()).unwrap_or_else(|_| layout.folder().to_owned());
            let id = Digest::of_parts("holdpoint/stop-mark/v1", &[store.as_os_str().as_encoded_bytes()]);
            folder.join(format!("stop-{id}"))
        }));
        Self { places, runtime }
    }

    /// Where a stop is kept, the store's own folder first.
    #[must_use]
    pub fn places(&self) -> &[PathBuf] {
        &self.places
    }

    /// Stores a stop in every place that accepts it.
    ///
    /// # Errors
    /// The first place's error, if none accepted it.
    pub fn keep(&self, text: &str) -> Result<(), StoreError> {
        let mut problem = None;
        let mut is_stored = false;
        if let Some(folder) = self.runtime.as_ref().filter(|folder| fs::symlink_metadata(folder).is_err()) {
            // If it cannot be made, there is no such place.
            drop(DirBuilder::new().mode(0o700).create(folder));
        }
        for place in &self.places {
            match keep_at(place, text) {
                Ok(()) => is_stored = true,
                Err(error) => problem = problem.or(Some(error)),
            }
        }
        match problem {
            Some(error) if !is_stored => Err(error),
            Some(_) | None => Ok(()),
        }
    }

    /// The stored stop, as written; empty if it cannot be read. `None`: there is none.
    #[must_use]
    pub fn found(&self) -> Option<String> {
        let existing = self.places.iter().filter(|place| fs::symlink_metadata(place).is_ok());
        let texts: Vec<String> =
            existing.map(|place| read_text(place, STOP_BYTES_MAX).unwrap_or_default()).collect();
        texts.iter().find(|text| !text.is_empty()).or(texts.first()).cloned()
    }

    /// The stop is on record.
    pub fn remove(&self) {
        for place in &self.places {
            // A mark that cannot be removed only stops the next engine, and an operator can start it again.
            drop(fs::remove_file(place));
        }
    }
}

fn keep_at(place: &Path, text: &str) -> Result<(), StoreError> {
    place.parent().map_or(Ok(()), own_folder)?;
    // A full disk accepts no text, but still an entry in the folder: an empty mark stops as well.
    write_atomically(place, text.as_bytes()).or_else(|error| match create_mark(place, text) {
        Ok(()) => Ok(()),
        // An earlier stop is there, with the same effect.
        Err(_) if fs::symlink_metadata(place).is_ok_and(|found| found.is_file()) => Ok(()),
        Err(_) => Err(error.into()),
    })
}

/// Another user's folder is not a place.
fn own_folder(folder: &Path) -> Result<(), StoreError> {
    // The store's own folder may lie behind a link.
    let found = fs::metadata(folder).map_err(StoreError::io("look at", folder))?;
    if found.is_dir() && found.uid() == rustix::process::geteuid().as_raw() {
        return Ok(());
    }
    Err(StoreError::invalid("folder for a stop", folder.display(), "a folder of your own"))
}

fn create_mark(place: &Path, text: &str) -> Result<(), StoreError> {
    let result =
        OpenOptions::new().write(true).create_new(true).mode(0o600).custom_flags(NO_LINK).open(place);
    let mut file: File = result.map_err(StoreError::io("create", place))?;
    drop(file.write_all(text.as_bytes()).and_then(|()| file.sync_all()));
    Ok(place.parent().map_or(Ok(()), sync_folder)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marks(folder: &Path) -> StopMarks {
        let runtime = folder.join("runtime");
        fs::create_dir_all(folder.join("keys")).unwrap();
        fs::create_dir_all(&runtime).unwrap();
        StopMarks::with(&Layout::new(folder), Some(runtime))
    }

    #[test]
    fn stop_mark_is_stored_if_one_of_its_places_is_occupied() {
        let folder = tempfile::tempdir().unwrap();
        let marks = marks(folder.path());
        assert_eq!(marks.found(), None);
        let planted = marks.places[0].clone();
        fs::create_dir(&planted).unwrap();
        assert_eq!(marks.found().as_deref(), Some(""), "whatever lies there is a stop");
        marks.keep("by ana").unwrap();
        // Its owner removes it again.
        fs::remove_dir(&planted).unwrap();
        assert_eq!(marks.found().as_deref(), Some("by ana"));
        fs::remove_file(&marks.places[1]).unwrap();
        assert_eq!(marks.found().as_deref(), Some("by ana"), "it is in the runtime folder as well");
        marks.remove();
        assert_eq!(marks.found(), None);
    }

    #[test]
    fn stop_mark_without_a_free_place_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let marks = marks(folder.path());
        assert_eq!(marks.places.len(), 3);
        for place in &marks.places {
            fs::create_dir_all(place.join("something")).unwrap();
        }
        assert!(marks.keep("by ana").is_err());
        assert_eq!(marks.found().as_deref(), Some(""));
    }

    #[test]
    fn link_or_pipe_at_a_stop_mark_counts_as_a_stop_and_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let marks = marks(folder.path());
        let elsewhere = folder.path().join("elsewhere");
        std::os::unix::fs::symlink(&elsewhere, &marks.places[0]).unwrap();
        assert_eq!(marks.found().as_deref(), Some(""));
        marks.keep("by ana").unwrap();
        assert!(!elsewhere.exists() && marks.places[0].is_file());
        marks.remove();
        let pipe = std::process::Command::new("mkfifo").arg(&marks.places[0]).status().unwrap();
        assert!(pipe.success());
        assert_eq!(marks.found().as_deref(), Some(""), "the mark blocks on no reader");
    }
}
