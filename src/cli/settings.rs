//! The operator's files in `$XDG_CONFIG_HOME/holdpoint`: read with a size limit, and named in every error.
//!
//! The caller checks their content.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::operator_folder::own_folder;
use crate::error::CliError;
use holdpoint_console::theme::{FILE_BYTES_MAX, OWN_MAX, Themes};
use holdpoint_text::Untrusted;
use holdpoint_text::file::read_text;

/// A settings file of the operator: its path for messages, and its text. Absent if there is none.
pub(super) fn file(name: &str, bytes_max: usize) -> Result<Option<(String, String)>, CliError> {
    let Some(folder) = own_folder() else { return Ok(None) };
    let path = folder.join(name);
    let shown = Untrusted::new(path.display().to_string()).line().into_string();
    let unreadable = |error: &dyn std::fmt::Display| {
        CliError::usage(format!("cannot read {shown}: {error}")).with_bad_file(&path)
    };
    match std::fs::metadata(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(unreadable(&error)),
        Ok(_) => {}
    }
    let text = read_text(&path, bytes_max as u64).map_err(|error| unreadable(&error))?;
    Ok(Some((shown, text)))
}

/// Name, length and last change of each file of keys and themes; equal if none changed. Cheap enough for every few
/// seconds.
pub(super) fn stamp() -> Vec<(PathBuf, u64, Option<SystemTime>)> {
    let Some(folder) = own_folder() else { return Vec::new() };
    let themes = std::fs::read_dir(folder.join("themes")).into_iter().flatten().flatten();
    let themes = themes.take(4 * OWN_MAX).map(|entry| entry.path());
    let files = std::iter::once(folder.join("keys.toml")).chain(themes);
    let mut stamps: Vec<_> = files
        .filter_map(|path| {
            let known = std::fs::metadata(&path).ok()?;
            Some((path, known.len(), known.modified().ok()))
        })
        .collect();
    stamps.sort();
    stamps
}

/// The themes: the built-in ones and those in the folder `themes`.
///
/// # Errors
/// The errors in one of the files.
pub(super) fn themes() -> Result<Themes, CliError> {
    let Some(folder) = own_folder() else { return Ok(Themes::default()) };
    let Ok(entries) = std::fs::read_dir(folder.join("themes")) else { return Ok(Themes::default()) };
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| Path::new(name).extension().is_some_and(|extension| extension == "toml"))
        .take(OWN_MAX + 1)
        .collect();
    names.sort();
    let read = |name: String| file(&format!("themes/{name}"), FILE_BYTES_MAX).transpose();
    let files = names.into_iter().filter_map(read).collect::<Result<Vec<_>, _>>()?;
    Themes::with_files(&files).map_err(CliError::usage)
}
