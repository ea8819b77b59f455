//! Improves a baseline's numeric parameters on nominal success alone, and makes a candidate of the result.
//!
//! Owns the search and its package. It acts as a skill's author: its folder has to be registered like any other, and it
//! has no rights here. It must look at nothing but whether a task was done and how long it took (`objective.rs` gives
//! the reason). It must not judge its result, or touch a store.
//!
//! The files: `space.rs` maps parameters to the unit box, `objective.rs` simulates, `search.rs` drives CMA-ES,
//! `journal.rs` keeps what was simulated, `package.rs` writes the folder.

pub mod journal;
pub mod objective;
pub mod package;
pub mod search;
pub mod settings;
pub mod space;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use self::journal::Journal;
use self::objective::{Objective, ObjectivePair};
use self::package::PackageDraft;
use self::search::{Evaluator, SearchProgress};
use self::settings::{EPISODES_MAX, GENERATIONS_MAX, JOBS_MAX, RefineError, SearchSettings};
use self::space::Space;
use crate::wording::packages;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_runtime::capability::Capability;
use holdpoint_trials::embedded::baselines;

/// A parameter that was changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParameterChange {
    /// Its name in the parameter file.
    pub parameter: &'static str,
    pub before: f64,
    pub after: f64,
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefineReport {
    pub id: CapabilityId,
    pub folder: PathBuf,
    /// Where the evaluations are kept.
    pub kept: PathBuf,
    /// Its parent version.
    pub parent: CapabilityId,
    /// Generations of the search.
    pub generations: u32,
    /// Sets of parameters that were evaluated, the baseline included.
    pub evaluations: u32,
    /// Seed of the search.
    pub seed: u32,
    /// On the training episodes: optimistic for the result.
    pub practised: ObjectivePair,
    /// On episodes that it never saw.
    pub fresh: ObjectivePair,
    /// The largest tool speed it declares, m/s.
    pub max_speed_m_s: f64,
    /// The largest force it declares, N.
    pub max_force_n: f64,
    pub changes: Vec<ParameterChange>,
}

/// Searches, writes the candidate's folder and returns the result. `on_progress` gets every evaluation.
///
/// Equal settings give an equal folder, byte for byte, for any number of workers and however often it was
/// interrupted through `cancel`.
///
/// # Errors
/// [`RefineError`]; no folder is made then, and the simulated evaluations are kept.
pub fn refine(
    settings: &SearchSettings<'_>,
    cancel: &AtomicBool,
    on_progress: &mut dyn FnMut(&SearchProgress),
) -> Result<RefineReport, RefineError> {
    check(settings)?;
    let family = Family::from(settings.task);
    let baseline = baselines()?
        .into_iter()
        .find(|baseline| baseline.id().family == family)
        .ok_or_else(|| RefineError::NoBaseline(family.clone()))?;
    let version = version(settings, &baseline)?;
    let folder = settings.out.join(format!("{family}-refined"));
    let journal_path = settings.out.join(format!("{family}-refined.refine"));
    if folder.symlink_metadata().is_ok() {
        return Err(RefineError::Exists(folder));
    }
    let space = Space::of(&baseline)?;
    let draft = PackageDraft::new(&baseline, &space, version);
    let objective = Objective::new(settings.seed, settings.jobs, cancel)?;
    let journal = Journal::open(&journal_path)?;
    let evaluator = Evaluator::new(&objective, &draft, journal, settings, on_progress);
    let found = evaluator.search().map_err(|error| evaluator.with_journal(error, &journal_path))?;
    let after = evaluator.candidate(&found.values, "")?;
    let fresh = ObjectivePair {
        before: evaluator.fresh(&baseline).map_err(|error| evaluator.with_journal(error, &journal_path))?,
        after: evaluator.fresh(&after).map_err(|error| evaluator.with_journal(error, &journal_path))?,
    };
    let practised = ObjectivePair { before: found.baseline, after: found.score };
    let summary = packages::refined(settings, evaluator.evaluations(), &practised, &fresh);
    let candidate = evaluator.candidate(&found.values, &summary)?;
    package::write(&candidate.package, &journal_path, &folder)?;
    let changes = space
        .axes()
        .iter()
        .zip(&found.values)
        .filter(|(axis, value)| axis.baseline != **value)
        .map(|(axis, value)| ParameterChange { parameter: axis.name, before: axis.baseline, after: *value })
        .collect();
    Ok(RefineReport {
        id: candidate.id(),
        folder,
        kept: journal_path,
        parent: baseline.id(),
        generations: settings.generations,
        evaluations: evaluator.evaluations(),
        seed: settings.seed,
        practised,
        fresh,
        max_speed_m_s: candidate.manifest.permissions.max_speed_m_s,
        max_force_n: candidate.manifest.permissions.max_force_n,
        changes,
    })
}

fn check(settings: &SearchSettings<'_>) -> Result<(), RefineError> {
    let bad = |field, value: String, highest: String| {
        Err(RefineError::Setting { field, value, allowed: format!("1 to {highest}") })
    };
    let SearchSettings { generations, episodes, jobs, .. } = settings;
    if !(1..=GENERATIONS_MAX).contains(generations) {
        return bad("generations", generations.to_string(), GENERATIONS_MAX.to_string());
    }
    if !(1..=EPISODES_MAX).contains(episodes) {
        return bad("episodes", episodes.to_string(), EPISODES_MAX.to_string());
    }
    if !(1..=JOBS_MAX).contains(jobs) {
        return bad("jobs", jobs.to_string(), JOBS_MAX.to_string());
    }
    Ok(())
}

fn version(settings: &SearchSettings<'_>, baseline: &Capability) -> Result<semver::Version, RefineError> {
    let parent = baseline.id().version;
    let next = semver::Version::new(parent.major, parent.minor + 1, 0);
    match &settings.version {
        None => Ok(next),
        Some(version) if *version > parent => Ok(version.clone()),
        Some(version) => Err(RefineError::Setting {
            field: "version",
            value: version.to_string(),
            allowed: format!("a version above the parent's {parent}"),
        }),
    }
}
