//! A site file as an engine uses it: baselines loaded, paths resolved, and what a store records of it.
//!
//! The rules check the file's values (`governance::site`); the cell's source builds its cells.

use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::site::{SITE_BYTES_MAX, Site, family_error};
use holdpoint_governance::text_error::TextError;
use holdpoint_runtime::capability::{Capability, PackageError, shown};
use holdpoint_text::file::{plain_lines, read_text};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, shell_word};
use serde::{Deserialize, Serialize};

use crate::embedded;

/// A site in a store's record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreSite {
    /// Digest of its values.
    pub digest: Digest,
    /// The file it was read from.
    pub file: PathBuf,
}

impl StoreSite {
    /// The digest of a cell at this site.
    #[must_use]
    pub fn bound(&self, cell: Digest) -> Digest {
        Digest::of_parts("holdpoint.environment-of-site.v1", &[cell.bytes(), self.digest.bytes()])
    }
}

/// See the module comment.
pub struct LoadedSite {
    /// The values.
    pub site: Site,
    /// Where they are from, absolute.
    pub file: PathBuf,
    /// SHA-256 over the values.
    pub digest: Digest,
    /// The first version of each family, in the file's order.
    pub baselines: Vec<Capability>,
    is_shipped: bool,
}

/// Why a site file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SiteError {
    /// The file cannot be read.
    #[error("cannot read the site file {file}: {source}")]
    Read {
        /// Which file, already made safe to print.
        file: String,
        source: io::Error,
    },
    /// A value is not allowed.
    #[error(transparent)]
    Content(#[from] TextError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
    /// The values have no canonical form.
    #[error("{file} has no canonical form: {source}")]
    Canonical { file: String, source: serde_json::Error },
}

impl Hint for SiteError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Read { file, .. } | Self::Canonical { file, .. } => {
                Some(ErrorDetails::of_file(ErrorReason::BadFile, file.as_str()))
            }
            Self::Content(error) => error.details(),
            Self::Baseline(error) => error.details(),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Read { .. } => Some("the guide's page `site-file` has a complete one to copy".into()),
            Self::Content(
                TextError::TooLarge { file, .. }
                | TextError::Syntax { file, .. }
                | TextError::Value { file, .. },
            ) => Some(format!("correct it, then run `holdpoint site check {}`", shell_word(file)).into()),
            Self::Baseline(error) => error.hint(),
            Self::Canonical { .. } => None,
        }
    }
}

impl LoadedSite {
    /// Reads a site file and loads its baselines. A baseline whose folder is missing is the embedded one of that name.
    ///
    /// # Errors
    /// [`SiteError`].
    pub fn read(file: &Path) -> Result<Self, SiteError> {
        let name = shown(file);
        let text = read_text(file, SITE_BYTES_MAX as u64)
            .map_err(|source| SiteError::Read { file: name.clone(), source })?;
        let text = plain_lines(&text);
        let site = Site::parse(&name, &text)?;
        let is_shipped = site == Site::shipped()?;
        let digest = site.digest().map_err(|source| SiteError::Canonical { file: name.clone(), source })?;
        let mut baselines = Vec::with_capacity(site.families.len());
        for (index, family) in site.families.iter().enumerate() {
            let baseline = baseline(&beside(file, &family.baseline), &family.baseline)?;
            let refuse = |field: &str, value: &str, allowed: &str| {
                family_error(&name, &text, (index, family), field, value, allowed)
            };
            let named = &baseline.manifest.name;
            if *named != family.name {
                let allowed = format!("{named}, the name in the baseline's manifest");
                return Err(refuse("name", family.name.as_str(), &allowed).into());
            }
            let bound = baseline.manifest.recovery.fallback.as_ref().map(|fallback| &fallback.family);
            if bound != family.fallback.as_ref() {
                let allowed = format!("{}, as the baseline's manifest binds", name_or_none(bound));
                return Err(refuse("fallback", name_or_none(family.fallback.as_ref()), &allowed).into());
            }
            baselines.push(baseline);
        }
        // The store records it for a start from another folder.
        let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        Ok(Self { site, file, digest, baselines, is_shipped })
    }

    /// What a store records of it; absent if its values are those of the built-in site.
    #[must_use]
    pub fn on_record(&self) -> Option<StoreSite> {
        (!self.is_shipped).then(|| StoreSite { digest: self.digest, file: self.file.clone() })
    }

    /// The robot's URDF file; absent for a built-in robot.
    #[must_use]
    pub fn robot_file(&self) -> Option<PathBuf> {
        self.site.robot_file().map(|path| beside(&self.file, path))
    }

    /// The file of a profile that is not built in.
    #[must_use]
    pub fn profile_path(&self) -> PathBuf {
        beside(&self.file, &self.site.profile)
    }
}

/// A path of a site file, from the file's folder.
fn beside(file: &Path, path: &str) -> PathBuf {
    file.parent().map_or_else(|| PathBuf::from(path), |folder| folder.join(path))
}

fn baseline(folder: &Path, name: &str) -> Result<Capability, PackageError> {
    match embedded::baseline(name) {
        Some(package) if !folder.exists() => Capability::load(&shown(folder), package),
        Some(_) | None => Capability::read(folder),
    }
}

fn name_or_none(family: Option<&Family>) -> &str {
    family.map_or("none", Family::as_str)
}

#[cfg(test)]
mod tests;
