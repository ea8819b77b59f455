//! The location of the store.

use std::fs;
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};

use crate::error::CliError;
use holdpoint_registry::Views;
use holdpoint_service::control_socket::socket_path;
use holdpoint_store::{Layout, other_owner};
use holdpoint_text::{ErrorDetails, ErrorReason, shell_word};

/// The store's folder: the one given, else `$XDG_DATA_HOME/holdpoint`, else `~/.local/share/holdpoint`.
///
/// # Errors
/// If none is given and the environment has no home folder.
pub fn folder(given: Option<&Path>) -> Result<PathBuf, CliError> {
    let variable = |name| std::env::var_os(name).map(PathBuf::from);
    folder_from(given, variable("XDG_DATA_HOME"), variable("HOME")).ok_or_else(|| {
        CliError::usage("no folder for the store: neither XDG_DATA_HOME nor HOME is set")
            .with_hint("name one with `--data DIR`")
            .with_details(ErrorReason::Environment)
    })
}

/// Relative paths in the environment are ignored, as the XDG base directory specification requires.
fn folder_from(given: Option<&Path>, xdg: Option<PathBuf>, home: Option<PathBuf>) -> Option<PathBuf> {
    let absolute = |path: Option<PathBuf>| path.filter(|path| path.is_absolute());
    given.map(Path::to_owned).or_else(|| {
        let base = absolute(xdg).or_else(|| absolute(home).map(|home| home.join(".local/share")))?;
        Some(base.join("holdpoint"))
    })
}

/// Requires that the store's folder, if it exists, is open to this user.
///
/// # Errors
/// [`CliError::Usage`] if another user owns it and does not share it.
pub(super) fn require_own(data: &Path) -> Result<(), CliError> {
    other_owner(data).map_or(Ok(()), |error| Err(CliError::usage(error)))
}

/// The database of a store.
///
/// # Errors
/// [`CliError::Usage`] if there is none, or another user owns it.
pub(super) fn database(data: &Path) -> Result<PathBuf, CliError> {
    require_own(data)?;
    let database = Layout::new(data).database();
    // Opening it reports what else is wrong.
    if fs::symlink_metadata(&database).is_ok() {
        return Ok(database);
    }
    let socket = socket_path(&Layout::new(data));
    if fs::symlink_metadata(socket).is_ok_and(|found| found.file_type().is_socket()) {
        let folder = shell_word(&data.display().to_string());
        let text = format!("{data:?} has the socket of an engine and no store, which this verb needs");
        let hint = format!(
            "`holdpoint run --data {folder}` attaches a console, which shows the state, and `holdpoint stop --data {folder}` \
             stops the cell; run other verbs on the store's folder, as the engine's account"
        );
        let details = ErrorDetails::of_path(ErrorReason::NoStore, data);
        return Err(CliError::usage(text).with_hint(hint).with_details(details));
    }
    Err(CliError::usage(format!("there is no store in {data:?}"))
        .with_hint("`holdpoint run` creates one; --data DIR names another")
        .with_details(ErrorDetails::of_path(ErrorReason::NoStore, data)))
}

/// Opens the store's views to read the chain or evidence, or for a request that an engine checks itself.
///
/// # Errors
/// [`CliError::Usage`] if there is no store, or it cannot be read.
pub(super) fn open(data: &Path) -> Result<Views, CliError> {
    Views::open(&database(data)?).map_err(CliError::usage)
}

/// Opens the store's views to show the tables, after checking that they match the chain.
///
/// # Errors
/// [`CliError::Usage`] if there is no store, or its tables are not what its chain says.
pub(super) fn open_checked(data: &Path) -> Result<Views, CliError> {
    Views::open_checked(&database(data)?).map_err(CliError::usage)
}

/// Opens the store's views to export or count records, after verifying them.
///
/// # Errors
/// [`CliError::Usage`] if there is no store, or its records are not what was signed.
pub(super) fn open_records(data: &Path) -> Result<Views, CliError> {
    Views::open_records(&database(data)?).map_err(CliError::usage)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `status` on the folder of `serve --seats` advised to create a store there.
    #[test]
    fn a_folder_with_a_socket_alone_names_the_verbs_that_work_there() {
        let folder = tempfile::tempdir().unwrap();
        let hint = || database(folder.path()).unwrap_err().hint().unwrap().raw().to_owned();
        assert!(hint().contains("`holdpoint run`"), "{}", hint());
        let _socket =
            std::os::unix::net::UnixListener::bind(socket_path(&Layout::new(folder.path()))).unwrap();
        assert!(
            hint().contains("`holdpoint stop --data ") && !hint().contains("`holdpoint run`"),
            "{}",
            hint()
        );
        fs::write(Layout::new(folder.path()).database(), "").unwrap();
        assert!(database(folder.path()).is_ok());
    }

    #[test]
    fn data_folder_follows_option_and_environment() {
        for (given, xdg, home, expected) in [
            (Some("here"), Some("/x"), Some("/h"), Some("here")),
            (None, Some("/x"), Some("/h"), Some("/x/holdpoint")),
            (None, Some("x"), Some("/h"), Some("/h/.local/share/holdpoint")),
            (None, Some(""), Some("/h"), Some("/h/.local/share/holdpoint")),
            (None, None, Some("h"), None),
            (None, None, None, None),
        ] {
            let got = folder_from(given.map(Path::new), xdg.map(Into::into), home.map(Into::into));
            assert_eq!(got, expected.map(PathBuf::from), "{given:?} {xdg:?} {home:?}");
        }
    }
}
