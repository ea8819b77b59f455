//! What the command line takes from a site file: the named file or that of the store, and the profile it names.

use std::path::Path;
use std::sync::Arc;

use super::data;
use super::profile_choice::RequestedProfile;
use crate::error::CliError;
use crate::headless::cell;
use holdpoint_body::Zone;
use holdpoint_engine::decide::store_identity;
use holdpoint_governance::mode::UnknownZone;
use holdpoint_runtime::capability::shown;
use holdpoint_store::Layout;
use holdpoint_text::shell_word;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::site::LoadedSite;

/// The site file that an option names; `None` without the option.
///
/// # Errors
/// If the file cannot be used.
pub(super) fn named(file: Option<&Path>) -> Result<Option<Arc<LoadedSite>>, CliError> {
    file.map(|file| LoadedSite::read(file).map(Arc::new).map_err(CliError::usage)).transpose()
}

/// The site file that the store was last used with, unchanged, because another one voids its measurements. `None` for
/// the built-in site, and for a new store.
///
/// # Errors
/// If the store or the file cannot be read, or if the file changed.
pub(super) fn last(data: &Path) -> Result<Option<Arc<LoadedSite>>, CliError> {
    if !Layout::new(data).database().exists() {
        return Ok(None);
    }
    let recorded = store_identity::site(&data::open(data)?).map_err(CliError::usage)?;
    let Some(recorded) = recorded else { return Ok(None) };
    let site = LoadedSite::read(&recorded.file).map_err(|error| {
        CliError::usage(error)
            .with_hint("put it back; `holdpoint run --site FILE` starts an engine with another one")
    })?;
    if site.digest != recorded.digest {
        let file = shown(&recorded.file);
        let text = format!("the site file {file} changed since the store was last used with it");
        let named = shell_word(&recorded.file.to_string_lossy());
        let hint =
            format!("`holdpoint run --site {named}` uses it as it is now; earlier evidence is then void");
        return Err(CliError::usage(text).with_hint(hint).with_bad_file(&recorded.file));
    }
    Ok(Some(Arc::new(site)))
}

/// Refuses a text that names a zone which the cell does not have: that of the site, else of the store's, else the built-in
/// one. The cell is asked only if the text names a zone that is not allowed in every cell.
///
/// # Errors
/// If there is such a zone, or the cell cannot be asked.
pub(super) fn check_zones(
    data: &Path,
    site: Option<&Arc<LoadedSite>>,
    unknown: &dyn Fn(&[Zone]) -> Option<UnknownZone>,
) -> Result<(), CliError> {
    if unknown(&[]).is_none() {
        return Ok(());
    }
    match unknown(&cell_of(data, site)?.zones) {
        None => Ok(()),
        Some(unknown) => Err(CliError::usage(unknown)),
    }
}

/// The cell of the site, else of the store's, else the built-in one.
///
/// # Errors
/// If it cannot be had.
pub(super) fn cell_of(data: &Path, site: Option<&Arc<LoadedSite>>) -> Result<Cell, CliError> {
    let site = match site {
        Some(site) => Some(Arc::clone(site)),
        None => last(data)?,
    };
    cell(None, site.as_ref())
}

/// The profile that a site file names.
pub(super) fn profile(site: &LoadedSite) -> RequestedProfile {
    match site.site.profile.parse() {
        Ok(name) => RequestedProfile::BuiltIn(name),
        Err(_) => RequestedProfile::File(site.profile_path()),
    }
}
