//! A version as the pipeline works with it: manifest, submission and loaded bundle.
//!
//! Owns the one reader of candidates' folders: files are opened beneath the folder and never through a link that leads
//! out of it, each up to its own limit. Every text is parsed once and its value handed on.

use std::borrow::Cow;
use std::io::{self, Read as _};
use std::path::Path;
use std::sync::Arc;

use cap_std::ambient_authority;
use cap_std::fs::{Dir, OpenOptions, OpenOptionsExt as _};
use serde_json::Value;

use crate::seeds::BundleSeed;
use crate::senses::Senses;
use crate::skill::altered::{self, AlteredBundle};
use crate::skill::component::ComponentBundle;
use crate::skill::native::{Controller, NativeBundle, NativeError, PARAMS_BYTES_MAX};
use crate::skill::{Skill, SkillBundle, provided};
use holdpoint_component::{Component, ComponentError, ComponentLimits};
use holdpoint_governance::component::{COMPONENT_BYTES_MAX, ComponentBytes, ComponentTooLarge};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::manifest::{BundleSource, MANIFEST_BYTES_MAX, Manifest};
use holdpoint_governance::submission::{
    AUTHOR_SIGNATURE_BYTES_MAX, Package, SUBMISSION_BYTES_MAX, Submission,
};
use holdpoint_governance::text_error::{TextError, check_size, parse_toml};
use holdpoint_text::file::{AT_ONCE, regular};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Untrusted};

/// The file of a version's folder with its author's signature.
pub const AUTHOR_SIGNATURE_FILE: &str = "author.sig";

/// Why a version could not be taken in.
#[derive(Debug, thiserror::Error)]
pub enum PackageError {
    /// The folder cannot be opened.
    #[error("cannot read {folder}: {source}")]
    Folder {
        /// Which folder, already made safe to print.
        folder: String,
        source: io::Error,
    },
    /// A file of the package cannot be read.
    #[error("cannot read {file}: {source}")]
    Read {
        /// Which file, already made safe to print.
        file: String,
        source: io::Error,
    },
    /// A file is not UTF-8.
    #[error("{file} is not UTF-8 text")]
    NotText { file: String },
    /// A file is too large, or its content is not allowed.
    #[error(transparent)]
    Content(#[from] TextError),
    /// The bundle cannot be loaded.
    #[error(transparent)]
    Native(#[from] NativeError),
    /// The manifest names a component, and the package has none.
    #[error("{file}: deployment.bundle is the component {bundle:?}, and the package brings none")]
    NoComponent { file: String, bundle: String },
    /// The package has a component that its manifest does not name.
    #[error("{file}: the package brings a component, and deployment.bundle is {bundle:?}")]
    ComponentUnnamed { file: String, bundle: String },
    /// The component is larger than allowed.
    #[error("{file}: {source}")]
    ComponentTooLarge { file: String, source: ComponentTooLarge },
    /// The component is no skill.
    #[error("{file}: {source}")]
    Component { file: String, source: ComponentError },
    /// A native bundle without parameters.
    #[error("{file}: deployment.params is missing")]
    NoParams { file: String },
    /// A value has no canonical form.
    #[error("{file} has no canonical form: {source}")]
    Canonical { file: String, source: serde_json::Error },
}

impl Hint for PackageError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Content(error) => return error.details(),
            Self::Native(error) => return error.details(),
            Self::NoComponent { file, .. } | Self::ComponentUnnamed { file, .. } => {
                ErrorDetails::of_field(file.as_str(), "deployment.bundle")
            }
            Self::NoParams { file } => ErrorDetails::of_field(file.as_str(), "deployment.params"),
            Self::Folder { folder: file, .. }
            | Self::Read { file, .. }
            | Self::NotText { file }
            | Self::ComponentTooLarge { file, .. }
            | Self::Component { file, .. }
            | Self::Canonical { file, .. } => ErrorDetails::of_file(ErrorReason::BadFile, file.as_str()),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Folder { .. } | Self::Read { .. } => Some(
                "a candidate is a folder with manifest.toml, submission.toml and the files they name".into(),
            ),
            Self::Content(error) => error.hint(),
            Self::Native(error) => error.hint(),
            Self::Component { source, .. } => source.hint(),
            Self::NoComponent { .. } => Some("`holdpoint skill build` makes it from a skill's source".into()),
            Self::NoParams { .. } => {
                Some("a native bundle needs a parameter file, e.g. params = \"params.toml\"".into())
            }
            Self::ComponentUnnamed { .. } | Self::ComponentTooLarge { .. } => None,
            Self::NotText { .. } | Self::Canonical { .. } => None,
        }
    }
}

/// A version with its bundle loaded.
#[derive(Clone)]
pub struct Capability {
    pub manifest: Arc<Manifest>,
    /// Who made it and how.
    pub submission: Arc<Submission>,
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

/// A version's texts and what they say. Well formed, and nothing more is known of it: its bundle is not loaded.
#[derive(Clone, Debug, PartialEq)]
pub struct ParsedPackage {
    pub manifest: Manifest,
    /// Who made it and how.
    pub submission: Submission,
    pub package: Package,
}

impl ParsedPackage {
    /// Reads and parses a candidate's folder. Nothing outside the folder is opened, links included. In errors `name`
    /// stands before the files' names; if it is empty they are named as they are in the folder.
    ///
    /// # Errors
    /// If a file is missing, too large, no text, not allowed, or outside the folder.
    pub fn read(name: &str, folder: &Path) -> Result<Self, PackageError> {
        let files = Files::open(name, folder)?;
        let text = files.text("manifest.toml", MANIFEST_BYTES_MAX)?;
        let manifest = Manifest::parse(&named(name, "manifest.toml"), &text)?;
        let mut package = Package {
            manifest: text,
            submission: String::new(),
            params: String::new(),
            component: None,
            author_signature: None,
        };
        package.submission = files.text("submission.toml", SUBMISSION_BYTES_MAX)?;
        let submission = Submission::parse(&named(name, "submission.toml"), &package.submission)?;
        if let BundleSource::Wasm(file) = &manifest.deployment.bundle {
            package.component = Some(files.component(file.as_str())?);
        }
        if let Some(file) = &manifest.deployment.params {
            package.params = files.text(file.as_str(), PARAMS_BYTES_MAX)?;
        }
        package.author_signature = files.text_if_there(AUTHOR_SIGNATURE_FILE, AUTHOR_SIGNATURE_BYTES_MAX)?;
        Ok(Self { manifest, submission, package })
    }

    /// Parses the texts of a package; `name` stands for the folder in errors.
    ///
    /// # Errors
    /// [`PackageError::Content`].
    pub fn parse(name: &str, package: Package) -> Result<Self, PackageError> {
        let manifest = Manifest::parse(&named(name, "manifest.toml"), &package.manifest)?;
        let submission = Submission::parse(&named(name, "submission.toml"), &package.submission)?;
        match (&manifest.deployment.bundle, &package.component) {
            (BundleSource::Wasm(_), Some(_)) | (BundleSource::Native(_), None) => {
                Ok(Self { manifest, submission, package })
            }
            (BundleSource::Wasm(path), None) => Err(PackageError::NoComponent {
                file: named(name, "manifest.toml"),
                bundle: path.as_str().to_owned(),
            }),
            (native @ BundleSource::Native(_), Some(_)) => Err(PackageError::ComponentUnnamed {
                file: named(name, "manifest.toml"),
                bundle: native.clone().into(),
            }),
        }
    }

    /// The parameters as they stand in their file, whatever its fields are; only the controller knows those. Null
    /// if the manifest names no file.
    ///
    /// # Errors
    /// If the file is not TOML, or holds a number that is not finite.
    pub fn params(&self) -> Result<Value, PackageError> {
        match &self.manifest.deployment.params {
            None => Ok(Value::Null),
            Some(file) => params(file.as_str(), &self.package.params),
        }
    }
}

fn params(file: &str, text: &str) -> Result<Value, PackageError> {
    let table: toml::Table = parse_toml(file, text)?;
    // JSON has no form for such a number: it would look like a missing value.
    if let Some((field, value)) = not_finite("", &table) {
        let allowed = "a finite number";
        return Err(TextError::value(file, text, &field, &value.to_string(), allowed).into());
    }
    serde_json::to_value(&table).map_err(|source| PackageError::Canonical { file: file.to_owned(), source })
}

/// The first number that is not finite, with its path.
fn not_finite(path: &str, table: &toml::Table) -> Option<(String, f64)> {
    fn within(path: &str, value: &toml::Value) -> Option<(String, f64)> {
        match value {
            toml::Value::Float(number) => (!number.is_finite()).then(|| (path.to_owned(), *number)),
            toml::Value::Array(values) => values.iter().find_map(|value| within(path, value)),
            toml::Value::Table(table) => not_finite(path, table),
            toml::Value::String(_)
            | toml::Value::Integer(_)
            | toml::Value::Boolean(_)
            | toml::Value::Datetime(_) => None,
        }
    }
    table.iter().find_map(|(key, value)| {
        within(&if path.is_empty() { key.clone() } else { format!("{path}.{key}") }, value)
    })
}

/// The files of a folder, opened beneath it.
struct Files<'a> {
    name: &'a str,
    dir: Dir,
}

impl<'a> Files<'a> {
    fn open(name: &'a str, folder: &Path) -> Result<Self, PackageError> {
        let dir = Dir::open_ambient_dir(folder, ambient_authority())
            .map_err(|source| PackageError::Folder { folder: shown(folder), source })?;
        Ok(Self { name, dir })
    }

    /// A text of at most `bytes_max` bytes.
    fn text(&self, path: &str, bytes_max: usize) -> Result<String, PackageError> {
        let file = named(self.name, path);
        let bytes = self.bytes(path, bytes_max)?;
        let text = String::from_utf8(bytes).map_err(|_| PackageError::NotText { file: file.clone() })?;
        check_size(&file, &text, bytes_max)?;
        Ok(text)
    }

    /// As [`Files::text`]; `None` where there is no such file.
    fn text_if_there(&self, path: &str, bytes_max: usize) -> Result<Option<String>, PackageError> {
        match self.text(path, bytes_max) {
            Err(PackageError::Read { source, .. }) if source.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(Some),
        }
    }

    fn component(&self, path: &str) -> Result<ComponentBytes, PackageError> {
        let bytes = self.bytes(path, COMPONENT_BYTES_MAX)?;
        let too_large = |source| PackageError::ComponentTooLarge { file: named(self.name, path), source };
        ComponentBytes::new(bytes).map_err(too_large)
    }

    /// The content of a file; of an oversized one only enough is read to detect the size.
    fn bytes(&self, path: &str, bytes_max: usize) -> Result<Vec<u8>, PackageError> {
        let file = named(self.name, path);
        let mut bytes = Vec::new();
        let mut options = OpenOptions::new();
        options.read(true).custom_flags(AT_ONCE);
        self.dir
            .open_with(path, &options)
            .and_then(|opened| regular(opened.into_std()))
            .and_then(|opened| opened.take(bytes_max as u64 + 1).read_to_end(&mut bytes))
            .map_err(|source| PackageError::Read { file, source })?;
        Ok(bytes)
    }
}

/// How a file of a version is named in errors.
fn named(name: &str, file: &str) -> String {
    if name.is_empty() { file.to_owned() } else { format!("{name}/{file}") }
}

/// A folder's path, safe to print.
#[must_use]
pub fn shown(folder: &Path) -> String {
    Untrusted::new(folder.display().to_string()).line().into_string()
}

/// The texts of a candidate's folder, as an engine is given them.
///
/// # Errors
/// As [`ParsedPackage::read`].
pub fn read(folder: &Path) -> Result<Package, PackageError> {
    Ok(ParsedPackage::read(&shown(folder), folder)?.package)
}

impl Capability {
    /// Reads a candidate's folder and loads its bundle.
    ///
    /// # Errors
    /// As [`ParsedPackage::read`] and [`Capability::of`].
    pub fn read(folder: &Path) -> Result<Self, PackageError> {
        let name = shown(folder);
        Self::of(&name, ParsedPackage::read(&name, folder)?)
    }

    /// Parses a package and loads its bundle; `name` stands for the folder in errors.
    ///
    /// # Errors
    /// If a text is not allowed or the bundle cannot be loaded.
    pub fn load(name: &str, package: Package) -> Result<Self, PackageError> {
        Self::of(name, ParsedPackage::parse(name, package)?)
    }

    /// Loads the bundle of what was parsed; `name` stands for the folder in errors.
    ///
    /// # Errors
    /// If the bundle cannot be loaded.
    pub fn of(name: &str, parsed: ParsedPackage) -> Result<Self, PackageError> {
        let ParsedPackage { manifest, submission, package } = parsed;
        let manifest_file = named(name, "manifest.toml");
        let params_file = manifest.deployment.params.as_ref().map(|params| named(name, params.as_str()));
        let (alterations, own) = match &params_file {
            Some(file) => altered::split(file, &package.params)?,
            None => (Vec::new(), None),
        };
        let params_text = own.as_deref().unwrap_or(&package.params);
        let bundle: Arc<dyn SkillBundle> = match &manifest.deployment.bundle {
            BundleSource::Native(controller) => {
                let Some(file) = &params_file else {
                    return Err(PackageError::NoParams { file: manifest_file });
                };
                if let Some(load) = provided::provided(controller) {
                    load(file, params_text)?
                } else {
                    let controller = Controller::parse(controller, file, params_text).map_err(|error| {
                        let NativeError::UnknownController(name) = error else { return error.into() };
                        let known: Vec<String> =
                            provided::names().into_iter().map(|name| format!("native:{name}")).collect();
                        let known = known.join(", ");
                        let (field, value) = ("deployment.bundle", format!("native:{name}"));
                        PackageError::from(TextError::value(
                            &manifest_file,
                            &package.manifest,
                            field,
                            &value,
                            &known,
                        ))
                    })?;
                    let canonical = |source| PackageError::Canonical { file: file.clone(), source };
                    Arc::new(NativeBundle::new(controller).map_err(canonical)?)
                }
            }
            BundleSource::Wasm(path) => {
                let file = named(name, path.as_str());
                let Some(component) = &package.component else {
                    let bundle = path.as_str().to_owned();
                    return Err(PackageError::NoComponent { file: manifest_file, bundle });
                };
                let params = match &params_file {
                    Some(file) => params(file, params_text)?,
                    None => Value::Null,
                };
                let limits = ComponentLimits::of(&manifest.permissions.resources);
                Component::load(component.bytes(), &params, limits, &manifest.deployment.imports)
                    .map(|component| Arc::new(ComponentBundle(component)))
                    .map_err(|source| PackageError::Component { file, source })?
            }
        };
        let bundle = match (alterations.is_empty(), params_file) {
            (false, Some(file)) => Arc::new(
                AlteredBundle::new(bundle, alterations)
                    .map_err(|source| PackageError::Canonical { file, source })?,
            ),
            (true, _) | (false, None) => bundle,
        };
        let manifest_digest = manifest
            .digest()
            .map_err(|source| PackageError::Canonical { file: manifest_file.clone(), source })?;
        let digest =
            Digest::of_parts("holdpoint.candidate.v1", &[manifest_digest.bytes(), bundle.digest().bytes()]);
        Ok(Self {
            manifest: Arc::new(manifest),
            submission: Arc::new(submission),
            bundle,
            package: Arc::new(package),
            manifest_digest,
            digest,
        })
    }

    #[must_use]
    pub fn id(&self) -> CapabilityId {
        self.manifest.id()
    }

    /// Whether another version runs the same code: the same controller, or the same bytes of a component, and the same
    /// alterations around it. Parameters are no code.
    #[must_use]
    pub fn has_code_of(&self, other: &Self) -> bool {
        let altered =
            |version: &Self| altered::split("", &version.package.params).map(|(found, _)| found).ok();
        let same_bundle = match (&self.package.component, &other.package.component) {
            (Some(own), Some(theirs)) => own == theirs,
            (None, None) => self.manifest.deployment.bundle == other.manifest.deployment.bundle,
            (Some(_), None) | (None, Some(_)) => false,
        };
        same_bundle && altered(self) == altered(other)
    }

    /// Digest of manifest and bundle: what approvals and evidence bind to.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// As [`Capability::digest`], without the version number: the same content under another number has the same one.
    ///
    /// # Errors
    /// Never for a loaded version: its manifest has a canonical form.
    pub fn content_digest(&self) -> Result<Digest, serde_json::Error> {
        let manifest = self.manifest.content_digest()?;
        Ok(Digest::of_parts("holdpoint.content.v1", &[manifest.bytes(), self.bundle.digest().bytes()]))
    }

    /// Digest of the canonical manifest.
    #[must_use]
    pub const fn manifest_digest(&self) -> Digest {
        self.manifest_digest
    }

    /// Begins a run that senses what the manifest declares and nothing else.
    #[must_use]
    pub fn start(&self, seed: BundleSeed) -> Box<dyn Skill> {
        Senses::of(&self.manifest.permissions).confine(self.bundle.start(seed.number()))
    }

    /// Whether the rollback hook that it declares is one that its code has: what is not there cannot be called.
    #[must_use]
    pub fn has_rollback_hook(&self) -> bool {
        let declared = self.manifest.recovery.rollback_hook.as_ref();
        declared.is_some_and(|hook| self.bundle.interface().hooks.contains(hook))
    }

    /// The stop time the version declares for its safe-abort hook, s; what it does not declare, or its code does not have, is
    /// not waited for.
    #[must_use]
    pub fn abort_secs(&self) -> f64 {
        let declared = self.manifest.recovery.safe_abort.as_ref();
        let declared = declared.filter(|abort| self.bundle.interface().hooks.contains(&abort.hook));
        declared.map_or(0.0, |abort| f64::from(abort.stop_time_max_ms) / 1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_must_be_finite() {
        let refused = |text: &str| match params("params.toml", text).unwrap_err() {
            PackageError::Content(error) => error,
            error => panic!("{error}"),
        };
        for (text, expected) in [("a = nan", (1, "a", "NaN")), ("[b]\nc = [1.0, inf]", (2, "b.c", "inf"))] {
            let error = refused(text);
            let TextError::Value { line, field, value, .. } = &error else { panic!("{error}") };
            assert_eq!((*line, field.as_str(), value.as_str()), expected);
        }
        assert!(matches!(refused("b = 1\na = "), TextError::Syntax { line: 2, .. }));
        assert_eq!(params("params.toml", "a = 1.5").unwrap(), serde_json::json!({"a": 1.5}));
    }

    #[test]
    fn folders_are_read_beneath_and_bounded() {
        let root = tempfile::tempdir().unwrap();
        let error = |path: &Path| ParsedPackage::read("", path).unwrap_err();
        assert!(matches!(error(&root.path().join("none")), PackageError::Folder { .. }));
        let candidate = root.path().join("candidate");
        std::fs::create_dir(&candidate).unwrap();
        let manifest = candidate.join("manifest.toml");
        assert!(matches!(error(&candidate), PackageError::Read { file, .. } if file == "manifest.toml"));
        // A link that leads out of the folder is not followed.
        std::fs::write(root.path().join("outside.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.toml", &manifest).unwrap();
        assert!(matches!(error(&candidate), PackageError::Read { .. }), "{}", error(&candidate));
        std::fs::remove_file(&manifest).unwrap();
        std::fs::write(&manifest, "#".repeat(MANIFEST_BYTES_MAX + 1)).unwrap();
        let too_large =
            |error: PackageError| matches!(error, PackageError::Content(TextError::TooLarge { .. }));
        assert!(too_large(error(&candidate)), "{}", error(&candidate));
        std::fs::write(&manifest, b"name = \"\xff\xfe\"").unwrap();
        assert!(matches!(error(&candidate), PackageError::NotText { .. }), "{}", error(&candidate));
        std::fs::write(&manifest, "name = \"grasp\"\nsurprise = 1\n").unwrap();
        assert!(error(&candidate).to_string().starts_with("manifest.toml:2"), "{}", error(&candidate));
        let named = ParsedPackage::read("there", &candidate).unwrap_err().to_string();
        assert!(named.starts_with("there/manifest.toml:2"), "{named}");
    }

    #[test]
    fn each_file_has_its_own_limit() {
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/grasp/1.0.0");
        for (file, bytes_max) in [
            ("manifest.toml", MANIFEST_BYTES_MAX),
            ("submission.toml", SUBMISSION_BYTES_MAX),
            ("params.toml", PARAMS_BYTES_MAX),
        ] {
            let candidate = tempfile::tempdir().unwrap();
            for name in ["manifest.toml", "submission.toml", "params.toml"] {
                std::fs::copy(shipped.join(name), candidate.path().join(name)).unwrap();
            }
            let path = candidate.path().join(file);
            let fill = |bytes: usize| {
                let text = std::fs::read_to_string(shipped.join(file)).unwrap() + "#";
                let rest = "x".repeat(bytes - text.len());
                std::fs::write(&path, text + &rest).unwrap();
                Capability::read(candidate.path())
            };
            assert!(fill(bytes_max).is_ok(), "{file}");
            let error = fill(bytes_max + 1).unwrap_err().to_string();
            assert!(error.contains(file) && error.contains(&bytes_max.to_string()), "{error}");
        }
    }
}
