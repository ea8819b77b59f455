//! The embedded versions, baselines and candidates, so that the first run needs no files.

use std::path::Path;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::submission::Package;
use holdpoint_runtime::capability::{Capability, PackageError, shown};

macro_rules! candidates {
    ($($name:literal),* $(,)?) => {
        [$((
            $name,
            [
                include_str!(concat!("../../manifests/candidates/", $name, "/manifest.toml")),
                include_str!(concat!("../../manifests/candidates/", $name, "/submission.toml")),
                include_str!(concat!("../../manifests/candidates/", $name, "/params.toml")),
            ],
        )),*]
    };
}

/// Embedded candidates by folder name. The first unregistered one is the demonstration.
const CANDIDATES: [(&str, [&str; 3]); 8] = candidates![
    "align-improved",
    "grasp-hard-grip",
    "align-low-transit",
    "grasp-tool-frame",
    "grasp-direct-bus",
    "align-no-stop",
    "grasp-improved",
    "place-robust",
];

/// The embedded baselines: those of the shipped site file in its order, fallbacks first. `build.rs` lists them.
const BASELINES: &[(&str, [&str; 3])] = include!(concat!(env!("OUT_DIR"), "/baselines.rs"));

/// The embedded first versions of every family.
///
/// # Errors
/// If an embedded file does not load.
pub fn baselines() -> Result<Vec<Capability>, PackageError> {
    BASELINES.iter().copied().map(|(name, texts)| Capability::load(name, package_of(texts))).collect()
}

/// The embedded baseline of a folder in `manifests`, e.g. `grasp/1.0.0`.
pub(crate) fn baseline(folder: &str) -> Option<Package> {
    let found = BASELINES.iter().copied().find(|(name, _)| name.strip_prefix("manifests/") == Some(folder));
    found.map(|(_, texts)| package_of(texts))
}

fn package_of([manifest, submission, params]: [&str; 3]) -> Package {
    Package {
        manifest: manifest.to_owned(),
        submission: submission.to_owned(),
        params: params.to_owned(),
        component: None,
        author_signature: None,
    }
}

/// Names of the embedded candidates, the demonstration first.
pub fn names() -> impl Iterator<Item = &'static str> {
    CANDIDATES.iter().map(|(name, _)| *name)
}

/// Names of the embedded candidates whose versions are not among these.
pub fn names_beside(known: &[CapabilityId]) -> impl Iterator<Item = &'static str> {
    names().filter(|name| {
        let loaded = package(name).and_then(|package| Capability::load(name, package).ok());
        loaded.is_some_and(|capability| !known.contains(&capability.id()))
    })
}

#[must_use]
pub fn package(name: &str) -> Option<Package> {
    let (_, texts) = CANDIDATES.iter().find(|(known, _)| *known == name)?;
    Some(package_of(*texts))
}

/// A candidate's folder, or the embedded one of that name if there is no such folder.
///
/// # Errors
/// If there is neither, or it does not load.
pub fn read(path: &Path) -> Result<Capability, PackageError> {
    let name = path.file_name().and_then(|name| name.to_str());
    match name.and_then(package) {
        Some(package) if !path.exists() => Capability::load(&shown(path), package),
        _ => Capability::read(path),
    }
}
