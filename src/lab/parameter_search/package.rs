//! The candidate's folder: manifest, parameters and submission, made from the baseline's texts.
//!
//! Owns what the candidate declares. It declares the largest tool speed and force its parameters can ask for, and
//! never less than its parent, so that the checks see what was widened; whether that is allowed is theirs to say.
//! Must not leave half a folder, or replace one.

use std::fs;
use std::path::Path;

use toml_edit::DocumentMut;

use super::settings::RefineError;
use super::space::Space;
use holdpoint_governance::submission::Package;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_runtime::capability::Capability;

/// The author's name.
pub const AUTHOR: &str = "refine";

/// Parameters that set how fast the tool moves, m/s.
const TOOL_SPEEDS: [&str; 8] = [
    "approach_speed_m_s",
    "descend_speed_m_s",
    "contact_speed_m_s",
    "lift_speed_m_s",
    "transit_speed_m_s",
    "lower_speed_m_s",
    "retreat_speed_m_s",
    "speed_m_s",
];

/// Parameters that set how hard the hand grips, or presses before it gives way, N.
const FORCES: [&str; 3] = ["grip_force_n", "contact_stop_n", "contact_force_n"];

/// The common part of all candidates of a search.
pub struct PackageDraft<'a> {
    baseline: &'a Capability,
    space: &'a Space,
    version: semver::Version,
}

impl<'a> PackageDraft<'a> {
    /// A candidate of this version, made from this baseline.
    #[must_use]
    pub const fn new(baseline: &'a Capability, space: &'a Space, version: semver::Version) -> Self {
        Self { baseline, space, version }
    }

    /// The box that is searched.
    #[must_use]
    pub const fn space(&self) -> &Space {
        self.space
    }

    #[must_use]
    pub const fn baseline(&self) -> &Capability {
        self.baseline
    }

    /// The candidate with these values, loaded.
    ///
    /// # Errors
    /// If the texts do not load, which values of the space never cause.
    pub fn candidate(&self, values: &[f64], summary: &str) -> Result<Capability, RefineError> {
        let package = Package {
            manifest: self.manifest(values)?,
            submission: self.submission(summary),
            params: self.space.text(values),
            component: None,
            author_signature: None,
        };
        Ok(Capability::load(&format!("{}-refined", self.baseline.id().family), package)?)
    }

    fn manifest(&self, values: &[f64]) -> Result<String, RefineError> {
        let text = &self.baseline.package.manifest;
        let mut manifest: DocumentMut =
            text.parse().map_err(|source| RefineError::Edit { file: "manifest.toml", source })?;
        let largest = |names: &[&str], declared: f64| {
            let axes = self.space.axes().iter().zip(values).filter(|(axis, _)| names.contains(&axis.name));
            axes.map(|(_, value)| *value).fold(declared, f64::max)
        };
        let declared = &self.baseline.manifest.permissions;
        let speed_m_s = largest(&TOOL_SPEEDS, declared.max_speed_m_s);
        let force_n = largest(&FORCES, declared.max_force_n);
        manifest.insert("version", toml_edit::value(self.version.to_string()));
        if let Some(permissions) = manifest.get_mut("permissions").and_then(toml_edit::Item::as_table_mut) {
            permissions.insert("max_speed_m_s", toml_edit::value(speed_m_s));
            permissions.insert("max_force_n", toml_edit::value(force_n));
        }
        Ok(manifest.to_string())
    }

    fn submission(&self, summary: &str) -> String {
        let mut submission = DocumentMut::new();
        submission.insert("author", toml_edit::value(AUTHOR));
        submission.insert("provenance", toml_edit::value(Provenance::Optimiser.name()));
        submission.insert("parent", toml_edit::value(self.baseline.id().version.to_string()));
        // It is unreviewed: an estimate of low would be a claim.
        submission.insert("estimated_risk", toml_edit::value(Risk::Medium.name()));
        submission.insert("summary", toml_edit::value(summary));
        submission.to_string()
    }
}

/// Writes the folder: whole, or not at all, and only if there is none.
///
/// # Errors
/// If it is there already, or cannot be written.
pub fn write(package: &Package, scratch: &Path, folder: &Path) -> Result<(), RefineError> {
    let whole = tempfile::Builder::new()
        .prefix("candidate-")
        .tempdir_in(scratch)
        .map_err(RefineError::io("make a folder in", scratch))?;
    for (file, text) in [
        ("manifest.toml", &package.manifest),
        ("params.toml", &package.params),
        ("submission.toml", &package.submission),
    ] {
        let path = whole.path().join(file);
        fs::write(&path, text).map_err(RefineError::io("write", &path))?;
    }
    if folder.symlink_metadata().is_ok() {
        return Err(RefineError::Exists(folder.to_owned()));
    }
    open_to_readers(whole.path())?;
    fs::rename(whole.path(), folder).map_err(RefineError::io("make the folder", folder))?;
    // It has its own name now; there is nothing left to remove.
    drop(whole.keep());
    Ok(())
}

/// A temporary folder is its owner's alone; a candidate is for others to read.
fn open_to_readers(folder: &Path) -> Result<(), RefineError> {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(folder, fs::Permissions::from_mode(0o755))
        .map_err(RefineError::io("open to readers", folder))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameter_search::objective::{ObjectivePair, Score};
    use crate::parameter_search::settings::SearchSettings;
    use crate::wording::packages;
    use holdpoint_governance::submission::SUMMARY_CHARS_MAX;
    use holdpoint_trials::embedded::baselines;

    /// A pad that closes fast moves no tool.
    const PAD_SPEEDS: [&str; 2] = ["close_speed_m_s", "release_speed_m_s"];

    #[test]
    fn every_axis_of_speed_or_force_is_listed() {
        for baseline in baselines().unwrap() {
            let space = Space::of(&baseline).unwrap();
            for axis in space.axes() {
                let speed = axis.name.ends_with("_m_s") && !PAD_SPEEDS.contains(&axis.name);
                assert_eq!(speed, TOOL_SPEEDS.contains(&axis.name), "{}", axis.name);
                assert_eq!(axis.name.ends_with("_n"), FORCES.contains(&axis.name), "{}", axis.name);
            }
        }
    }

    #[test]
    fn permissions_are_widened_where_it_is_needed_and_nothing_else_changes() {
        for baseline in baselines().unwrap() {
            let space = Space::of(&baseline).unwrap();
            let version = semver::Version::new(1, 1, 0);
            let draft = PackageDraft::new(&baseline, &space, version.clone());
            let declared = &baseline.manifest.permissions;
            let start = space.values(&space.start());
            for axis in 0..start.len() {
                let mut values = start.clone();
                values[axis] = space.axes()[axis].highest;
                let candidate = draft.candidate(&values, "").unwrap();
                let mut expected = (*baseline.manifest).clone();
                expected.version = version.clone();
                let name = space.axes()[axis].name;
                if TOOL_SPEEDS.contains(&name) {
                    expected.permissions.max_speed_m_s = declared.max_speed_m_s.max(values[axis]);
                }
                if FORCES.contains(&name) {
                    expected.permissions.max_force_n = declared.max_force_n.max(values[axis]);
                }
                assert_eq!(*candidate.manifest, expected, "{name}");
                assert_eq!(candidate.submission.provenance, Provenance::Optimiser);
                assert_eq!(candidate.submission.parent, Some(baseline.id().version));
            }
        }
    }

    #[test]
    fn the_longest_summary_is_allowed() {
        let score = Score { episodes: u32::MAX, successes: u32::MAX, ticks: u64::from(u32::MAX) * 7_200 };
        let both = ObjectivePair { before: score, after: score };
        let settings = SearchSettings {
            task: holdpoint_body::TaskKind::Grasp,
            generations: u32::MAX,
            episodes: u32::MAX,
            seed: u32::MAX,
            jobs: 1,
            out: Path::new("."),
            version: None,
        };
        let text = packages::refined(&settings, u32::MAX, &both, &both);
        assert!(text.chars().count() <= SUMMARY_CHARS_MAX, "{}", text.chars().count());
    }

    #[test]
    fn existing_folder_is_not_overwritten() {
        let out = tempfile::tempdir().unwrap();
        let text = |name: &str| name.to_owned();
        let package = Package {
            manifest: text("m"),
            submission: text("s"),
            params: text("p"),
            component: None,
            author_signature: None,
        };
        let folder = out.path().join("grasp-refined");
        write(&package, out.path(), &folder).unwrap();
        assert_eq!(fs::read_to_string(folder.join("params.toml")).unwrap(), "p");
        let other = Package { params: text("other"), ..package };
        let error = write(&other, out.path(), &folder).unwrap_err();
        assert!(matches!(error, RefineError::Exists(_)), "{error}");
        assert_eq!(fs::read_to_string(folder.join("params.toml")).unwrap(), "p");
        // Nothing else is left beside it.
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 1);
    }
}
