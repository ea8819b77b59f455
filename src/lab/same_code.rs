//! The same code compiled in and as a component, side by side in every tick: whether their commands are equal.

use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_body::{Command, Observation};
use holdpoint_cell::CellError;
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::component::ComponentBytes;
use holdpoint_governance::manifest::BundleSource;
use holdpoint_runtime::capability::{Capability, PackageError};
use holdpoint_runtime::skill::{ConfinementReport, Hook, Skill};
use holdpoint_runtime::task::{self, Supervision, is_same};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::worker::Worker;

/// The engine's own controllers as a component.
const CONTROLLERS: &[u8] = include_bytes!("../sdk/prebuilt/controllers.wasm");

/// A version as it is, with a component in place of the controller that is compiled in.
///
/// # Errors
/// As [`Capability::load`]; the component's size included.
pub(crate) fn with_code(version: &Capability, component: &[u8]) -> Result<Capability, PackageError> {
    let mut package = (*version.package).clone();
    let native = String::from(version.manifest.deployment.bundle.clone());
    if matches!(version.manifest.deployment.bundle, BundleSource::Native(_)) {
        package.manifest = package.manifest.replace(&native, "skill.wasm");
    }
    let file = "skill.wasm".to_owned();
    package.component = Some(
        ComponentBytes::new(component.to_vec())
            .map_err(|source| PackageError::ComponentTooLarge { file, source })?,
    );
    Capability::load("with-code", package)
}

/// The result of the two runs of each tick.
#[derive(Clone, Debug, Default)]
struct TickAgreement {
    /// Ticks in which both ran.
    ticks: u64,
    /// Ticks in which their commands differed.
    differing: u64,
    /// The component's use, and its failures.
    confined: ConfinementReport,
}

/// One run that is two: the first's commands are given, both are computed.
struct PairedSkill {
    native: Box<dyn Skill>,
    component: Box<dyn Skill>,
    found: Arc<Mutex<TickAgreement>>,
}

impl Skill for PairedSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let command = self.native.tick(seen);
        let component = self.component.tick(seen);
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        found.ticks += 1;
        found.differing += u64::from(!is_same(&command, &component));
        let confined = self.component.confined();
        found.confined.fuel_tick_max = found.confined.fuel_tick_max.max(confined.fuel_tick_max);
        found.confined.memory_bytes = found.confined.memory_bytes.max(confined.memory_bytes);
        found.confined.fault = found.confined.fault.or(confined.fault);
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.native.enter(hook);
        self.component.enter(hook);
    }
}

/// Runs episodes of the sandbox with both.
fn compare(
    (cell, terms): (&Cell, &SkillTerms),
    native: &Capability,
    component: &Capability,
    seeds: impl IntoIterator<Item = u64>,
) -> Result<TickAgreement, CellError> {
    let found = Arc::new(Mutex::new(TickAgreement::default()));
    let mut worker = Worker::new();
    let task = native.bundle.task();
    for seed in seeds {
        let setup = EpisodeSetup::sample(task, &cell.scene, &cell.sandbox, seed);
        let arm = worker.arm(cell, &setup)?;
        let bundle_seed = terms.bundle_seed(seed);
        let both = PairedSkill {
            native: native.start(bundle_seed),
            component: component.start(bundle_seed),
            found: Arc::clone(&found),
        };
        let guard = terms.guard(&native.manifest.permissions);
        let task_terms = terms.task(task, seed, native.abort_secs());
        task::run(&mut arm.handle(), Box::new(both), guard, &task_terms, &mut |_, _| Supervision::Continue)?;
    }
    let found = found.lock().unwrap_or_else(PoisonError::into_inner).clone();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_sim::SimCells;
    use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};

    use crate::pipeline_experiments::candidate_run::{CandidateSetting, run_candidate};
    use holdpoint_store::{CacheSecret, ResultCache};

    use super::*;

    /// Through all stages to the last live task: every decision with its reasons and numbers, the episodes that ran,
    /// and the final state of the cell.
    #[test]
    fn native_code_and_component_get_the_same_decision() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh().unwrap());
        let setting = CandidateSetting::calibration(&cell, &cache);
        let native = holdpoint_trials::embedded::package("grasp-improved").unwrap();
        let native = Capability::load("grasp", native).unwrap();
        let component = with_code(&native, CONTROLLERS).unwrap();
        let one = run_candidate(&setting, "grasp", (*native.package).clone()).unwrap();
        let other = run_candidate(&setting, "grasp", (*component.package).clone()).unwrap();
        assert!(one.stages.len() > 3, "{one:?}");
        assert_eq!(one, other);
    }

    #[test]
    fn a_component_sends_the_same_commands_bit_for_bit() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let seeds = (0..6).map(|place| episode_seed(CALIBRATION_FROM_RUN, SeedPurpose::Perturbation, place));
        let seeds: Vec<u64> = seeds.collect();
        for version in holdpoint_trials::embedded::baselines().unwrap() {
            if version.id().family.as_str() == "park" {
                continue;
            }
            let component = with_code(&version, CONTROLLERS).unwrap();
            assert_eq!(component.bundle.interface(), version.bundle.interface(), "{}", version.id());
            assert_ne!(component.digest(), version.digest());
            let found = compare((&cell, &terms), &version, &component, seeds.iter().copied()).unwrap();
            assert!(found.ticks > 1_000, "{}", found.ticks);
            assert_eq!(
                found.differing,
                0,
                "{} of {} ticks of {}",
                found.differing,
                found.ticks,
                version.id()
            );
            assert_eq!(found.confined.fault, None);
            assert!(found.confined.fuel_tick_max > 0);
        }
    }
}
