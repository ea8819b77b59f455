//! A registered version as the pipeline works with it: manifest, submission and loaded bundle.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use cap_std::ambient_authority;
use cap_std::fs::Dir;
use std::io::Read as _;

use crate::skill::SkillBundle;
use crate::skill::native::{Controller, NativeBundle, NativeError};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::manifest::{Bundle, MANIFEST_BYTES_MAX, Manifest};
use holdpoint_governance::submission::{Package, Submission};
use holdpoint_governance::text_error::TextError;
use holdpoint_text::{Hint, Untrusted};

/// Why a version could not be taken in.
#[derive(Debug, thiserror::Error)]
pub enum PackageError {
    /// A file of the package cannot be read.
    #[error("cannot read {file}: {source}")]
    Read {
        /// Which file, already made safe to print.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// A file is larger than it may be.
    #[error("{file} has {bytes} bytes; at most {allowed} are allowed")]
    TooLarge {
        /// Which file.
        file: String,
        /// How large it is, or more.
        bytes: u64,
        /// How large it may be.
        allowed: u64,
    },
    /// A file is not UTF-8.
    #[error("{file} is not UTF-8 text")]
    NotText {
        /// Which file.
        file: String,
    },
    /// A file's content is not allowed.
    #[error(transparent)]
    Content(#[from] TextError),
    /// The bundle cannot be loaded.
    #[error(transparent)]
    Native(#[from] NativeError),
    /// The kind of bundle is not supported by this build.
    #[error("{file}: the bundle {bundle:?} is a WebAssembly component, which this build does not run")]
    NoWasm {
        /// The manifest.
        file: String,
        /// The bundle.
        bundle: String,
    },
    /// A native bundle without parameters.
    #[error("{file}: deployment.params is missing")]
    NoParams {
        /// The manifest.
        file: String,
    },
    /// A value has no canonical form.
    #[error("{file} has no canonical form: {source}")]
    Canonical {
        /// Which file.
        file: String,
        /// Why.
        source: serde_json::Error,
    },
}

impl Hint for PackageError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Read { .. } => Some(
                "a candidate is a folder with manifest.toml, submission.toml and the files they name".into(),
            ),
            Self::Content(error) => error.hint(),
            Self::Native(error) => error.hint(),
            Self::NoWasm { .. } => Some("use native:<controller>".into()),
            Self::NoParams { .. } => {
                Some("a native bundle needs a parameter file, e.g. params = \"params.toml\"".into())
            }
            Self::TooLarge { .. } | Self::NotText { .. } | Self::Canonical { .. } => None,
        }
    }
}

/// A version with its bundle loaded.
#[derive(Clone)]
pub struct Capability {
    /// The eight fields.
    pub manifest: Arc<Manifest>,
    /// Who made it and how.
    pub submission: Arc<Submission>,
    /// The executable.
    pub bundle: Arc<dyn SkillBundle>,
    /// The texts it was made from.
    pub package: Arc<Package>,
    manifest_digest: Digest,
    digest: Digest,
}

impl std::fmt::Debug for Capability {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Capability")
            .field("id", &self.id().to_string())
            .field("digest", &self.digest)
            .finish_non_exhaustive()
    }
}

/// Reads a candidate's folder. Nothing outside the folder is opened, links included.
///
/// # Errors
/// Where a file is missing, too large, no text, or outside the folder.
pub fn read(folder: &Path) -> Result<Package, PackageError> {
    let shown = Untrusted::new(folder.display().to_string()).line().into_string();
    let dir = Dir::open_ambient_dir(folder, ambient_authority())
        .map_err(|source| PackageError::Read { file: shown.clone(), source })?;
    let manifest_file = format!("{shown}/manifest.toml");
    let manifest = read_text(&dir, "manifest.toml", &manifest_file, MANIFEST_BYTES_MAX)?;
    let submission =
        read_text(&dir, "submission.toml", &format!("{shown}/submission.toml"), MANIFEST_BYTES_MAX)?;
    let parsed = Manifest::parse(&manifest_file, &manifest)?;
    let params = match &parsed.deployment.params {
        None => String::new(),
        Some(path) => {
            read_text(&dir, path.as_str(), &format!("{shown}/{}", path.as_str()), MANIFEST_BYTES_MAX)?
        }
    };
    Ok(Package { manifest, submission, params })
}

fn read_text(dir: &Dir, path: &str, shown: &str, bytes_max: usize) -> Result<String, PackageError> {
    let read = |source| PackageError::Read { file: shown.to_owned(), source };
    let file = dir.open(path).map_err(read)?;
    let limit = bytes_max as u64;
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(read)?;
    if bytes.len() as u64 > limit {
        return Err(PackageError::TooLarge { file: shown.to_owned(), bytes: limit + 1, allowed: limit });
    }
    String::from_utf8(bytes).map_err(|_| PackageError::NotText { file: shown.to_owned() })
}

impl Capability {
    /// Parses a package and loads its bundle; `name` stands for the folder in errors.
    ///
    /// # Errors
    /// Where a text is not allowed or the bundle cannot be loaded.
    pub fn load(name: &str, package: Package) -> Result<Self, PackageError> {
        let manifest_file = format!("{name}/manifest.toml");
        let manifest = Manifest::parse(&manifest_file, &package.manifest)?;
        let submission = Submission::parse(&format!("{name}/submission.toml"), &package.submission)?;
        let bundle = match &manifest.deployment.bundle {
            Bundle::Native(controller) => {
                let Some(params) = &manifest.deployment.params else {
                    return Err(PackageError::NoParams { file: manifest_file });
                };
                let file = format!("{name}/{}", params.as_str());
                let controller = Controller::parse(controller, &file, &package.params)?;
                NativeBundle::new(controller)
                    .map_err(|source| PackageError::Canonical { file: file.clone(), source })?
            }
            Bundle::Wasm(path) => {
                return Err(PackageError::NoWasm { file: manifest_file, bundle: path.as_str().to_owned() });
            }
        };
        let manifest_digest = manifest
            .digest()
            .map_err(|source| PackageError::Canonical { file: manifest_file.clone(), source })?;
        let digest =
            Digest::of_parts("holdpoint.candidate.v1", &[manifest_digest.bytes(), bundle.digest().bytes()]);
        Ok(Self {
            manifest: Arc::new(manifest),
            submission: Arc::new(submission),
            bundle: Arc::new(bundle),
            package: Arc::new(package),
            manifest_digest,
            digest,
        })
    }

    /// Family and version.
    #[must_use]
    pub fn id(&self) -> CapabilityId {
        self.manifest.id()
    }

    /// Digest of manifest and bundle: what approvals and evidence bind to.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// Digest of the canonical manifest.
    #[must_use]
    pub const fn manifest_digest(&self) -> Digest {
        self.manifest_digest
    }

    /// The stop time the version declares for its safe-abort hook, s; what it does not declare is not waited for.
    #[must_use]
    pub fn abort_secs(&self) -> f64 {
        let declared = self.manifest.recovery.safe_abort.as_ref();
        declared.map_or(0.0, |abort| f64::from(abort.stop_time_max_ms) / 1000.0)
    }
}
